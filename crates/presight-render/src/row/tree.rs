//! A tree of the plane, eight wide, over the segments of a cut, by the surface-area heuristic: the number of beams that see
//! a box is proportional to its perimeter.

use super::cut::Segment;
use glam::DVec2;

/// Children of a node, and segments of a block.
pub(super) const EIGHT: usize = 8;

/// The bit of a child that is a block, and the mark of an empty place.
pub(super) const BLOCK: u32 = 1 << 31;
pub(super) const NO_CHILD: u32 = u32::MAX;

/// Maximum depth of optimized splits; deeper nodes are halved.
const MOST_DEPTH: usize = 40;

/// Places of a split that are tried on each axis.
const BINS: usize = 16;

/// Boxes of eight children, in the world. Where there is no child, nothing is inside.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(super) struct Node {
    /// x, then y.
    pub min: [[f64; EIGHT]; 2],
    pub max: [[f64; EIGHT]; 2],
    pub child: [u32; EIGHT],
}

impl Node {
    /// x and y of the corner of each box that is farthest in a direction.
    #[inline(always)]
    pub fn most(&self, direction: DVec2) -> [&[f64; EIGHT]; 2] {
        let x = if direction.x > 0.0 { &self.max[0] } else { &self.min[0] };
        let y = if direction.y > 0.0 { &self.max[1] } else { &self.min[1] };
        [x, y]
    }
}

/// Eight segments. Where there is none, its ends are NaN.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(super) struct Block {
    /// x, then y.
    pub a: [[f64; EIGHT]; 2],
    pub b: [[f64; EIGHT]; 2],
    /// No point of a polygon is farther from its segment, metres; infinite if one of them only touches the height.
    pub pad: f64,
    pub first: u32,
    pub count: u32,
}

/// A segment before it has a place.
#[derive(Clone, Copy)]
struct Item {
    min: DVec2,
    max: DVec2,
    segment: u32,
}

impl Item {
    fn middle(&self) -> DVec2 {
        self.min + self.max
    }
}

#[derive(Default)]
struct Tree {
    nodes: Vec<Node>,
    blocks: Vec<Block>,
    placed: Vec<Segment>,
}

/// Nodes and blocks over segments, and these in the order of the blocks.
pub(super) fn grow(segments: Vec<Segment>) -> (Vec<Node>, Vec<Block>, Vec<Segment>) {
    let item = |(i, s): (usize, &Segment)| {
        let pad = f64::from(s.pad);
        Item { min: s.a.min(s.b) - pad, max: s.a.max(s.b) + pad, segment: i as u32 }
    };
    let mut items: Vec<Item> = segments.iter().enumerate().map(item).collect();
    let mut tree = Tree { placed: Vec::with_capacity(segments.len()), ..Tree::default() };
    if !items.is_empty() {
        tree.node(&segments, &mut items, 0);
    }
    (tree.nodes, tree.blocks, tree.placed)
}

impl Tree {
    fn node(&mut self, segments: &[Segment], items: &mut [Item], depth: usize) -> u32 {
        let at = self.nodes.len();
        self.nodes.push(Node {
            min: [[f64::INFINITY; EIGHT]; 2],
            max: [[f64::NEG_INFINITY; EIGHT]; 2],
            child: [NO_CHILD; EIGHT],
        });
        let mut parts: Vec<&mut [Item]> = vec![items];
        while parts.len() < EIGHT {
            let weight =
                |part: &[Item]| if part.len() > EIGHT { perimeter(bounds(part)) * part.len() as f64 } else { -1.0 };
            let heaviest = (0..parts.len()).max_by(|&i, &j| weight(parts[i]).total_cmp(&weight(parts[j]))).unwrap_or(0);
            if parts[heaviest].len() <= EIGHT {
                break;
            }
            let part = parts.swap_remove(heaviest);
            let split = split(part, depth);
            parts.extend(<[&mut [Item]; 2]>::from(part.split_at_mut(split)));
        }
        for (lane, part) in parts.into_iter().enumerate() {
            let (min, max) = bounds(part);
            let child =
                if part.len() <= EIGHT { self.block(segments, part) } else { self.node(segments, part, depth + 1) };
            let node = &mut self.nodes[at];
            for axis in 0..2 {
                (node.min[axis][lane], node.max[axis][lane]) = (min[axis], max[axis]);
            }
            node.child[lane] = child;
        }
        at as u32
    }

