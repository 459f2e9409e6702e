//! Which features may be seen: those with a point in view that no single polygon hides as a whole.
//!
//! Boxes of many features are tested first, from the root of their tree down. What hides a box or a feature is looked for where
//! the image shows its middle: the polygon there hides it if all of its corners are in the polygon's cone and behind its
//! plane, by the same bounds as samples. Of a feature the rest is then looked at in the same way, until all of it is hidden, or
//! the image shows nothing there that could hide it. The image only proposes, so that no feature is left out of which a sample
//! is seen.

use super::polygon::PreparedPolygon;
use super::strategy::Workspace;
use super::{IdleWorkspaces, VisibilityContext};
use crate::tree::{FeatureTree, Group, Node};
use crate::view::View;
use crate::{PlacedFeature, Reason};
use glam::{DMat3, DVec3};
use presight_model::contour::ContourSet;
use presight_model::error::Result;
use presight_model::place::clip;
use presight_model::sensor::Geometry;
use presight_model::threads::parallel;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::VecDeque;

/// By this part of its size something has to be inside a cone: samples on it may be off by rounding.
const INSIDE: f64 = 1e-12;

/// Parts of a feature that are looked at, at most.
const MOST_PARTS: usize = 24;

/// Boxes that are handed to the threads, at least, if there are as many.
const MANY_BOXES: usize = 64;

/// Numbers of the features that may be seen: neighbours in the image together, so that a worker looks into few tiles, the farthest
/// first, so that it looks once.
pub(super) fn select(
    frame: &VisibilityContext<'_>,
    tree: &FeatureTree,
    (placed, contours): (&[PlacedFeature], &ContourSet),
    workspaces: &IdleWorkspaces,
) -> Result<Vec<u32>> {
    let view = View::new(frame.sensor);
    let begin = || {
        let (workspace, points, some) = (workspaces.take(frame), Vec::new(), Vec::new());
        Selection { frame, tree, placed, contours, view: &view, workspace, points, some }
    };
    // What was set up serves the next.
    let end = |selection: Selection<'_, '_>| {
        workspaces.give(selection.workspace);
        selection.some
    };
    let mut first = begin();
    let mut boxes: VecDeque<(&Group, u32)> = tree.groups.iter().map(|group| (group, group.root)).collect();
    while boxes.len() < MANY_BOXES
        && let Some((group, node)) = boxes.pop_front()
    {
        boxes.extend(first.step(group, node).into_iter().flatten().map(|node| (group, node)));
    }
    let mut some = end(first);
    if !boxes.is_empty() {
        let boxes = Vec::from(boxes);
        let parts = parallel(|| {
            let share = boxes.len().div_ceil(2 * rayon::current_num_threads());
            let parts = boxes.par_chunks(share).map(|boxes| {
                let mut selection = begin();
                boxes.iter().for_each(|(group, node)| selection.below(group, *node));
                end(selection)
            });
            parts.collect::<Vec<_>>()
        })?;
        some.extend(parts.into_iter().flatten());
    }
    some.sort_unstable();
    Ok(some.into_iter().map(|(.., feature)| feature).collect())
}

/// Why features are out of view as a whole, by number: of those in a box of the tree that is. Others, and contours, of which each
/// curve has its own reasons, have none here.
pub(super) fn out_of_view(
    frame: &VisibilityContext<'_>,
    tree: &FeatureTree,
    contours: &ContourSet,
) -> Vec<Option<Reason>> {
    let view = View::new(frame.sensor);
    // A lens may see what is behind it, and a row of beams only cuts things.
    let is_scanner = matches!(frame.sensor.spec().geometry, Geometry::Scanner(_)) && !frame.sampler.is_one_row();
    let mut reasons = vec![None; tree.order.len()];
    for group in &tree.groups {
        let (image_from_object, shift) = frame.image_from(group.object);
        let mut nodes = vec![group.root];
        while let Some(number) = nodes.pop() {
            let node = &tree.nodes[number as usize];
            let (middle, axes, _) = placed_box(frame, node, group.object, (image_from_object, shift));
            let reason = if is_scanner {
                (!view.meets_directions(middle, &axes)).then_some(Reason::OutsideImage)
            } else {
                let sign = |corner: usize, k: usize| if corner >> k & 1 == 0 { axes[k] } else { -axes[k] };
                let corners: [DVec3; 8] = std::array::from_fn(|c| middle + sign(c, 0) + sign(c, 1) + sign(c, 2));
                frame.sampler.beside(&corners)
            };
            match (reason, node.second) {
                (Some(_), _) => {
                    let some = &tree.order[node.some.start as usize..node.some.end as usize];
                    some.iter().for_each(|feature| reasons[*feature as usize] = reason);
                }
                (None, Some(second)) => nodes.extend([second, number + 1]),
                (None, None) => {}
            }
        }
    }
    contours.numbers().iter().for_each(|number| reasons[*number as usize] = None);
    reasons
}

