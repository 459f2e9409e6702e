//! Places of features that the layer lacks.

use crate::evidence::features::located::{SensorAtPose, across};
use crate::observe::view::{MIN_COSINE, reach_of};
use glam::{DMat3, DVec2, DVec3};
use presight_localize::matching::{Detection, Shape};
use presight_model::caster::RayCaster;
use presight_model::statistics::NOISE_BOUND;

/// Maximum number of new features, which bounds the memory. Further features are left out.
const MAX_TRACKS: usize = 1000;
/// Minimum distance between the views of a feature without a range, metres. It is placed on the surface behind it in
/// the image, and views from one place agree on any surface.
const MIN_BASELINE: f64 = 0.25;

/// Sum and number of measured values.
pub(crate) type Mean = (f64, f64);

/// Adds a measured value to a sum.
pub(crate) fn add_value(sum: &mut Mean, value: Option<f64>) {
    *sum = value.map_or(*sum, |value| (sum.0 + value, sum.1 + 1.0));
}

/// The kind of a feature that is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Reflector,
    Corner,
    Edge,
}

/// One point of a sighting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SightedPoint {
    /// World, metres.
    pub p: DVec3,
    /// Covariance by the sensor, world axes, square metres.
    pub own: DMat3,
    /// Covariance by the pose, which the views of a run share in part.
    pub by_pose: DMat3,
}

/// A feature in one view.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Sighting {
    pub class: String,
    pub kind: Kind,
    /// A point, or both ends of an edge.
    pub points: Vec<SightedPoint>,
    /// Position of the sensor, world, metres.
    pub from: DVec3,
    pub strength: Option<f64>,
    pub contrast: Option<f64>,
}

fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(b.x * a, b.y * a, b.z * a)
}

/// The place of a detection: a reflector is placed by its range, a corner or an edge on the surface that its rays meet.
/// `None` for a detection without a place.
pub(crate) fn place_of(sensor: &SensorAtPose<'_>, detection: &Detection, caster: &RayCaster) -> Option<Sighting> {
    let point_at = |at: DVec2| {
        let (ray, steps) = sensor.ray(at)?;
        let (range, slide, along) = match (&detection.shape, &detection.properties.range) {
            (Shape::Reflector(_), Some(range)) => (range.mean, DMat3::IDENTITY, range.variance),
            (Shape::Reflector(_), None) => return None,
            _ => {
                let hit = caster.cast(sensor.position(), ray, reach_of(sensor.sensor.spec()), None)?;
                let cos = hit.normal.dot(ray);
                if cos.abs() < MIN_COSINE {
                    return None;
                }
                // An error across the ray moves the point along the surface.
                (hit.range, DMat3::IDENTITY - outer(ray, hit.normal) * cos.recip(), 0.0)
            }
        };
        let p = sensor.position() + range * ray;
        let pose = sensor.by_pose(&[p]);
        let pose = DMat3::from_cols_array_2d(&std::array::from_fn(|j| std::array::from_fn(|i| pose[i][j])));
        // A deviation of a millimetre keeps the covariance regular.
        let own = slide * across(detection, steps, range) * slide.transpose()
            + along * outer(ray, ray)
            + DMat3::from_diagonal(DVec3::splat(1e-6));
        Some(SightedPoint { p, own, by_pose: slide * pose * slide.transpose() })
    };
    let (kind, mut points) = match &detection.shape {
        Shape::Reflector(at) => (Kind::Reflector, vec![point_at(*at)?]),
        Shape::Point(at) => (Kind::Corner, vec![point_at(*at)?]),
        Shape::Segment { ends, .. } => (Kind::Edge, vec![point_at(ends[0])?, point_at(ends[1])?]),
        Shape::Patch(_) | Shape::Fiducial(_) => return None,
    };
    if let [a, b] = &mut points[..] {
        // A detected edge may end anywhere along the real one.
        let along = b.p - a.p;
        a.own += 0.25 * outer(along, along);
        b.own += 0.25 * outer(along, along);
    }
    let properties = &detection.properties;
    let (strength, contrast) = (properties.strength, properties.contrast);
    Some(Sighting {
        class: sensor.sensor.spec().class.clone(),
        kind,
        points,
        from: sensor.position(),
        strength,
        contrast,
    })
}

/// Sums over the sightings of one point.
#[derive(Clone, Copy, Debug, PartialEq)]
struct PointSums {
    information: DMat3,
    weighted: DVec3,
    by_pose: DMat3,
}

impl PointSums {
    /// No sightings. The default of a matrix is the identity.
    const NONE: Self = Self { information: DMat3::ZERO, weighted: DVec3::ZERO, by_pose: DMat3::ZERO };
}

/// One feature, seen in several views.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Track {
    pub class: String,
    pub kind: Kind,
    pub views: u32,
    /// Stamp of the last view, seconds.
    pub last: f64,
    /// Position of the sensor in the last view, world, metres.
    pub from: DVec3,
    pub strength: Mean,
    pub contrast: Mean,
    means: Vec<PointSums>,
}

impl Track {
    /// The most likely places of its points, world, metres, and their covariances. The error of the poses does not
    /// average out over the views.
    pub fn places(&self) -> Vec<(DVec3, DMat3)> {
        let place = |mean: &PointSums| {
            let own = mean.information.inverse();
            (own * mean.weighted, own + mean.by_pose * (1.0 / f64::from(self.views)))
        };
        self.means.iter().map(place).collect()
    }

    fn new(seen: &Sighting, stamp: f64) -> Self {
        let mut track = Self {
            class: seen.class.clone(),
            kind: seen.kind,
            views: 0,
            last: stamp,
            from: seen.from,
            strength: (0.0, 0.0),
            contrast: (0.0, 0.0),
            means: vec![PointSums::NONE; seen.points.len()],
        };
        track.add(seen, &seen.points, stamp);
        track
    }

