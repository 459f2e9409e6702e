//! Detects parts added to an assembly that is never used. Rhai passes copies to functions, so `add(a[0], ..)` changes a
//! copy that is dropped immediately.

use super::call::Spot;
use presight_model::error::{Error, Result};
use std::cell::RefCell;
use std::rc::Rc;

/// The first lost part.
#[derive(Debug, Default)]
pub(super) struct LostPart(RefCell<Option<(String, Spot)>>);

impl LostPart {
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if a part was lost; names the part and the place where it was added.
    pub fn check(&self) -> Result<()> {
        let Some((name, at)) = self.0.take() else { return Ok(()) };
        let what =
            format!("part {name:?} is lost: it is added to a copy of an assembly, or to an assembly already placed");
        let remedy = "write a.add(name, part), also for a[0] and m.a, before a is placed; functions must return the \
                      changed assembly";
        Err(at.place(Error::invalid(what, remedy), "add"))
    }
}

/// A part that is lost if this value is dropped before the part is used.
#[derive(Debug)]
pub(super) struct PendingPart {
    part: Option<(String, Spot)>,
    lost: Rc<LostPart>,
}

impl PendingPart {
    /// A part with this name, added at `at`.
    pub fn new(name: &str, at: &Spot, lost: &Rc<LostPart>) -> Self {
        Self { part: Some((name.to_owned(), at.clone())), lost: lost.clone() }
    }

    /// Records that the part is used.
    pub fn forget(mut self) {
        self.part = None;
    }
}

impl Drop for PendingPart {
    fn drop(&mut self) {
        if let Some(part) = self.part.take() {
            self.lost.0.borrow_mut().get_or_insert(part);
        }
    }
}
