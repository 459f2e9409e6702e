//! Limits the memory and work of a script's shapes, assemblies and placed objects.

use presight_model::error::{Error, Result};
use presight_model::limits;
use presight_model::memory;
use std::cell::Cell;
use std::rc::Rc;

/// Counts memory in units of a polygon corner. Other data are converted to the number of corners with equal memory.
#[derive(Debug, Default)]
pub(super) struct Budget {
    held: Cell<u64>,
    made: Cell<u64>,
    /// Bytes taken since the last check of the system's free memory.
    unasked: Cell<u64>,
}

/// Memory of a corner, in bytes.
const BYTES_OF_CORNER: usize = 32;

/// Bytes taken before the next check of free memory. A check takes longer than making a small shape.
const LITTLE: u64 = 16 << 20;

/// Converts bytes to corners.
pub(super) fn corners_worth(bytes: usize) -> u64 {
    (bytes / BYTES_OF_CORNER) as u64
}

/// A part of the budget, returned on drop.
#[derive(Debug)]
pub(super) struct BudgetShare {
    budget: Rc<Budget>,
    corners: u64,
}

impl Budget {
    /// Takes memory for `corners`, before they are made.
    pub fn take(self: &Rc<Self>, corners: u64) -> Result<BudgetShare> {
        self.work(corners)?;
        self.room(corners.saturating_mul(BYTES_OF_CORNER as u64))?;
        let held = self.held.get().saturating_add(corners);
        if held > limits::MAX_SCRIPT_CORNERS {
            let what = format!("the script's shapes and objects hold {held} corners of polygons");
            let remedy = format!("{} is the limit; place one shape many times instead", limits::MAX_SCRIPT_CORNERS);
            return Err(Error::invalid(what, remedy));
        }
        self.held.set(held);
        Ok(BudgetShare { budget: self.clone(), corners })
    }

    /// Takes memory for `corners` permanently, because placed objects stay.
    pub fn keep(self: &Rc<Self>, corners: u64) -> Result<()> {
        let mut held = self.take(corners)?;
        held.corners = 0;
        Ok(())
    }

    /// Checks that the system has `bytes` more. Small amounts are added up and checked together.
    pub fn room(&self, bytes: u64) -> Result<()> {
        self.unasked.set(self.unasked.get().saturating_add(bytes));
        if self.unasked.get() <= LITTLE {
            return Ok(());
        }
        memory::require(self.unasked.replace(0))
    }

    /// Counts work that takes no memory.
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

impl Drop for BudgetShare {
    fn drop(&mut self) {
        self.budget.held.set(self.budget.held.get() - self.corners);
    }
}
