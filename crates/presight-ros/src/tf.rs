//! Transforms between coordinate frames, as tf2 keeps them.

use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use std::collections::{BTreeMap, VecDeque};

/// A frame id without the leading slash that ROS 1 drivers still write: `/laser` and `laser` are one frame.
pub fn clean_frame_id(id: &str) -> &str {
    id.strip_prefix('/').unwrap_or(id)
}

/// The pose of a frame in its parent: fixed, or over time.
#[derive(Clone, Debug)]
pub struct Edge {
    /// The parent's frame.
    pub parent: String,
    /// True if it was published as static: it holds at all times.
    pub is_static: bool,
    /// Stamps in nanoseconds, rising, with parent_from_child.
    samples: VecDeque<(i64, Pose)>,
}

/// The frames of a robot: every frame has one parent at most.
#[derive(Clone, Debug, Default)]
pub struct FrameTree {
    /// By child.
    edges: BTreeMap<String, Edge>,
}

/// The answer to a question for a transform.
#[derive(Clone, Debug, PartialEq)]
pub enum Lookup {
    /// target_from_source.
    Found(Pose),
    /// The edge of this child has no sample at or after the stamp yet.
    Later(String),
    /// The edge of this child begins after the stamp.
    Before(String),
    /// No path connects the frames.
    Unconnected,
}

impl FrameTree {
    /// Adds a transform. Samples may come in any order; one of the same stamp replaces the old one.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if the child has another parent already, or is among the parents of its
    /// parent.
    pub fn insert(&mut self, parent: &str, child: &str, stamp_ns: i64, pose: Pose, is_static: bool) -> Result<()> {
        let (parent, child) = (clean_frame_id(parent), clean_frame_id(child));
        if let Some(edge) = self.edges.get_mut(child) {
            if edge.parent != parent {
                let what = format!("frame \"{child}\" has two parents, \"{}\" and \"{parent}\"", edge.parent);
                return Err(Error::invalid(
                    what,
                    "let one node publish it, or leave one of the two out of the recording",
                ));
            }
            edge.is_static |= is_static;
            edge.add(stamp_ns, pose);
            return Ok(());
        }
        if child == parent || self.ancestors(parent).any(|ancestor| ancestor == child) {
            let what = format!("frames \"{parent}\" and \"{child}\" are parents of each other");
            return Err(Error::invalid(what, "leave one of the two transforms out of the recording"));
        }
        let samples = VecDeque::from([(stamp_ns, pose)]);
        self.edges.insert(child.to_owned(), Edge { parent: parent.to_owned(), is_static, samples });
        Ok(())
    }

    /// The frames with the edges to their parents, by name.
    pub fn edges(&self) -> impl Iterator<Item = (&str, &Edge)> {
        self.edges.iter().map(|(child, edge)| (child.as_str(), edge))
    }

    /// True if the frame is the child or the parent of an edge.
    pub fn contains(&self, frame: &str) -> bool {
        let frame = clean_frame_id(frame);
        self.edges.contains_key(frame) || self.edges.values().any(|edge| edge.parent == frame)
    }

    /// The parents of a frame, nearest first.
    fn ancestors<'a>(&'a self, frame: &'a str) -> impl Iterator<Item = &'a str> {
        std::iter::successors(self.edges.get(frame), |edge| self.edges.get(&edge.parent))
            .map(|edge| edge.parent.as_str())
    }

