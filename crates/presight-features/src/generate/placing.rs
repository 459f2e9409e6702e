//! The check that drafts lie on the surface, and the split of those that do not.

use super::drafts::Draft;
use super::effort::{Effort, steps};
use super::line::{Line, boxes_along};
use super::patches::parts;
use super::scanned::{PART, halves};
use super::soup::{Soup, grown};
use crate::lies_on;
use presight_model::environment::DEFAULT_TOLERANCE;
use presight_model::error::Result;
use presight_model::geometry::Aabb;
use presight_model::index::QueryResult;
use rayon::prelude::*;
use std::cell::RefCell;

/// Maximum distance of a feature from the polygons, as a part of its tolerance. The rest is for patches that are off
/// their plane, and for rounding in other frames.
const NEAR: f64 = 0.75;

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
