//! Workspaces of the threads, kept to reuse their memory.

use super::context::VisibilityContext;
use super::strategy::Workspace;
use super::worker::Worker;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Idle workspaces. Within a prediction they keep their polygons and tiles for the next task of the thread pool.
#[derive(Default)]
pub(super) struct IdleWorkspaces {
    idle: Mutex<Vec<Workspace>>,
    /// Keeps them between predictions.
    memory: WorkspaceMemory,
}

/// Workspaces kept between predictions to reuse their memory.
#[derive(Clone, Default)]
pub(crate) struct WorkspaceMemory(Arc<Mutex<Vec<Workspace>>>);

impl std::fmt::Debug for WorkspaceMemory {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("WorkspaceMemory").finish_non_exhaustive()
    }
}

fn lock(workspaces: &Mutex<Vec<Workspace>>) -> MutexGuard<'_, Vec<Workspace>> {
    workspaces.lock().unwrap_or_else(PoisonError::into_inner)
}

impl IdleWorkspaces {
    pub fn new(memory: WorkspaceMemory) -> Self {
        Self { idle: Mutex::default(), memory }
    }

    /// Returns an idle workspace of this prediction, or a new one.
    pub fn take(&self, frame: &VisibilityContext<'_>) -> Workspace {
        let known = lock(&self.idle).pop();
        known.unwrap_or_else(|| match lock(&self.memory.0).pop() {
            Some(mut workspace) => {
                workspace.renew(frame);
                workspace
            }
            None => Workspace::new(frame),
        })
    }

    pub fn give(&self, workspace: Workspace) {
        lock(&self.idle).push(workspace);
    }

    pub fn wake<'j, 'a>(&'j self, frame: &'a VisibilityContext<'a>) -> WorkerGuard<'j, 'a> {
        WorkerGuard { worker: None, frame, of: self }
    }
}

impl Drop for IdleWorkspaces {
    fn drop(&mut self) {
        lock(&self.memory.0).append(&mut lock(&self.idle));
    }
}

/// A worker that returns its workspace when dropped.
pub(super) struct WorkerGuard<'j, 'a> {
    worker: Option<Worker<'a>>,
    frame: &'a VisibilityContext<'a>,
    of: &'j IdleWorkspaces,
}

impl<'a> WorkerGuard<'_, 'a> {
    pub fn worker(&mut self) -> &mut Worker<'a> {
        self.worker.get_or_insert_with(|| Worker { frame: self.frame, workspace: self.of.take(self.frame) })
    }
}

impl Drop for WorkerGuard<'_, '_> {
    fn drop(&mut self) {
        if let Some(worker) = self.worker.take() {
            self.of.give(worker.workspace);
        }
    }
}
