//! An eight-wide tree of the plane over the segments of a cut, by the surface-area heuristic: the number of beams that
//! see a box is proportional to its perimeter.

use super::segment::Segment;
use glam::{DVec2, Vec3};
use presight_model::index::{Item, LEAF, NO_CHILD, WIDE, WideChild, WideTree, halve, widen};

/// Boxes of eight children, in the world. The boxes of missing children are empty.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(super) struct Node {
    /// Coordinates x, then y.
    pub min: [[f64; WIDE]; 2],
    pub max: [[f64; WIDE]; 2],
    pub child: [u32; WIDE],
}

impl Node {
    /// x and y of the corner of each box that is farthest in a direction.
    #[inline(always)]
    pub fn most(&self, direction: DVec2) -> [&[f64; WIDE]; 2] {
        let x = if direction.x > 0.0 { &self.max[0] } else { &self.min[0] };
        let y = if direction.y > 0.0 { &self.max[1] } else { &self.min[1] };
        [x, y]
    }
}

/// Eight segments. The ends of missing segments are NaN.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(super) struct Block {
    /// Coordinates x, then y.
    pub a: [[f64; WIDE]; 2],
    pub b: [[f64; WIDE]; 2],
    /// Maximum distance of a point of a polygon from its segment, metres; infinite if one of the polygons only touches
    /// the height.
    pub pad: f64,
    pub first: u32,
    pub count: u32,
}

/// Builds nodes and blocks over segments. Returns them with the segments in the order of the blocks.
pub(super) fn grow(segments: Vec<Segment>) -> (Vec<Node>, Vec<Block>, Vec<Segment>) {
    let (min, max) = segments.iter().map(bounds_of).fold(NOWHERE, joined);
    // Boxes as high as the cut is wide, so that their surfaces are proportional to their perimeters.
    let (middle, height) = (0.5 * (min + max), (max - min).max_element() as f32);
    let item = |(id, segment): (u32, &Segment)| {
        let (low, high) = bounds_of(segment);
        let [low, high] = [low, high].map(|corner| (corner - middle).as_vec2());
        Item::new(low.extend(0.0), Vec3::from((high, height)), id)
    };
    let mut items: Vec<Item> = (0..).zip(&segments).map(item).collect();
    let halves = halve(&mut items, WIDE);
    let placed = Vec::with_capacity(segments.len());
    let mut tree = Tree { segments: &segments, nodes: Vec::new(), blocks: Vec::new(), placed };
    widen(&halves, &items, &mut tree);
    (tree.nodes, tree.blocks, tree.placed)
}

struct Tree<'a> {
    segments: &'a [Segment],
    nodes: Vec<Node>,
    blocks: Vec<Block>,
    placed: Vec<Segment>,
}

impl WideTree for Tree<'_> {
    fn add_node(&mut self, children: &[WideChild<'_>]) -> u32 {
        let (min, max) = ([[f64::INFINITY; WIDE]; 2], [[f64::NEG_INFINITY; WIDE]; 2]);
        let mut node = Node { min, max, child: [NO_CHILD; WIDE] };
        for (lane, child) in children.iter().enumerate() {
            // The boxes of the items are rounded, so that they are computed again.
            let all = child.items.iter().map(|item| bounds_of(&self.segments[item.id() as usize]));
            let (min, max) = all.fold(NOWHERE, joined);
            for axis in 0..2 {
                (node.min[axis][lane], node.max[axis][lane]) = (min[axis], max[axis]);
            }
        }
        self.nodes.push(node);
        (self.nodes.len() - 1) as u32
    }

    fn add_leaf(&mut self, items: &[Item]) -> u32 {
        let none = [[f64::NAN; WIDE]; 2];
        let (first, count) = (self.placed.len() as u32, items.len() as u32);
        let mut block = Block { a: none, b: none, pad: 0.0, first, count };
        for (lane, item) in items.iter().enumerate() {
            let segment = self.segments[item.id() as usize];
            for axis in 0..2 {
                (block.a[axis][lane], block.b[axis][lane]) = (segment.a[axis], segment.b[axis]);
            }
            block.pad = if segment.touches { f64::INFINITY } else { block.pad.max(segment.pad.into()) };
            self.placed.push(segment);
        }
        self.blocks.push(block);
        LEAF | (self.blocks.len() - 1) as u32
    }

    fn name_child(&mut self, node: u32, lane: usize, name: u32) {
        self.nodes[node as usize].child[lane] = name;
    }
}

const NOWHERE: (DVec2, DVec2) = (DVec2::INFINITY, DVec2::NEG_INFINITY);

fn bounds_of(segment: &Segment) -> (DVec2, DVec2) {
    let pad = f64::from(segment.pad);
    (segment.a.min(segment.b) - pad, segment.a.max(segment.b) + pad)
}

fn joined((a, b): (DVec2, DVec2), (c, d): (DVec2, DVec2)) -> (DVec2, DVec2) {
    (a.min(c), b.max(d))
}
