//! The objects that an exploration adds, and the change of a store.

mod exploration;
mod object;

pub use exploration::{Exploration, Known, MAX_MARKS};
pub use object::ExploredObject;