    /// The edges between two frames, by their children: those to pass upwards from the source, then those downwards to
    /// the target. `None` if no path connects them.
    fn route<'a>(&'a self, target: &'a str, source: &'a str) -> Option<(Vec<&'a str>, Vec<&'a str>)> {
        let path = |from: &'a str| -> Vec<&'a str> { std::iter::once(from).chain(self.ancestors(from)).collect() };
        let (up, down) = (path(source), path(target));
        let meeting = up.iter().position(|frame| down.contains(frame))?;
        let below = down.iter().position(|frame| *frame == up[meeting])?;
        Some((up[..meeting].to_vec(), down[..below].to_vec()))
    }

    /// target_from_source at a time, interpolated (linear, slerp), never extrapolated. Static edges hold at all times.
    pub fn lookup(&self, target: &str, source: &str, stamp_ns: i64) -> Lookup {
        let (target, source) = (clean_frame_id(target), clean_frame_id(source));
        let Some((up, down)) = self.route(target, source) else { return Lookup::Unconnected };
        let mut poses = [Pose::IDENTITY; 2];
        for (pose, children) in poses.iter_mut().zip([up, down]) {
            for child in children {
                match self.edges[child].at(stamp_ns) {
                    Ok(parent_from_child) => *pose = parent_from_child * *pose,
                    Err(Outside::Before) => return Lookup::Before(child.to_owned()),
                    Err(Outside::After) => return Lookup::Later(child.to_owned()),
                }
            }
        }
        let [common_from_source, common_from_target] = poses;
        Lookup::Found(common_from_target.inverse() * common_from_source)
    }

    /// The stamps of all samples of the moving edges between two frames, nanoseconds, rising; none if they are not connected.
    pub fn stamps(&self, target: &str, source: &str) -> Vec<i64> {
        let (up, down) = self.route(clean_frame_id(target), clean_frame_id(source)).unwrap_or_default();
        let edges = up.iter().chain(&down).map(|child| &self.edges[*child]).filter(|edge| !edge.is_static);
        let mut stamps: Vec<i64> = edges.flat_map(|edge| edge.samples.iter().map(|(stamp, _)| *stamp)).collect();
        stamps.sort_unstable();
        stamps.dedup();
        stamps
    }

    /// True if only static edges lie between two frames that are connected.
    pub fn is_rigid(&self, target: &str, source: &str) -> bool {
        self.route(clean_frame_id(target), clean_frame_id(source))
            .is_some_and(|(up, down)| up.iter().chain(&down).all(|child| self.edges[*child].is_static))
    }

    /// Drops every edge that is not static.
    pub fn forget_moving(&mut self) {
        self.edges.retain(|_, edge| edge.is_static);
    }

    /// Drops samples that no lookup at `stamp_ns` or later needs.
    pub fn forget_before(&mut self, stamp_ns: i64) {
        for edge in self.edges.values_mut().filter(|edge| !edge.is_static) {
            while edge.samples.get(1).is_some_and(|(stamp, _)| *stamp <= stamp_ns) {
                edge.samples.pop_front();
            }
        }
    }
}

/// The side of the samples on which a stamp lies.
enum Outside {
    Before,
    After,
}

impl Edge {
    /// Stamps of the first and the last sample, nanoseconds.
    pub fn span_ns(&self) -> (i64, i64) {
        let stamp = |sample: Option<&(i64, Pose)>| sample.map_or(0, |(stamp, _)| *stamp);
        (stamp(self.samples.front()), stamp(self.samples.back()))
    }

    /// parent_from_child of the newest sample.
    pub fn last(&self) -> Pose {
        self.samples.back().map_or(Pose::IDENTITY, |(_, pose)| *pose)
    }

    fn add(&mut self, stamp_ns: i64, pose: Pose) {
        if self.is_static {
            self.samples.clear();
        }
        let at = self.samples.partition_point(|(stamp, _)| *stamp < stamp_ns);
        match self.samples.get_mut(at) {
            Some(sample) if sample.0 == stamp_ns => sample.1 = pose,
            _ => self.samples.insert(at, (stamp_ns, pose)),
        }
    }

