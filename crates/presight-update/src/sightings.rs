//! Where in space features are found that the layer lacks, view by view.

use crate::located::{Eye, across};
use crate::view::{BOUND, FLATTEST};
use glam::{DMat3, DVec2, DVec3};
use presight_localize::matching::{Detection, Shape};
use presight_model::caster::RayCaster;

/// Most places of new features: beyond them new ones are left out, so that memory stays bounded.
const MOST: usize = 1000;
/// A place without a measured range is on the surface behind it in the image. Views from one place agree on anything; so they
/// have to be this far apart, metres.
const APART: f64 = 0.25;

/// What a sighting is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Reflector,
    Corner,
    Edge,
}

/// One point of a sighting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Spot {
    /// Where it is, world, metres.
    pub p: DVec3,
    /// Covariance by the sensor, world axes, metres squared,
    pub own: DMat3,
    /// and by the pose, which all views of a run share in part.
    pub by_pose: DMat3,
}

/// A feature in one view.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Sighting {
    pub class: String,
    pub kind: Kind,
    /// A point, or both ends of an edge.
    pub spots: Vec<Spot>,
    /// Where the sensor was, world, metres.
    pub from: DVec3,
    pub strength: Option<f64>,
    pub contrast: Option<f64>,
}

fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(b.x * a, b.y * a, b.z * a)
}

/// The place of a detection: a reflector by its range, a corner or an edge on the surface where its rays end. `None` for what
/// has no place.
pub(crate) fn place_of(eye: &Eye<'_>, detection: &Detection, caster: &RayCaster) -> Option<Sighting> {
    let spot = |at: DVec2| {
        let (ray, steps) = eye.ray(at)?;
        let (range, slide, along) = match (&detection.shape, &detection.properties.range) {
            (Shape::Reflector(_), Some(range)) => (range.mean, DMat3::IDENTITY, range.variance),
            (Shape::Reflector(_), None) => return None,
            _ => {
                let met = caster.cast(eye.place(), ray, eye.sensor.spec().range_max.min(1e5), None)?;
                let cos = met.normal.dot(ray);
                if cos.abs() < FLATTEST {
                    return None;
                }
                // An error across the ray slides the point along the surface.
                (met.range, DMat3::IDENTITY - outer(ray, met.normal) * cos.recip(), 0.0)
            }
        };
        let p = eye.place() + range * ray;
        let pose = eye.by_pose(&[p]);
        let pose = DMat3::from_cols_array_2d(&std::array::from_fn(|j| std::array::from_fn(|i| pose[i][j])));
        // A millimetre keeps it regular.
        let own = slide * across(detection, steps, range) * slide.transpose()
            + along * outer(ray, ray)
            + DMat3::from_diagonal(DVec3::splat(1e-6));
        Some(Spot { p, own, by_pose: slide * pose * slide.transpose() })
    };
    let (kind, mut spots) = match &detection.shape {
        Shape::Reflector(at) => (Kind::Reflector, vec![spot(*at)?]),
        Shape::Point(at) => (Kind::Corner, vec![spot(*at)?]),
        Shape::Segment { ends, .. } => (Kind::Edge, vec![spot(ends[0])?, spot(ends[1])?]),
        Shape::Patch(_) | Shape::Fiducial(_) => return None,
    };
    if let [a, b] = &mut spots[..] {
        // Edges are broken anywhere along them.
        let along = b.p - a.p;
        a.own += 0.25 * outer(along, along);
        b.own += 0.25 * outer(along, along);
    }
    let properties = &detection.properties;
    let (strength, contrast) = (properties.strength, properties.contrast);
    Some(Sighting { class: eye.sensor.spec().class.clone(), kind, spots, from: eye.place(), strength, contrast })
}

/// Sums over the sightings of one point.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Mean {
    information: DMat3,
    weighted: DVec3,
    by_pose: DMat3,
}

impl Mean {
    /// Without sightings. A matrix is one by default, not zero.
    const NONE: Self = Self { information: DMat3::ZERO, weighted: DVec3::ZERO, by_pose: DMat3::ZERO };
}

/// One place in space, seen from several views.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Track {
    pub class: String,
    pub kind: Kind,
    pub views: u32,
    /// Stamp of the last view, seconds.
    pub last: f64,
    pub from: DVec3,
    /// Sums and numbers of measured strengths and contrasts.
    pub strength: (f64, f64),
    pub contrast: (f64, f64),
    means: Vec<Mean>,
}