    fn block(&mut self, segments: &[Segment], items: &[Item]) -> u32 {
        let none = [[f64::NAN; EIGHT]; 2];
        let (first, count) = (self.placed.len() as u32, items.len() as u32);
        let mut block = Block { a: none, b: none, pad: 0.0, first, count };
        for (lane, item) in items.iter().enumerate() {
            let segment = segments[item.segment as usize];
            for axis in 0..2 {
                (block.a[axis][lane], block.b[axis][lane]) = (segment.a[axis], segment.b[axis]);
            }
            block.pad = if segment.touches { f64::INFINITY } else { block.pad.max(segment.pad.into()) };
            self.placed.push(segment);
        }
        self.blocks.push(block);
        BLOCK | (self.blocks.len() - 1) as u32
    }
}

const NOWHERE: (DVec2, DVec2) = (DVec2::INFINITY, DVec2::NEG_INFINITY);

fn bounds(items: &[Item]) -> (DVec2, DVec2) {
    items.iter().fold(NOWHERE, |(min, max), item| (min.min(item.min), max.max(item.max)))
}

fn perimeter((min, max): (DVec2, DVec2)) -> f64 {
    (max - min).max(DVec2::ZERO).element_sum()
}

/// Sorts items into two parts and returns where the second one begins.
fn split(items: &mut [Item], depth: usize) -> usize {
    let half = items.len() / 2;
    let around = items.iter().fold(NOWHERE, |(min, max), i| (min.min(i.middle()), max.max(i.middle())));
    let best = if depth < MOST_DEPTH { best_bin(items, around) } else { None };
    let Some((axis, bin)) = best else {
        let size = around.1 - around.0;
        let axis = usize::from(size.y > size.x);
        items.select_nth_unstable_by(half, |a, b| a.middle()[axis].total_cmp(&b.middle()[axis]));
        return half;
    };
    let mut first = 0;
    for i in 0..items.len() {
        if bin_of(&items[i], around, axis) < bin {
            items.swap(first, i);
            first += 1;
        }
    }
    first
}

fn bin_of(item: &Item, (min, max): (DVec2, DVec2), axis: usize) -> usize {
    let part = (item.middle()[axis] - min[axis]) / (max[axis] - min[axis]);
    ((part * BINS as f64) as usize).min(BINS - 1)
}

/// The axis and the bin at which both boxes cost least; `None` if nothing separates the items.
fn best_bin(items: &[Item], around: (DVec2, DVec2)) -> Option<(usize, usize)> {
    let mut best = (f64::INFINITY, None);
    for axis in 0..2 {
        if !(around.1[axis] > around.0[axis]) {
            continue;
        }
        let mut bins = [(NOWHERE, 0usize); BINS];
        for item in items {
            let ((min, max), count) = &mut bins[bin_of(item, around, axis)];
            (*min, *max) = (min.min(item.min), max.max(item.max));
            *count += 1;
        }
        // Blocks are tested whole.
        let cost = |held: (DVec2, DVec2), count: usize| perimeter(held) * count.div_ceil(EIGHT) as f64;
        let join =
            |(a, n): ((DVec2, DVec2), usize), (b, m): ((DVec2, DVec2), usize)| ((a.0.min(b.0), a.1.max(b.1)), n + m);
        let mut above = [0.0; BINS];
        let mut held = (NOWHERE, 0);
        for bin in (1..BINS).rev() {
            held = join(held, bins[bin]);
            above[bin] = if held.1 == 0 { f64::INFINITY } else { cost(held.0, held.1) };
        }
        held = (NOWHERE, 0);
        for bin in 1..BINS {
            held = join(held, bins[bin - 1]);
            let all = if held.1 == 0 { f64::INFINITY } else { cost(held.0, held.1) + above[bin] };
            if all < best.0 {
                best = (all, Some((axis, bin)));
            }
        }
    }
    best.1
}