    /// Adds a sighting, with its points in the order of the track.
    fn add(&mut self, seen: &Sighting, points: &[SightedPoint], stamp: f64) {
        (self.views, self.last, self.from) = (self.views + 1, stamp, seen.from);
        for (mean, spot) in self.means.iter_mut().zip(points) {
            let information = spot.own.inverse();
            mean.information += information;
            mean.weighted += information * spot.p;
            mean.by_pose += spot.by_pose;
        }
        add_value(&mut self.strength, seen.strength);
        add_value(&mut self.contrast, seen.contrast);
    }

    /// The points of a sighting in the order of the track.
    fn ordered(&self, seen: &Sighting) -> Vec<SightedPoint> {
        let mut points = seen.points.clone();
        if let ([(a, _), (b, _)], [first, last]) = (&self.places()[..], &points[..])
            && (*b - *a).dot(last.p - first.p) < 0.0
        {
            points.reverse();
        }
        points
    }

    /// The largest squared distance of a sighting's points from this feature's, in variances; `None` if noise does not
    /// explain it.
    fn explains(&self, seen: &Sighting) -> Option<f64> {
        if self.class != seen.class || self.kind != seen.kind {
            return None;
        }
        let away = |((place, covariance), spot): ((DVec3, DMat3), &SightedPoint)| {
            let off = spot.p - place;
            off.dot((covariance + spot.own + spot.by_pose).inverse() * off)
        };
        let worst = self.places().into_iter().zip(&self.ordered(seen)).map(away).fold(0.0, f64::max);
        // The bound of chi-squared with three degrees of freedom; NOISE_BOUND is that of one.
        (worst <= NOISE_BOUND * NOISE_BOUND + 5.4).then_some(worst)
    }
}

/// The features that the layers lack.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Tracks(Vec<Track>);

impl Tracks {
    pub fn iter(&self) -> impl Iterator<Item = &Track> {
        self.0.iter()
    }

    /// Adds the sightings of one view, each to the nearest feature that explains it, or as a new feature. A feature
    /// takes one sighting of a view.
    pub fn add(&mut self, seen: &[Sighting], stamp: f64) {
        let known = self.0.len();
        let mut taken = vec![false; known];
        for sighting in seen {
            let candidates = self.0[..known].iter().enumerate().filter(|(at, _)| !taken[*at]);
            let near = candidates.filter_map(|(at, track)| Some((at, track.explains(sighting)?)));
            if let Some((at, _)) = near.min_by(|a, b| a.1.total_cmp(&b.1)) {
                taken[at] = true;
                let track = &mut self.0[at];
                if sighting.kind == Kind::Reflector || track.from.distance(sighting.from) >= MIN_BASELINE {
                    let points = track.ordered(sighting);
                    track.add(sighting, &points, stamp);
                }
            } else if self.0.len() < MAX_TRACKS {
                self.0.push(Track::new(sighting, stamp));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(kind: Kind, from: f64, points: &[DVec3]) -> Sighting {
        let own = DMat3::from_diagonal(DVec3::splat(1e-4));
        let points = points.iter().map(|p| SightedPoint { p: *p, own, by_pose: own }).collect();
        let from = DVec3::new(from, 0.0, 0.0);
        Sighting { class: "laser".into(), kind, points, from, strength: Some(0.5), contrast: None }
    }

    /// Two reflectors at a distance of 0.5 m, seen in three views with errors of up to 2 cm, and a glint elsewhere in
    /// each view.
    #[test]
    fn sightings_are_joined_by_place() {
        let mut tracks = Tracks::default();
        for (view, off) in [0.02, -0.02, 0.0].into_iter().enumerate() {
            let (a, b) = (DVec3::new(2.0 + off, 0.0, 1.0), DVec3::new(2.0, 0.5 + off, 1.0));
            let glint = DVec3::new(9.0, 3.0 * view as f64, 1.0);
            tracks.add(&[b, a, glint].map(|p| seen(Kind::Reflector, 0.0, &[p])), view as f64);
        }
        let found: Vec<&Track> = tracks.iter().filter(|t| t.views == 3).collect();
        assert_eq!(found.len(), 2);
        let (place, covariance) = found[1].places()[0];
        assert!(place.distance(DVec3::new(2.0, 0.0, 1.0)) < 1e-9);
        // By hand: three views of 1 cm each, and the undiminished covariance of the poses.
        assert!((covariance.x_axis.x - (1e-4 / 3.0 + 1e-4)).abs() < 1e-12);
    }

    /// Corners have no range, so the second of four views, 0.2 m after the first, does not count. The ends of an edge
    /// have any order.
    #[test]
    fn corners_need_a_baseline_and_edges_have_no_direction() {
        let (a, b) = (DVec3::new(2.0, 0.0, 1.0), DVec3::new(2.0, 1.0, 1.0));
        let mut tracks = Tracks::default();
        for from in [0.0, 0.2, 0.3, 0.6] {
            let ends = if from == 0.3 { [b, a] } else { [a, b] };
            tracks.add(&[seen(Kind::Corner, from, &[a]), seen(Kind::Edge, from, &ends)], from);
        }
        assert_eq!(tracks.iter().map(|t| (t.kind, t.views)).collect::<Vec<_>>(), [(Kind::Corner, 3), (Kind::Edge, 3)]);
        let edge = tracks.iter().nth(1).unwrap().places();
        assert!(edge[0].0.distance(a) < 1e-9 && edge[1].0.distance(b) < 1e-9, "{edge:?}");
    }
}
