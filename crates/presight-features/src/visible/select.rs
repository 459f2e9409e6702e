//! Selects the features that may be seen: those in view that no polygons hide completely.
//!
//! Boxes of many features are tested first, from the root of their tree down. The candidate occluder of a box or a
//! feature is the polygon that the image shows at its middle. It hides the box or feature if all corners are in the
//! polygon's cone and behind its plane, by the same bounds as for samples. If it hides only a part of a feature, the
//! rest is tested likewise until all of it is hidden or the image shows no candidate. The image only proposes
//! occluders, so every feature with a visible sample is selected.

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

/// Minimum distance inside a cone, relative to the size: samples may be off by rounding.
const INSIDE: f64 = 1e-12;

/// Maximum number of parts of a feature that are tested.
const MAX_PARTS: usize = 24;

/// The tree is split into at least this number of boxes for the threads, if it has them.
const MANY_BOXES: usize = 64;

/// Indices of the features that may be seen. Features of one tile are neighbours, so that a worker uses few tiles; the
/// farthest come first, so that each tile is built once.
pub(super) fn select(
    frame: &VisibilityContext<'_>,
    tree: &FeatureTree,
    placed: &[PlacedFeature],
    contours: &ContourSet,
    workspaces: &IdleWorkspaces,
) -> Result<Vec<u32>> {
    let view = View::new(frame.sensor);
    let begin = || {
        let (workspace, points, some) = (workspaces.take(frame), Vec::new(), Vec::new());
        Selection { frame, tree, placed, contours, view: &view, workspace, points, some }
    };
    // Return the workspace, so that others reuse its polygons and tiles.
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

/// By feature: why it is out of view, if a whole box of the tree is. `None` for all others, and for contours, because
/// each curve of a contour has its own reasons.
pub(super) fn out_of_view(
    frame: &VisibilityContext<'_>,
    tree: &FeatureTree,
    contours: &ContourSet,
) -> Vec<Option<Reason>> {
    let view = View::new(frame.sensor);
    // Excludes lenses, which may see behind themselves, and single rows, which only see sections of surfaces.
    let is_scanner = matches!(frame.sensor.spec().geometry, Geometry::Scanner(_)) && !frame.sampler.is_one_row();
    let mut reasons = vec![None; tree.order.len()];
    for group in &tree.groups {
        let (image_from_object, shift) = frame.image_from(group.object);
        let mut nodes = vec![group.root];
        while let Some(number) = nodes.pop() {
            let node = &tree.nodes[number as usize];
            let (middle, axes, _) = placed_box(frame, node, group.object, image_from_object, shift);
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

/// A tree's box in the image frame: its middle, half of its edges, and the bound of its rounding, metres.
fn placed_box(
    frame: &VisibilityContext<'_>,
    node: &Node,
    object: Option<u32>,
    image_from_object: DMat3,
    shift: DVec3,
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
    /// The features that may be seen: tile of the middle, range (farthest first), and index.
    some: Vec<(u32, Reverse<u32>, u32)>,
}

impl Selection<'_, '_> {
    /// Tests all nodes below a node.
    fn below(&mut self, group: &Group, node: u32) {
        let mut nodes = vec![node];
        while let Some(node) = nodes.pop() {
            nodes.extend(self.step(group, node).into_iter().flatten());
        }
    }

    /// Tests a node. Returns its children if something in them may be seen; the features of a leaf are tested here.
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
            // The bits of positive floats sort like the floats.
            self.some.push((self.workspace.tiles.of(middle).0, Reverse((middle.length() as f32).to_bits()), feature));
        }
    }

    /// Returns true if a box is out of view, or one polygon hides all of it.
    fn is_out(&mut self, node: &Node, group: &Group, image_from_object: DMat3, shift: DVec3) -> bool {
        let (middle, axes, rounding) = placed_box(self.frame, node, group.object, image_from_object, shift);
        if !self.view.meets(middle, &axes) {
            return true;
        }
        let Some(number) = self.polygon_at(middle) else { return false };
        let known = self.workspace.polygons.get(number);
        hides_box(known, self.workspace.polygons.planes_of(known), middle, &axes, rounding)
            && !self.tree.carries(known.slot, &node.some)
    }

    /// Returns true if a feature is out of view, or polygons that it does not lie on hide all of it.
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
        let number = self.polygon_at(middle).filter(|n| !placed.slots.contains(&self.workspace.polygons.get(*n).slot));
        if let Some(known) = number.map(|number| self.workspace.polygons.get(number))
            && hides_points(known, self.workspace.polygons.planes_of(known), &self.points, rounding)
        {
            return true;
        }
        // The corners of a surface's box are not an outline. A segment has only this middle; an area has another one.
        let is_line = self.points.len() < 3;
        surface.is_none() && !(is_line && number.is_none()) && self.is_hidden_in_parts(placed, rounding)
    }

    /// Returns true if polygons that the image shows in front of parts of the points' hull together hide all of it.
    fn is_hidden_in_parts(&mut self, placed: &PlacedFeature, rounding: f64) -> bool {
        let mut rest = vec![self.points.clone()];
        for _ in 0..MAX_PARTS {
            let Some(part) = rest.pop() else { return true };
            let middle = part.iter().sum::<DVec3>() / part.len() as f64;
            let Some(number) = self.polygon_at(middle) else { return false };
            let known = self.workspace.polygons.get(number);
            // A polygon hides only what is behind its plane.
            if placed.slots.contains(&known.slot) || !part.iter().any(|p| known.inverse.dot(*p) > 1.0) {
                return false;
            }
            let far = part.iter().map(|p| p.length()).fold(0.0, f64::max);
            let mut inside = part;
            for e in self.workspace.polygons.planes_of(known) {
                // The usual case: this side cuts nothing off.
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

    /// The cache number of the polygon that the image shows in a direction, if it covers rays.
    fn polygon_at(&mut self, at: DVec3) -> Option<u32> {
        let slot = self.frame.slot_in(at)?;
        let polygons = &mut self.workspace.polygons;
        polygons.of_slot(self.frame, slot).filter(|number| polygons.get(*number).covers)
    }
}

/// Returns true if a polygon hides all of a box, given by its middle and half of its edges.
fn hides_box(known: &PreparedPolygon, planes: &[DVec3], middle: DVec3, axes: &[DVec3; 3], rounding: f64) -> bool {
    let reach = |n: DVec3| axes.iter().map(|a| n.dot(*a).abs()).sum::<f64>();
    let far = middle.length() + axes.iter().map(|a| a.length()).sum::<f64>();
    known.hides_all(known.inverse.dot(middle) - reach(known.inverse), far, rounding)
        && planes.iter().all(|e| e.dot(middle) - reach(*e) > INSIDE * far * e.length())
}

/// Returns true if a polygon hides the convex hull of some points.
fn hides_points(known: &PreparedPolygon, planes: &[DVec3], points: &[DVec3], rounding: f64) -> bool {
    let far = points.iter().map(|p| p.length()).fold(0.0, f64::max);
    let least = points.iter().map(|p| known.inverse.dot(*p)).fold(f64::INFINITY, f64::min);
    known.hides_all(least, far, rounding)
        && planes.iter().all(|e| {
            let least = points.iter().map(|p| e.dot(*p)).fold(f64::INFINITY, f64::min);
            least > (INSIDE * far + rounding) * e.length()
        })
}
