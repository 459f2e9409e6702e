//! What shapes, assemblies and placed objects of a script hold: counted, so that memory and work have a limit.

use crate::error::{Error, Result};
use crate::limits;
use std::cell::Cell;
use std::rc::Rc;

/// Corners of polygons, or what is worth as much memory.
#[derive(Debug, Default)]
pub(super) struct Budget {
    held: Cell<u64>,
    made: Cell<u64>,
}

/// So many bytes are worth a corner.
const BYTES_OF_CORNER: usize = 32;

/// The corners that so many bytes are worth.
pub(super) fn corners_worth(bytes: usize) -> u64 {
    (bytes / BYTES_OF_CORNER) as u64
}

/// A part of the budget, given back on drop.
#[derive(Debug)]
pub(super) struct Held {
    budget: Rc<Budget>,
    corners: u64,
}

impl Budget {
    /// Takes so many corners, before they are made.
    pub fn take(self: &Rc<Self>, corners: u64) -> Result<Held> {
        self.work(corners)?;
        let held = self.held.get().saturating_add(corners);
        if held > limits::MAX_SCRIPT_CORNERS {
            let what = format!("the script's shapes and objects hold {held} corners of polygons");
            let remedy = format!("{} is the limit; place one shape many times instead", limits::MAX_SCRIPT_CORNERS);
            return Err(Error::invalid(what, remedy));
        }
        self.held.set(held);
        Ok(Held { budget: self.clone(), corners })
    }

    /// Takes so many corners for good: what is placed stays.
    pub fn keep(self: &Rc<Self>, corners: u64) -> Result<()> {
        let mut held = self.take(corners)?;
        held.corners = 0;
        Ok(())
    }

    /// Counts work that leaves nothing behind.
    pub fn work(&self, corners: u64) -> Result<()> {
        self.made.set(self.made.get().saturating_add(corners));
        if self.made.get() <= limits::MAX_SCRIPT_WORK {
            return Ok(());
        }
        let what = format!("the script has made {} corners of polygons", self.made.get());
        let remedy = format!("{} is the limit; make each shape once and place it often", limits::MAX_SCRIPT_WORK);
        Err(Error::invalid(what, remedy))
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        self.budget.held.set(self.budget.held.get() - self.corners);
    }
}
