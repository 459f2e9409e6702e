//! Owners of threads, locks and devices. A forked child never uses its parent's.

use presight::tools::{PerProcess, this_process};
use presight::{Backend, Error, ErrorKind, Options, Predictor, Result};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, PoisonError};

/// The process that first loaded a graphics driver; 0 before. Drivers do not outlive a fork.
static DRIVERS: AtomicU32 = AtomicU32::new(0);

/// True in a child of a process that has loaded a graphics driver.
fn lost_drivers() -> bool {
    ![0, this_process()].contains(&DRIVERS.load(Ordering::Relaxed))
}

/// Opens a predictor on threads of this process.
fn open(backend: Backend, threads: usize) -> Result<Predictor> {
    let backend = match backend {
        Backend::Gpu if lost_drivers() => {
            let what = "a graphics driver does not work in a process that was forked from one that uses it";
            let remedy = "start the process by \"spawn\" or \"forkserver\", or use `Backend::Cpu`";
            return Err(Error::new(ErrorKind::NoDevice, what, remedy));
        }
        Backend::Auto if lost_drivers() => Backend::Cpu,
        other => other,
    };
    if backend != Backend::Cpu {
        DRIVERS.store(this_process(), Ordering::Relaxed);
    }
    Predictor::new(Options::new(backend).with_threads(threads))
}

/// A value that a process makes on first use, behind a lock. A child neither uses nor drops its parent's value, because the
/// threads behind it are gone.
pub struct Shared<T> {
    made_by: u32,
    slot: Option<Box<PerProcess<Mutex<Option<T>>>>>,
}

impl<T> Shared<T> {
    pub fn new() -> Self {
        Self { made_by: this_process(), slot: Some(Box::default()) }
    }

    /// Runs work with the value, which is made if there is none. Where the work panics, the next one makes another.
    pub fn with<R, E: From<Error>>(
        &self,
        make: impl FnOnce() -> Result<T>,
        work: impl FnOnce(&mut T) -> Result<R, E>,
    ) -> Result<R, E> {
        let Some(slot) = &self.slot else { return Err(Error::new(ErrorKind::System, "it was closed", "").into()) };
        let mut slot = slot.get().lock().unwrap_or_else(PoisonError::into_inner);
        let mut value = match slot.take() {
            Some(value) => value,
            None => make()?,
        };
        let done = work(&mut value);
        *slot = Some(value);
        done
    }
}

impl<T> Drop for Shared<T> {
    fn drop(&mut self) {
        if self.made_by != this_process() {
            std::mem::forget(self.slot.take());
        }
    }
}

/// A predictor's options, and the predictor of each process.
pub struct PerProcessPredictor<C> {
    backend: Backend,
    threads: usize,
    shared: Shared<(Predictor, C)>,
}

impl<C: Default> PerProcessPredictor<C> {
    pub fn new(backend: Backend, threads: usize) -> Self {
        Self { backend, threads, shared: Shared::new() }
    }

    pub fn with<R, E: From<Error>>(&self, work: impl FnOnce(&mut Predictor, &mut C) -> Result<R, E>) -> Result<R, E> {
        let make = || Ok((open(self.backend, self.threads)?, C::default()));
        self.shared.with(make, |(predictor, kept)| work(predictor, kept))
    }

    pub fn options(&self) -> (&'static str, usize) {
        let backend = match self.backend {
            Backend::Auto => "auto",
            Backend::Cpu => "cpu",
            Backend::Gpu => "gpu",
        };
        (backend, self.threads)
    }
}