    fn at(&self, stamp_ns: i64) -> Result<Pose, Outside> {
        if self.is_static {
            return Ok(self.last());
        }
        let after = self.samples.partition_point(|(stamp, _)| *stamp < stamp_ns);
        let (t1, p1) = *self.samples.get(after).ok_or(Outside::After)?;
        if t1 == stamp_ns {
            return Ok(p1);
        }
        let (t0, p0) = self.samples[after.checked_sub(1).ok_or(Outside::Before)?];
        let t = (stamp_ns - t0) as f64 / (t1 - t0) as f64;
        Ok(Pose { translation: p0.translation.lerp(p1.translation, t), rotation: p0.rotation.slerp(p1.rotation, t) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};

    fn pose(x: f64, yaw_deg: f64) -> Pose {
        Pose { translation: DVec3::new(x, 0.0, 0.0), rotation: DQuat::from_rotation_z(yaw_deg.to_radians()) }
    }

    /// By hand: half-way between 0 and 2 m the robot is at 1 m, and a sensor 0.5 m ahead of it at 1.5 m.
    #[test]
    fn a_lookup_interpolates_and_never_extrapolates() {
        let mut tree = FrameTree::default();
        tree.insert("odom", "base_link", 10, pose(0.0, 0.0), false).unwrap();
        tree.insert("odom", "base_link", 30, pose(2.0, 90.0), false).unwrap();
        tree.insert("/base_link", "/laser", 0, pose(0.5, 0.0), true).unwrap();
        let Lookup::Found(found) = tree.lookup("odom", "laser", 20) else { panic!() };
        let half = std::f64::consts::FRAC_1_SQRT_2 / 2.0;
        assert!((found.translation - DVec3::new(1.0 + half, half, 0.0)).length() < 1e-12, "{found:?}");
        let Lookup::Found(back) = tree.lookup("laser", "odom", 20) else { panic!() };
        assert!(((back * found).translation).length() < 1e-12);
        assert_eq!(tree.stamps("laser", "odom"), [10, 30]);
        assert!(tree.stamps("base_link", "laser").is_empty() && tree.stamps("odom", "camera").is_empty());
        assert_eq!(tree.lookup("odom", "laser", 31), Lookup::Later("base_link".into()));
        assert_eq!(tree.lookup("odom", "laser", 9), Lookup::Before("base_link".into()));
        assert_eq!(tree.lookup("odom", "camera", 20), Lookup::Unconnected);
        assert!(matches!(tree.lookup("base_link", "laser", 1_000), Lookup::Found(p) if p.translation.x == 0.5));
        assert!(tree.is_rigid("base_link", "laser") && !tree.is_rigid("odom", "laser"));
    }

    /// A TurtleBot 4 has `base_footprint` as the child of `base_link`: the route leads up, then down.
    #[test]
    fn a_child_and_a_sibling_are_reached() {
        let mut tree = FrameTree::default();
        tree.insert("base_link", "base_footprint", 0, pose(-1.0, 0.0), true).unwrap();
        tree.insert("base_link", "laser", 0, pose(2.0, 0.0), true).unwrap();
        assert!(matches!(tree.lookup("base_footprint", "laser", 5), Lookup::Found(p) if p.translation.x == 3.0));
    }

    #[test]
    fn two_parents_and_loops_are_refused() {
        let mut tree = FrameTree::default();
        tree.insert("a", "b", 0, pose(0.0, 0.0), true).unwrap();
        tree.insert("b", "c", 0, pose(0.0, 0.0), true).unwrap();
        let e = tree.insert("a", "c", 0, pose(0.0, 0.0), true).unwrap_err();
        assert!(e.to_string().contains("two parents, \"b\" and \"a\""), "{e}");
        let e = tree.insert("c", "a", 0, pose(0.0, 0.0), true).unwrap_err();
        assert!(e.to_string().contains("parents of each other"), "{e}");
    }

    #[test]
    fn forgetting_keeps_what_later_lookups_need() {
        let mut tree = FrameTree::default();
        for stamp in 0..100 {
            tree.insert("odom", "base", stamp * 10, pose(stamp as f64, 0.0), false).unwrap();
        }
        let before = tree.lookup("odom", "base", 555);
        tree.forget_before(555);
        assert_eq!(tree.lookup("odom", "base", 555), before);
        assert_eq!(tree.edges["base"].samples.len(), 45);
    }
}
