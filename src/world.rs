//! The world: an immutable version of the environment that predictions read.

use crate::environment::Environment;
use std::sync::Arc;

/// One version of the environment, cheap to clone; predictions in flight keep the version they began with.
#[derive(Clone, Debug)]
pub struct World {
    environment: Arc<Environment>,
    version: u64,
}

impl World {
    /// The first version of a world.
    pub fn new(environment: Environment) -> Self {
        Self { environment: Arc::new(environment), version: 1 }
    }

    /// What this version holds.
    pub fn environment(&self) -> &Arc<Environment> {
        &self.environment
    }

    /// Number of the version; results carry it.
    pub fn version(&self) -> u64 {
        self.version
    }
}