/// A tree's box in the image frame: its middle, half of its edges, and how far positions in it may be off by rounding.
fn placed_box(
    frame: &VisibilityContext<'_>,
    node: &Node,
    object: Option<u32>,
    (image_from_object, shift): (DMat3, DVec3),
) -> (DVec3, [DVec3; 3], f64) {
    let reach = node.bounds.min.abs().max(node.bounds.max.abs()).length();
    let rounding = frame.rounding(reach, object);
    let [middle, half] = node.middle(rounding);
    (image_from_object * middle + shift, [0, 1, 2].map(|k| image_from_object.col(k) * half[k]), rounding)
}

struct Selection<'s, 'a> {
    frame: &'s VisibilityContext<'a>,
    tree: &'s FeatureTree,
    placed: &'s [PlacedFeature],
    contours: &'s ContourSet,
    view: &'s View,
    workspace: Workspace,
    points: Vec<DVec3>,
    /// The tile of its middle, the range of that, the farthest first, and the number of each feature that may be seen.
    some: Vec<(u32, Reverse<u32>, u32)>,
}

impl Selection<'_, '_> {
    /// All of a node.
    fn below(&mut self, group: &Group, node: u32) {
        let mut nodes = vec![node];
        while let Some(node) = nodes.pop() {
            nodes.extend(self.step(group, node).into_iter().flatten());
        }
    }

    /// The two nodes below one of which something may be seen; of a leaf its features are looked at.
    fn step(&mut self, group: &Group, number: u32) -> Option<[u32; 2]> {
        let tree = self.tree;
        let (image_from_object, shift) = self.frame.image_from(group.object);
        let node = &tree.nodes[number as usize];
        if self.is_out(node, group, image_from_object, shift) {
            return None;
        }
        if node.second.is_none() {
            for feature in &tree.order[node.some.start as usize..node.some.end as usize] {
                self.take(*feature, image_from_object, shift);
            }
        }
        node.second.map(|second| [second, number + 1])
    }

    fn take(&mut self, feature: u32, image_from_object: DMat3, shift: DVec3) {
        if !self.is_hidden(feature, image_from_object, shift) {
            let middle = self.points.iter().sum::<DVec3>() / self.points.len().max(1) as f64;
            // As integers these rise like the ranges.
            self.some.push((self.workspace.tiles.of(middle).0, Reverse((middle.length() as f32).to_bits()), feature));
        }
    }

    /// True if nothing of a box is in view, or one polygon hides all of it.
    fn is_out(&mut self, node: &Node, group: &Group, image_from_object: DMat3, shift: DVec3) -> bool {
        let (middle, axes, rounding) = placed_box(self.frame, node, group.object, (image_from_object, shift));
        if !self.view.meets(middle, &axes) {
            return true;
        }
        let Some(number) = self.polygon_at(middle) else { return false };
        let known = self.workspace.polygons.get(number);
        hides_box(known, self.workspace.polygons.planes_of(known), middle, &axes, rounding)
            && !self.tree.carries(known.slot, &node.some)
    }

