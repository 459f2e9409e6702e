//! The views of the current drive that are not believed yet.

use crate::evidence::features::book::FeatureViews;
use crate::evidence::objects::ViewSums;
use crate::observe::view::View;
use crate::options::LearnOptions;
use glam::DVec3;
use presight_model::geometry::Pose;
use std::collections::VecDeque;

/// A view with its evidence.
pub(crate) struct PendingView {
    pub view: View,
    pub sums: ViewSums,
    pub features: Vec<FeatureViews>,
    /// Distance driven before the view, metres.
    driven: f64,
    /// True once a later frame had a pose.
    is_followed: bool,
}

/// The current drive. A view is believed once the robot has driven on without getting lost.
#[derive(Default)]
pub(crate) struct Drive {
    /// Number of the drive, from 0.
    pub number: usize,
    pending: VecDeque<PendingView>,
    /// Pose of the robot in the last view, and its stamp in seconds.
    last_view: Option<(Pose, f64)>,
    /// Distance driven, metres.
    driven: f64,
    /// Last position of the robot.
    position: Option<DVec3>,
}

impl Drive {
    /// Records the robot's next position.
    pub fn advance(&mut self, position: DVec3) {
        self.pending.iter_mut().for_each(|pending| pending.is_followed = true);
        self.driven += self.position.replace(position).map_or(0.0, |before| before.distance(position));
    }

    /// True if a frame at a pose and a stamp differs enough from the last view.
    pub fn is_new_view(&self, pose: &Pose, stamp: f64, options: &LearnOptions) -> bool {
        self.last_view.is_none_or(|(last, then)| {
            last.translation.distance(pose.translation) >= options.view_distance
                || last.rotation.angle_between(pose.rotation) >= options.view_turn
                || stamp - then >= options.view_time
        })
    }

    /// Adds a view. Returns true if this discards the oldest of `max` pending views: a robot that turns in one place
    /// for hours never drives on.
    pub fn add(&mut self, view: View, sums: ViewSums, max: usize) -> bool {
        let is_full = self.pending.len() >= max;
        if is_full {
            self.pending.pop_front();
        }
        let driven = self.driven;
        self.pending.push_back(PendingView { view, sums, features: Vec::new(), driven, is_followed: false });
        is_full
    }

    /// Ends the views of one stamp. The last of them gets the features, because they are believed or discarded
    /// together.
    pub fn end_views(&mut self, pose: Pose, stamp: f64, features: Vec<FeatureViews>) {
        if let Some(last) = self.pending.back_mut() {
            last.features = features;
        }
        self.last_view = Some((pose, stamp));
    }

    /// Removes the oldest view if the robot has driven at least `settle` metres since.
    pub fn next_believed(&mut self, settle: f64) -> Option<PendingView> {
        self.pending.pop_front_if(|first| first.is_followed && self.driven - first.driven >= settle)
    }

    /// Forgets the pending views and the position. Returns the number of forgotten views.
    pub fn reset(&mut self) -> usize {
        let number = self.number;
        let forgotten = std::mem::replace(self, Self { number, ..Self::default() });
        forgotten.pending.len()
    }
}
