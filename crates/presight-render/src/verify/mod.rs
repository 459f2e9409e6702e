//! Comparison of two predictions: the single criterion of correctness, for every engine and every test.
//!
//! A pixel is
//! - **same** if it has the reference's id and every requested output is within its bound (derived in [`bound`]);
//! - **edge** if it shows another polygon, or nothing, and the reference's candidate set there ([`candidates()`])
//!   contains that, with all outputs within bounds;
//! - **coincident** if that other polygon is in the reference's plane and both are certain hits, because models store
//!   some faces twice;
//! - a **fault** otherwise. There must be no faults, and few edge pixels: [`Report::check`].

pub mod bound;
mod candidates;
mod pixel;

pub use bound::PlaneBound;
pub use bound::Precision;
pub use bound::SET_UP_FINELY;
pub use bound::is_set_up_finely;
use candidates::PlaneCandidate;
pub use candidates::{Candidate, CandidateSet, candidates};
pub use pixel::{BoundShares, PixelValues, Tolerances};
pub use {bound::FaceBound, candidates::span, pixel::ulp};

use crate::plan::{FramePlan, Images, Instance, Output};
use crate::reference::instances;
use pixel::{Lookup, pixel};
use presight_model::error::{Error, Result};
use presight_model::limits::LISTED_PROBLEMS;
use serde::Serialize;

/// Result of a comparison.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// Pixels compared.
    pub pixels: usize,
    /// Pixels that are the same.
    pub same: usize,
    /// Pixels at an edge or tie, with another id that a correct engine may show.
    pub edge: usize,
    /// Pixels with another id of a face that is stored more than once.
    pub coincident: usize,
    /// Pixels that one of the two gave up for a deadline. They are not compared and not included in `pixels`.
    pub not_predicted: usize,
    /// Wrong pixels.
    pub fault: usize,
    /// The largest error among same pixels, as a share of its bound.
    pub worst: BoundShares,
    /// The pixel (column, row) with the largest share.
    pub worst_pixel: Option<(u32, u32)>,
    /// The first faults.
    pub faults: Vec<Fault>,
}

/// A wrong pixel.
#[derive(Clone, Debug, Serialize)]
pub struct Fault {
    /// Image column.
    pub column: u32,
    /// Image row.
    pub row: u32,
    /// Values of the reference.
    pub reference: PixelValues,
    /// Values of the other image.
    pub other: PixelValues,
    /// The values that would be correct.
    pub why: String,
}

impl Report {
    /// Adds another comparison's counts, worst shares and faults.
    pub fn add(&mut self, other: Self) {
        self.pixels += other.pixels;
        self.same += other.same;
        self.edge += other.edge;
        self.coincident += other.coincident;
        self.not_predicted += other.not_predicted;
        self.fault += other.fault;
        if other.worst.most() > self.worst.most() {
            self.worst_pixel = other.worst_pixel;
        }
        self.worst = self.worst.max(other.worst);
        let room = LISTED_PROBLEMS.saturating_sub(self.faults.len());
        self.faults.extend(other.faults.into_iter().take(room));
    }

    /// Share of pixels at edges and ties.
    pub fn edge_share(&self) -> f64 {
        self.edge as f64 / self.pixels.max(1) as f64
    }

    /// Fails for any fault, and if the share of edge pixels is too large (a few are always allowed).
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] with the first fault.
    pub fn check(&self, max_edge_share: f64) -> Result<()> {
        if let Some(first) = self.faults.first() {
            return Err(Error::invalid(
                format!("{} of {} pixels are wrong: {}", self.fault, self.pixels, first.why),
                "one of the two images is at fault",
            )
            .at(format!("pixel ({}, {})", first.column, first.row)));
        }
        if self.edge > 4 && self.edge_share() > max_edge_share {
            return Err(Error::invalid(
                format!(
                    "{} of {} pixels are at edges, more than a share of {max_edge_share:e}",
                    self.edge, self.pixels
                ),
                "the edges deviate too much",
            ));
        }
        Ok(())
    }

    fn judge(&mut self, at: (u32, u32), verdict: PixelClass, reference: PixelValues, other: PixelValues) {
        self.pixels += 1;
        match verdict {
            PixelClass::Same(shares) => {
                self.same += 1;
                if shares.most() > self.worst.most() {
                    self.worst_pixel = Some(at);
                }
                self.worst = self.worst.max(shares);
            }
            PixelClass::Edge => self.edge += 1,
            PixelClass::Coincident => self.coincident += 1,
            PixelClass::Fault(why) => {
                self.fault += 1;
                if self.faults.len() < LISTED_PROBLEMS {
                    self.faults.push(Fault { column: at.0, row: at.1, reference, other, why });
                }
            }
        }
    }
}

enum PixelClass {
    Same(BoundShares),
    Edge,
    Coincident,
    Fault(String),
}