    /// True if nothing of a feature is in view, or one polygon that it does not lie on hides all of it.
    fn is_hidden(&mut self, feature: u32, image_from_object: DMat3, shift: DVec3) -> bool {
        let placed = &self.placed[feature as usize];
        let surface = self.contours.get(feature as usize);
        let points = surface.map_or(placed.feature.shape.points(), |surface| &surface.hull);
        self.points.clear();
        self.points.extend(points.iter().map(|p| image_from_object * *p + shift));
        let reach = points.iter().map(|p| p.length()).fold(0.0, f64::max);
        let rounding = self.frame.rounding(reach, placed.object);
        let (low, high) =
            self.points.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(*p), h.max(*p)));
        let half = 0.5 * (high - low) + rounding;
        let (middle, axes) = (0.5 * (low + high), [DVec3::X * half.x, DVec3::Y * half.y, DVec3::Z * half.z]);
        if !self.view.meets(middle, &axes) {
            return true;
        }
        // The polygon that the image shows in the middle.
        let number = self.polygon_at(middle).filter(|n| !placed.slots.contains(&self.workspace.polygons.get(*n).slot));
        if let Some(known) = number.map(|number| self.workspace.polygons.get(number))
            && hides_points(known, self.workspace.polygons.planes_of(known), &self.points, rounding)
        {
            return true;
        }
        // The corners of a surface's box are no outline. A segment has but this middle, an area another.
        let is_line = self.points.len() < 3;
        surface.is_none() && !(is_line && number.is_none()) && self.is_hidden_in_parts(placed, rounding)
    }

    /// True if polygons that the image shows in front of parts of the hull of the points hide all of it together.
    fn is_hidden_in_parts(&mut self, placed: &PlacedFeature, rounding: f64) -> bool {
        let mut rest = vec![self.points.clone()];
        for _ in 0..MOST_PARTS {
            let Some(part) = rest.pop() else { return true };
            let middle = part.iter().sum::<DVec3>() / part.len() as f64;
            let Some(number) = self.polygon_at(middle) else { return false };
            let known = self.workspace.polygons.get(number);
            // What is before its plane it does not hide.
            if placed.slots.contains(&known.slot) || !part.iter().any(|p| known.inverse.dot(*p) > 1.0) {
                return false;
            }
            let far = part.iter().map(|p| p.length()).fold(0.0, f64::max);
            let mut inside = part;
            for e in self.workspace.polygons.planes_of(known) {
                // As of most: nothing is cut off.
                if inside.iter().all(|p| e.dot(*p) >= 0.0) {
                    continue;
                }
                let beyond = INSIDE * far * e.length();
                let out = clip(&inside, |p| -e.dot(*p));
                if out.iter().any(|p| e.dot(*p) < -beyond) {
                    rest.push(out);
                }
                inside = clip(&inside, |p| e.dot(*p));
            }
            let least = inside.iter().map(|p| known.inverse.dot(*p)).fold(f64::INFINITY, f64::min);
            if inside.is_empty() || !known.hides_all(least, far, rounding) {
                return false;
            }
        }
        false
    }

    /// The polygon that the image shows in a direction, by its number in the cache, if it covers rays.
    fn polygon_at(&mut self, at: DVec3) -> Option<u32> {
        let slot = self.frame.slot_in(at)?;
        let polygons = &mut self.workspace.polygons;
        polygons.of_slot(self.frame, slot).filter(|number| polygons.get(*number).covers)
    }
}

/// True if a polygon hides all of a box, given by its middle and half of its edges.
fn hides_box(known: &PreparedPolygon, planes: &[DVec3], middle: DVec3, axes: &[DVec3; 3], rounding: f64) -> bool {
    let reach = |n: DVec3| axes.iter().map(|a| n.dot(*a).abs()).sum::<f64>();
    let far = middle.length() + axes.iter().map(|a| a.length()).sum::<f64>();
    known.hides_all(known.inverse.dot(middle) - reach(known.inverse), far, rounding)
        && planes.iter().all(|e| e.dot(middle) - reach(*e) > INSIDE * far * e.length())
}

/// True if a polygon hides the convex hull of some points.
fn hides_points(known: &PreparedPolygon, planes: &[DVec3], points: &[DVec3], rounding: f64) -> bool {
    let far = points.iter().map(|p| p.length()).fold(0.0, f64::max);
    let least = points.iter().map(|p| known.inverse.dot(*p)).fold(f64::INFINITY, f64::min);
    known.hides_all(least, far, rounding)
        && planes.iter().all(|e| {
            let least = points.iter().map(|p| e.dot(*p)).fold(f64::INFINITY, f64::min);
            least > (INSIDE * far + rounding) * e.length()
        })
}
