//! Parts that are added to an assembly which nobody sees: the language hands copies to functions, so that `add(a[0], ..)`
//! changes one that is dropped at once.

use super::call::Spot;
use presight_model::error::{Error, Result};
use std::cell::RefCell;
use std::rc::Rc;

/// The first part that was lost.
#[derive(Debug, Default)]
pub(super) struct LostPart(RefCell<Option<(String, Spot)>>);

impl LostPart {
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] naming a part that was lost, and where it was added.
    pub fn check(&self) -> Result<()> {
        let Some((name, at)) = self.0.take() else { return Ok(()) };
        let what =
            format!("part {name:?} is lost: it is added to a copy of an assembly, or to one after it was placed");
        let remedy = "write a.add(name, thing), also for a[0] and m.a, before a is placed; functions must return what they change";
        Err(at.place(Error::invalid(what, remedy), "add"))
    }
}

/// A part that was added where it may be lost: dropped before it is used, it is.
#[derive(Debug)]
pub(super) struct PendingPart {
    part: Option<(String, Spot)>,
    lost: Rc<LostPart>,
}

impl PendingPart {
    /// A part of that name, and where it was added.
    pub fn new(name: &str, at: &Spot, lost: &Rc<LostPart>) -> Self {
        Self { part: Some((name.to_owned(), at.clone())), lost: lost.clone() }
    }

    /// It is used, and so not lost.
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