impl Track {
    /// The most likely places of its points, world, metres, and their covariances. The part of the poses does not shrink with more
    /// views.
    pub fn places(&self) -> Vec<(DVec3, DMat3)> {
        let place = |mean: &Mean| {
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
            means: vec![Mean::NONE; seen.spots.len()],
        };
        track.add(seen, &seen.spots, stamp);
        track
    }

    /// Adds a sighting, whose spots are in the track's order.
    fn add(&mut self, seen: &Sighting, spots: &[Spot], stamp: f64) {
        (self.views, self.last, self.from) = (self.views + 1, stamp, seen.from);
        for (mean, spot) in self.means.iter_mut().zip(spots) {
            let information = spot.own.inverse();
            mean.information += information;
            mean.weighted += information * spot.p;
            mean.by_pose += spot.by_pose;
        }
        for (sum, value) in [(&mut self.strength, seen.strength), (&mut self.contrast, seen.contrast)] {
            *sum = value.map_or(*sum, |value| (sum.0 + value, sum.1 + 1.0));
        }
    }

    /// The spots of a sighting in the order of the track's points.
    fn ordered(&self, seen: &Sighting) -> Vec<Spot> {
        let mut spots = seen.spots.clone();
        if let ([(a, _), (b, _)], [first, last]) = (&self.places()[..], &spots[..])
            && (*b - *a).dot(last.p - first.p) < 0.0
        {
            spots.reverse();
        }
        spots
    }

    /// Whether a sighting is of this place: the largest squared distance of its points in variances, if noise explains it.
    fn explains(&self, seen: &Sighting) -> Option<f64> {
        if self.class != seen.class || self.kind != seen.kind {
            return None;
        }
        let away = |((place, covariance), spot): ((DVec3, DMat3), &Spot)| {
            let off = spot.p - place;
            off.dot((covariance + spot.own + spot.by_pose).inverse() * off)
        };
        let worst = self.places().into_iter().zip(&self.ordered(seen)).map(away).fold(0.0, f64::max);
        // In three dimensions; BOUND is for one.
        (worst <= BOUND * BOUND + 5.4).then_some(worst)
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
            let candidates = self.0[..known].iter().enumerate().filter(|(at, _)| !taken[*at]);
            let near = candidates.filter_map(|(at, track)| Some((at, track.explains(sighting)?)));
            if let Some((at, _)) = near.min_by(|a, b| a.1.total_cmp(&b.1)) {
                taken[at] = true;
                let track = &mut self.0[at];
                if sighting.kind == Kind::Reflector || track.from.distance(sighting.from) >= APART {
                    let spots = track.ordered(sighting);
                    track.add(sighting, &spots, stamp);
                }
            } else if self.0.len() < MOST {
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
        let spots = points.iter().map(|p| Spot { p: *p, own, by_pose: own }).collect();
        let from = DVec3::new(from, 0.0, 0.0);
        Sighting { class: "laser".into(), kind, spots, from, strength: Some(0.5), contrast: None }
    }

    /// Two reflectors 0.5 m apart, seen by three views that err by up to 2 cm, and a glint elsewhere in each view.
    #[test]
    fn views_meet_at_places() {
        let mut tracks = Tracks::default();
        for (view, off) in [0.02, -0.02, 0.0].into_iter().enumerate() {
            let (a, b) = (DVec3::new(2.0 + off, 0.0, 1.0), DVec3::new(2.0, 0.5 + off, 1.0));
            let glint = DVec3::new(9.0, 3.0 * view as f64, 1.0);
            tracks.add(&[b, a, glint].map(|p| seen(Kind::Reflector, 0.0, &[p])), view as f64);
        }
        let sure: Vec<&Track> = tracks.iter().filter(|t| t.views == 3).collect();
        assert_eq!(sure.len(), 2);
        let (place, covariance) = sure[1].places()[0];
        assert!(place.distance(DVec3::new(2.0, 0.0, 1.0)) < 1e-9);
        // By hand: three views of 1 cm each, and the part of the poses as it was.
        assert!((covariance.x_axis.x - (1e-4 / 3.0 + 1e-4)).abs() < 1e-12);
    }

    /// Corners have no range: four views from two places, 0.2 m and then 0.3 m on, are three. The ends of an edge come in any order.
    #[test]
    fn corners_are_seen_from_several_places_and_edges_from_both_ends() {
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
