//! Draft features before numbering, and the check that they lie on the surface.

use super::FeatureKind;
use super::effort::{Effort, steps};
use super::lines::boxes_along;
use super::patches::{Patch, parts};
use super::scanned::{PART, halves};
use super::soup::{Soup, grown};
use super::wings::Line;
use crate::lies_on;
use glam::DVec3;
use presight_model::environment::DEFAULT_TOLERANCE;
use presight_model::error::Result;
use presight_model::geometry::{Aabb, Pose};
use presight_model::index::QueryResult;
use rayon::prelude::*;
use std::cell::RefCell;

/// Maximum distance of a feature from the polygons, as a part of its tolerance. The rest is for patches that are off
/// their plane, and for rounding in other frames.
const NEAR: f64 = 0.75;

/// A feature without a number, in the world.
#[derive(Clone, Debug)]
pub(super) struct Draft {
    pub kind: FeatureKind,
    pub object: u32,
    pub points: Vec<DVec3>,
    pub normal: Option<DVec3>,
    /// Distance from its polygons that the layer has to allow, metres.
    pub tolerance: f64,
    /// True if it is a part of a patch that was split into its faces.
    pub is_part: bool,
}

impl Draft {
    pub fn new(kind: FeatureKind, object: u32, points: Vec<DVec3>) -> Self {
        Self { kind, object, points, normal: None, tolerance: DEFAULT_TOLERANCE, is_part: false }
    }

    /// Transforms the draft to the frame of its object.
    pub fn placed(mut self, world_from_object: &Pose) -> Self {
        let turn = world_from_object.rotation_matrix().transpose();
        for p in &mut self.points {
            *p = turn * (*p - world_from_object.translation);
        }
        self.normal = self.normal.map(|n| (turn * n).normalize());
        self
    }
}

pub(super) fn ordered(a: DVec3, b: DVec3) -> Vec<DVec3> {
    if by_place(&a, &b).is_gt() { vec![b, a] } else { vec![a, b] }
}

pub(super) fn by_place(a: &DVec3, b: &DVec3) -> std::cmp::Ordering {
    a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)).then(a.z.total_cmp(&b.z))
}

impl From<Patch> for Draft {
    fn from(p: Patch) -> Self {
        Self { normal: Some(p.normal), ..Self::new(p.kind, p.object, p.corners) }
    }
}

/// Keeps drafts that lie on the polygons. A joined patch that does not is split, and its parts of at least `least` m^2
/// that do are kept. `off` counts the drafts that are lost entirely.
pub(super) fn on_the_surface(
    soup: &Soup,
    drafts: Vec<Draft>,
    least: f64,
    off: &mut usize,
    effort: &Effort<'_>,
) -> Result<Vec<Draft>> {
    let stage = effort.stage("checking features", drafts.len());
    let kept: Vec<Vec<Draft>> = drafts
        .into_par_iter()
        .map_init(QueryResult::default, |found, draft| {
            stage.step();
            let (mut lying, mut open) = (Vec::new(), vec![draft]);
            while let Some(draft) = open.pop() {
                if draft.lies(soup, found, effort)? {
                    lying.push(draft);
                } else {
                    open.extend(draft.split(soup, least, found, effort)?);
                }
            }
            Ok(lying)
        })
        .collect::<Result<_>>()?;
    *off = kept.iter().filter(|of_one| of_one.is_empty()).count();
    Ok(kept.into_iter().flatten().collect())
}

impl Draft {
    /// Smaller patches in place of one that is off the polygons.
    fn split(&self, soup: &Soup, least: f64, found: &mut QueryResult, effort: &Effort<'_>) -> Result<Vec<Self>> {
        if self.tolerance > DEFAULT_TOLERANCE {
            return Ok(halves(self, PART * least));
        }
        if self.is_part || self.normal.is_none() {
            return Ok(Vec::new());
        }
        let parts = parts(soup, self, least, found, effort)?.into_iter();
        Ok(parts.map(|part| Self { is_part: true, ..Self::from(part) }).collect())
    }

    fn lies(&self, soup: &Soup, found: &mut QueryResult, effort: &Effort<'_>) -> Result<bool> {
        let near = match self.points[..] {
            // One box around a slanting line would be wide, so several are used.
            [start, end] => {
                let line = Line { start, end, object: self.object, kind: self.kind };
                soup.near_any(boxes_along(&line, self.tolerance), found)
            }
            _ => soup.near(&grown(&Aabb::of(self.points.iter().copied()), self.tolerance), found),
        };
        let thing = RefCell::new(effort.allowance(self.object));
        let spend = |steps: usize| thing.borrow_mut().spend(steps, || self.points[0]);
        spend(steps::PLACED * near.len())?;
        // Under a patch, the sides of each polygon are compared with the polygons that overlap it.
        let compare = |pairs: usize| spend(steps::COVER * pairs);
        lies_on(&self.points, near.iter().map(|&face| soup.corners(face)), NEAR * self.tolerance, &compare)
    }
}
