//! Draft features before numbering, and the check that they lie on the surface.

use super::FeatureKind;
use super::effort::{Effort, steps};
use super::lines::boxes_along;
use super::patches::{Patch, parts};
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

/// Largest distance of a feature from the polygons, metres. The rest of the layer's tolerance is for patches that are
/// off their plane, and for rounding in other frames.
const NEAR: f64 = 0.75 * DEFAULT_TOLERANCE;

/// A feature without a number, in the world.
#[derive(Clone, Debug)]
pub(super) struct Draft {
    pub kind: FeatureKind,
    pub object: u32,
    pub points: Vec<DVec3>,
    pub normal: Option<DVec3>,
}

impl Draft {
    pub fn new(kind: FeatureKind, object: u32, points: Vec<DVec3>) -> Self {
        Self { kind, object, points, normal: None }
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
            if draft.lies(soup, found, effort)? {
                return Ok(vec![draft]);
            }
            let parts = match draft.normal {
                Some(_) => parts(soup, &draft, least, found, effort)?,
                None => Vec::new(),
            };
            let mut lying = Vec::new();
            for part in parts.into_iter().map(Draft::from) {
                if part.lies(soup, found, effort)? {
                    lying.push(part);
                }
            }
            Ok(lying)
        })
        .collect::<Result<_>>()?;
    *off = kept.iter().filter(|of_one| of_one.is_empty()).count();
    Ok(kept.into_iter().flatten().collect())
}

impl Draft {
    fn lies(&self, soup: &Soup, found: &mut QueryResult, effort: &Effort<'_>) -> Result<bool> {
        let near = match self.points[..] {
            // One box around a slanting line would be wide, so several are used.
            [start, end] => {
                let line = Line { start, end, object: self.object, kind: self.kind };
                soup.near_any(boxes_along(&line, DEFAULT_TOLERANCE), found)
            }
            _ => soup.near(&grown(&Aabb::of(self.points.iter().copied()), DEFAULT_TOLERANCE), found),
        };
        let thing = RefCell::new(effort.allowance(self.object));
        let spend = |steps: usize| thing.borrow_mut().spend(steps, || self.points[0]);
        spend(steps::PLACED * near.len())?;
        // Under a patch, the sides of each polygon are compared with the polygons that overlap it.
        let compare = |pairs: usize| spend(steps::COVER * pairs);
        lies_on(&self.points, near.iter().map(|&face| soup.corners(face)), NEAR, &compare)
    }
}