/// Compares two predictions, where `partial` gave something up (see [`crate::deadline::Degradation`]). `compare`
/// compares the others; pixels missing in `partial` are only counted.
///
/// # Errors
/// Same as the comparison's.
pub fn compare_partial(
    whole: &Images,
    partial: &Images,
    compare: impl FnOnce(&Images, &Images) -> Result<Report>,
) -> Result<Report> {
    check_shape(whole, partial)?;
    let (mut filled, mut not_predicted) = (partial.clone(), 0);
    for at in (0..whole.pixels()).filter(|at| partial.is_open(*at) && !whole.is_open(*at)) {
        not_predicted += 1;
        filled.copy_pixel(whole, at);
    }
    let mut report = compare(whole, &filled)?;
    report.not_predicted = not_predicted;
    report.pixels -= not_predicted;
    report.same -= not_predicted;
    Ok(report)
}

/// Compares an engine's images with the reference's. Every different pixel is a fault.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if sizes or outputs differ.
pub fn compare_exactly(reference: &Images, other: &Images) -> Result<Report> {
    check_shape(reference, other)?;
    let mut report = Report::default();
    for at in 0..reference.pixels() {
        let (r, o) = (PixelValues::of(reference, at), PixelValues::of(other, at));
        let same = r.identical(&o);
        let verdict =
            if same { PixelClass::Same(BoundShares::default()) } else { PixelClass::Fault(format!("{o} is not {r}")) };
        report.judge(pixel(reference.width, at), verdict, r, o);
    }
    Ok(report)
}

/// Compares an engine's images with the reference's, within the bounds for the scene that both show.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if sizes or outputs differ, from each other or from the plan's sensor.
pub fn compare(reference: &Images, other: &Images, plan: &FramePlan, precision: Precision) -> Result<Report> {
    check_shape(reference, other)?;
    if (reference.width, reference.height) != (plan.sensor.width(), plan.sensor.height()) {
        return Err(Error::invalid(
            "the images do not have the size of the plan's sensor",
            "use the plan that made the images",
        ));
    }
    let all = (0..reference.pixels()).map(|at| (pixel(reference.width, at), at));
    Ok(compare_values(
        all.map(|(p, at)| (p, PixelValues::of(reference, at), PixelValues::of(other, at))),
        plan,
        precision,
    ))
}

/// Compares individual pixels, for images that are only partly known: (column, row), reference, other.
pub fn compare_values(
    pixels: impl Iterator<Item = ((u32, u32), PixelValues, PixelValues)>,
    plan: &FramePlan,
    precision: Precision,
) -> Report {
    let mut report = Report::default();
    for (plan, pixels) in plan.by_bundle(pixels, |(pixel, ..)| *pixel) {
        report.add(compare_from_one_pose(pixels.into_iter(), &plan, precision));
    }
    report
}

/// [`compare_values`], of pixels for which the plan's pose holds.
fn compare_from_one_pose(
    pixels: impl Iterator<Item = ((u32, u32), PixelValues, PixelValues)>,
    plan: &FramePlan,
    precision: Precision,
) -> Report {
    let mut judge = PixelCheck { plan, precision, instances: instances(plan), lookup: Lookup::new(plan), last: None };
    let mut report = Report::default();
    let mut unclear = Vec::new();
    for (at, reference, other) in pixels {
        match judge.at_a_glance(at, &reference, &other) {
            Some(verdict) => report.judge(at, verdict, reference, other),
            None => unclear.push((at, reference, other)),
        }
    }
    let places: Vec<(u32, u32)> = unclear.iter().map(|(at, ..)| *at).collect();
    for ((at, reference, other), set) in unclear.into_iter().zip(candidates(plan, &places, precision)) {
        let verdict = judge.by_candidates(&set, &reference, &other);
        report.judge(at, verdict, reference, other);
    }
    report
}

/// The tolerances of the outputs at a pixel, above the reference's values; `None` without a hit.
pub fn allowed(
    reference: &Images,
    plan: &FramePlan,
    (column, row): (u32, u32),
    precision: Precision,
) -> Option<Tolerances> {
    let values = PixelValues::of(reference, row as usize * reference.width as usize + column as usize);
    let (object, polygon) = Lookup::new(plan).find(plan, values.polygon_id?)?;
    let ray = plan.sensor.ray(column, row)?;
    let pose = plan.bundles().map_or(&plan.world_from_sensor, |poses| poses.of_pixel(column, row));
    let c = PlaneCandidate::new(plan, &plan.instance_from(pose, object), polygon, precision).at(ray);
    Some(Tolerances::above(&c, &values, precision))
}

