//! Where in space reflectors are found, view by view.

use crate::view::BOUND;
use glam::{DMat3, DVec3};
use presight_localize::matching::{Detection, Shape};
use presight_localize::verdict::body_from_image;
use presight_model::geometry::PoseEstimate;
use presight_model::sensor::Sensor;

/// Most places of new reflectors: beyond them new ones are left out, so that memory stays bounded.
const MOST: usize = 1000;

/// A reflector in one view.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Sighting {
    pub class: String,
    /// Where it is, world, metres.
    pub p: DVec3,
    /// Covariance by the sensor, world axes, metres squared,
    pub own: DMat3,
    /// and by the pose, which all views of a run share in part.
    pub by_pose: DMat3,
    /// Where the sensor was, world, metres.
    pub from: DVec3,
    pub strength: Option<f64>,
}

/// The place of a reflector's detection; `None` for what has no measured range.
pub(crate) fn place_of(sensor: &Sensor, detection: &Detection, pose: &PoseEstimate) -> Option<Sighting> {
    let (Shape::Reflector(at), Some(range)) = (&detection.shape, detection.properties.range) else { return None };
    let world_from_image = pose.world_from_robot * sensor.spec().mount * body_from_image(sensor);
    // A scanner of one row says nothing of heights: what it finds is in its plane.
    let rows = if sensor.height() == 1 { 0.0 } else { 1.0 };
    let along = |du: f64, dv: f64| sensor.ray_at(at.x + du, rows * (at.y + dv));
    let ray = along(0.0, 0.0)?;
    let step = |du: f64, dv: f64| along(du, dv).map_or(DVec3::ZERO, |there| range.mean * (there - ray) / 0.1);
    let (u, v) = (step(0.1, 0.0), step(0.0, 0.1));
    let c = detection.covariance;
    let outer = |a: DVec3, b: DVec3| DMat3::from_cols(b.x * a, b.y * a, b.z * a);
    let across =
        c.x_axis.x * outer(u, u) + rows * (c.x_axis.y * (outer(u, v) + outer(v, u)) + c.y_axis.y * outer(v, v));
    // A millimetre keeps it regular.
    let own = across + range.variance * outer(ray, ray) + DMat3::from_diagonal(DVec3::splat(1e-6));
    let turn = DMat3::from_quat(world_from_image.rotation);
    let p = world_from_image.transform_point(range.mean * ray);
    let arm = p - pose.world_from_robot.translation;
    let rows_of = pose.covariance.as_rows();
    let gradient = |axis: DVec3| {
        let turned = arm.cross(axis);
        [axis.x, axis.y, axis.z, turned.x, turned.y, turned.z]
    };
    let j = [DVec3::X, DVec3::Y, DVec3::Z].map(gradient);
    let product = |a: usize, b: usize| -> f64 {
        (0..6).map(|i| j[a][i] * (0..6).map(|k| rows_of[i][k] * j[b][k]).sum::<f64>()).sum()
    };
    let column = |b: usize| DVec3::new(product(0, b), product(1, b), product(2, b));
    Some(Sighting {
        class: sensor.spec().class.clone(),
        p,
        own: turn * own * turn.transpose(),
        by_pose: DMat3::from_cols(column(0), column(1), column(2)),
        from: world_from_image.translation,
        strength: detection.properties.strength,
    })
}

/// One place in space, seen from several views.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Track {
    pub class: String,
    pub views: u32,
    /// Stamp of the last view, seconds.
    pub last: f64,
    pub from: DVec3,
    /// Sum and number of measured strengths.
    pub strength: (f64, f64),
    information: DMat3,
    weighted: DVec3,
    by_pose: DMat3,
}

impl Track {
    /// The most likely place, world, metres, and its covariance. The part of the poses does not shrink with more views.
    pub fn place(&self) -> (DVec3, DMat3) {
        let own = self.information.inverse();
        (own * self.weighted, own + self.by_pose / f64::from(self.views))
    }

    fn add(&mut self, seen: &Sighting, stamp: f64) {
        let information = seen.own.inverse();
        (self.views, self.last, self.from) = (self.views + 1, stamp, seen.from);
        (self.information, self.weighted) = (self.information + information, self.weighted + information * seen.p);
        self.by_pose += seen.by_pose;
        self.strength = seen.strength.map_or(self.strength, |s| (self.strength.0 + s, self.strength.1 + 1.0));
    }
}

/// Places in space, each of one thing.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Tracks(Vec<Track>);

impl Tracks {
    pub fn iter(&self) -> impl Iterator<Item = &Track> {
        self.0.iter()
    }

    /// Adds the sightings of one view: each to the nearest place that explains it, which takes one of a view, or as a new place.
    pub fn add(&mut self, seen: &[Sighting], stamp: f64) {
        let known = self.0.len();
        let mut taken = vec![false; known];
        for sighting in seen {
            let away = |track: &Track| {
                let (place, covariance) = track.place();
                let spread = covariance + sighting.own + sighting.by_pose;
                (sighting.p - place).dot(spread.inverse() * (sighting.p - place))
            };
            let candidates = self.0[..known].iter().enumerate();
            let near = candidates.filter(|(at, track)| !taken[*at] && track.class == sighting.class);
            let near = near.map(|(at, track)| (at, away(track))).min_by(|a, b| a.1.total_cmp(&b.1));
            // In three dimensions; BOUND is for one.
            if let Some((at, _)) = near.filter(|(_, d)| *d <= BOUND * BOUND + 5.4) {
                taken[at] = true;
                self.0[at].add(sighting, stamp);
            } else if self.0.len() < MOST {
                let mut track = Track {
                    class: sighting.class.clone(),
                    views: 0,
                    last: stamp,
                    from: sighting.from,
                    strength: (0.0, 0.0),
                    information: DMat3::ZERO,
                    weighted: DVec3::ZERO,
                    by_pose: DMat3::ZERO,
                };
                track.add(sighting, stamp);
                self.0.push(track);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(p: DVec3) -> Sighting {
        let own = DMat3::from_diagonal(DVec3::splat(1e-4));
        Sighting { class: "laser".into(), p, own, by_pose: own, from: DVec3::ZERO, strength: Some(0.5) }
    }

    /// Two reflectors 0.5 m apart, seen by three views that err by up to 2 cm, and a glint elsewhere in each view.
    #[test]
    fn views_meet_at_places() {
        let mut tracks = Tracks::default();
        for (view, off) in [0.02, -0.02, 0.0].into_iter().enumerate() {
            let (a, b) = (DVec3::new(2.0 + off, 0.0, 1.0), DVec3::new(2.0, 0.5 + off, 1.0));
            tracks.add(&[seen(b), seen(a), seen(DVec3::new(9.0, 3.0 * view as f64, 1.0))], view as f64);
        }
        let sure: Vec<&Track> = tracks.iter().filter(|t| t.views == 3).collect();
        assert_eq!(sure.len(), 2);
        assert!(sure[1].place().0.distance(DVec3::new(2.0, 0.0, 1.0)) < 1e-9);
        // By hand: three views of 1 cm each, and the part of the poses as it was.
        assert!((sure[1].place().1.x_axis.x - (1e-4 / 3.0 + 1e-4)).abs() < 1e-12);
    }
}