fn check_shape(reference: &Images, other: &Images) -> Result<()> {
    let sizes = [reference, other].map(|i| (i.width, i.height));
    if sizes[0] != sizes[1] {
        return Err(Error::invalid(
            format!("{} x {} pixels against {} x {}", sizes[0].0, sizes[0].1, sizes[1].0, sizes[1].1),
            "compare images of one sensor",
        ));
    }
    for image in [reference, other] {
        for output in Output::ALL {
            if image.samples(output).is_some_and(|samples| samples.len() != image.pixels()) {
                return Err(Error::invalid(format!("{} lacks pixels", output.name()), "the image is truncated"));
            }
        }
    }
    if reference.outputs() != other.outputs() && reference.pixels() > 0 {
        let names = [reference, other].map(|i| i.outputs().iter().map(Output::name).collect::<Vec<_>>().join(","));
        return Err(Error::invalid(
            format!("outputs {} against {}", names[0], names[1]),
            "request the same outputs from both engines",
        ));
    }
    Ok(())
}

struct PixelCheck<'a> {
    plan: &'a FramePlan,
    precision: Precision,
    instances: Vec<Instance>,
    lookup: Lookup,
    /// The last polygon that was compared: the next pixel mostly shows the same one.
    last: Option<(u32, PlaneCandidate)>,
}

impl PixelCheck<'_> {
    /// Decides pixels without candidates: identical ones, and the same polygon within the bounds.
    fn at_a_glance(
        &mut self,
        (column, row): (u32, u32),
        reference: &PixelValues,
        other: &PixelValues,
    ) -> Option<PixelClass> {
        if reference.identical(other) {
            return Some(PixelClass::Same(BoundShares::default()));
        }
        let id = reference.polygon_id.filter(|id| *id != 0 && Some(*id) == other.polygon_id)?;
        if self.last.as_ref().is_none_or(|(known, _)| *known != id) {
            let (object, polygon) = self.lookup.find(self.plan, id)?;
            let instance = &self.instances[object as usize];
            self.last = Some((id, PlaneCandidate::new(self.plan, instance, polygon, self.precision)));
        }
        let (_, on_plane) = self.last.as_ref()?;
        let c = on_plane.at(self.plan.sensor.ray(column, row)?);
        let shares = other.off(&c, Some(reference), self.plan.sensor.spec(), self.precision)?;
        (shares.most() <= 1.0).then_some(PixelClass::Same(shares))
    }

    fn by_candidates(&self, set: &CandidateSet, reference: &PixelValues, other: &PixelValues) -> PixelClass {
        if set.no_ray {
            return PixelClass::Fault(format!(
                "there is no ray here, but it shows {}",
                if other.is_no_ray() { reference } else { other }
            ));
        }
        if other.is_miss() && set.may_miss {
            return PixelClass::Edge;
        }
        let spec = self.plan.sensor.spec();
        let fits = |v: &PixelValues, base: Option<&PixelValues>, c: &Candidate| {
            v.off(c, base, spec, self.precision).filter(|s| s.most() <= 1.0)
        };
        let shown_by_reference = |c: &Candidate| fits(reference, None, c).is_some();
        // Relative to the reference's values if both show the same polygon.
        let shown = |c: &Candidate| fits(other, shown_by_reference(c).then_some(reference), c);
        // Without ids several polygons may fit. If one of them fits both images, the images agree.
        let common = set.candidates.iter().filter(|c| shown_by_reference(c)).find_map(shown);
        if let Some(shares) = common {
            return PixelClass::Same(shares);
        }
        let Some(shown) = set.candidates.iter().find(|c| shown(c).is_some()) else {
            return PixelClass::Fault(why(set, other));
        };
        let twice = set.candidates.iter().any(|c| shown_by_reference(c) && c.coincides_with(shown));
        if twice { PixelClass::Coincident } else { PixelClass::Edge }
    }
}

/// Describes the correct values.
fn why(set: &CandidateSet, other: &PixelValues) -> String {
    let mut right: Vec<String> = set
        .candidates
        .iter()
        .take(6)
        .map(|c| {
            let sure = if c.sure { "" } else { "perhaps " };
            format!("{sure}polygon {} at {:.9} m within {:.3e}", c.polygon_id, c.range, c.farthest - c.range)
        })
        .collect();
    if set.candidates.len() > 6 {
        right.push(format!("{} more", set.candidates.len() - 6));
    }
    if set.may_miss {
        right.push("nothing".into());
    }
    format!("{other}, where only {} would be right", right.join(" or "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Outputs;

    #[test]
    fn what_was_given_up_is_counted_and_not_compared() {
        let mut whole = Images::default();
        whole.prepare(2, 1, Outputs::of(&[Output::Range]));
        let mut partial = whole.clone();
        partial.range[1] = f32::NAN;
        assert_eq!(compare_exactly(&whole, &partial).unwrap().fault, 1);
        let report = compare_partial(&whole, &partial, compare_exactly).unwrap();
        assert_eq!((report.fault, report.same, report.not_predicted), (0, 1, 1));
    }
}
