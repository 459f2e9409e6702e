//! Binned halving by the surface-area heuristic (Wald 2007), and eight-wide nodes made of the halves (Wald, Benthin,
//! Boulos 2008).

use super::WIDE;
use glam::{Vec3, Vec4};

/// A box with a number, which lies in the bits of the fourth coordinate.
#[derive(Clone, Copy, Debug)]
pub struct Item {
    low: Vec4,
    high: Vec4,
}

impl Item {
    /// A box with this number.
    pub fn new(low: Vec3, high: Vec3, id: u32) -> Self {
        Self { low: low.extend(f32::from_bits(id)), high: high.extend(0.0) }
    }

    /// Its number.
    pub fn id(&self) -> u32 {
        self.low.w.to_bits()
    }

    /// Twice its middle.
    #[inline(always)]
    fn middle(&self, axis: usize) -> f32 {
        self.low[axis] + self.high[axis]
    }
}

/// A node of two children, or a leaf.
#[derive(Clone, Copy, Debug)]
pub struct Half {
    pub(super) low: Vec4,
    pub(super) high: Vec4,
    /// First item and number of items; a leaf has no children.
    first: u32,
    count: u32,
    children: Option<[u32; 2]>,
}

const BINS: usize = 16;

/// Up to this number of items, half as many bins are used.
const FEW: usize = 128;

/// Depth from which halves have equal counts, so that no input makes the tree deeper than about twice this.
const DEEP: u32 = 96;

/// A larger number of items is halved by several threads, if there are any.
const PARALLEL: usize = 1 << 15;

#[derive(Clone, Copy)]
struct Extent {
    low: Vec4,
    high: Vec4,
}

impl Extent {
    const NONE: Self = Self { low: Vec4::INFINITY, high: Vec4::NEG_INFINITY };

    #[inline(always)]
    fn hold(&mut self, low: Vec4, high: Vec4) {
        // As the processor's minimum: no box is NaN.
        self.low = least(low, self.low);
        self.high = greatest(high, self.high);
    }
}

#[inline(always)]
fn least(a: Vec4, b: Vec4) -> Vec4 {
    let pick = |a: f32, b: f32| if a < b { a } else { b };
    Vec4::new(pick(a.x, b.x), pick(a.y, b.y), pick(a.z, b.z), 0.0)
}

#[inline(always)]
fn greatest(a: Vec4, b: Vec4) -> Vec4 {
    let pick = |a: f32, b: f32| if a > b { a } else { b };
    Vec4::new(pick(a.x, b.x), pick(a.y, b.y), pick(a.z, b.z), 0.0)
}

/// Half the surface of a box, square metres.
#[inline(always)]
fn area(low: Vec4, high: Vec4) -> f32 {
    let d = high - low;
    d.x * d.y + d.y * d.z + d.z * d.x
}

/// Halves and sorts the items until no leaf has more than `max_leaf`. The first node is the root.
pub fn halve(items: &mut [Item], max_leaf: usize) -> Vec<Half> {
    if items.is_empty() { Vec::new() } else { grow(items, 0, max_leaf, 0) }
}

fn grow(items: &mut [Item], first: u32, max_leaf: usize, depth: u32) -> Vec<Half> {
    let mut nodes = Vec::with_capacity(items.len().div_ceil(max_leaf.div_ceil(2)) * 2);
    if items.len() > PARALLEL && rayon::current_thread_index().is_some() {
        let middle = split(items, extent(items), max_leaf, depth);
        let (left, right) = items.split_at_mut(middle.1);
        let (mut left, right) = rayon::join(
            || grow(left, first, max_leaf, depth + 1),
            || grow(right, first + middle.1 as u32, max_leaf, depth + 1),
        );
        let (before, after) = (1, 1 + left.len() as u32);
        let moved = |node: &Half, by: u32| Half { children: node.children.map(|c| c.map(|c| c + by)), ..*node };
        let Extent { low, high } = middle.0;
        let count = (left[0].count) + right[0].count;
        nodes.push(Half { low, high, first, count, children: Some([before, after]) });
        nodes.extend(left.drain(..).map(|node| moved(&node, before)));
        nodes.extend(right.iter().map(|node| moved(node, after)));
        return nodes;
    }
    grow_here(items, first, max_leaf, depth, &mut nodes);
    nodes
}

fn grow_here(items: &mut [Item], first: u32, max_leaf: usize, depth: u32, nodes: &mut Vec<Half>) -> u32 {
    let around = extent(items);
    let (at, count) = (nodes.len() as u32, items.len() as u32);
    nodes.push(Half { low: around.low, high: around.high, first, count, children: None });
    if items.len() > max_leaf {
        let (_, middle) = split(items, around, max_leaf, depth);
        let (left, right) = items.split_at_mut(middle);
        let left = grow_here(left, first, max_leaf, depth + 1, nodes);
        let right = grow_here(right, first + middle as u32, max_leaf, depth + 1, nodes);
        nodes[at as usize].children = Some([left, right]);
    }
    at
}

fn extent(items: &[Item]) -> Extent {
    let mut all = Extent::NONE;
    items.iter().for_each(|item| all.hold(item.low, item.high));
    all
}

/// Sorts the items by the best plane between bins. Returns the number of items before it.
fn split(items: &mut [Item], around: Extent, max_leaf: usize, depth: u32) -> (Extent, usize) {
    let n = items.len();
    let (mut low, mut high) = (Vec4::INFINITY, Vec4::NEG_INFINITY);
    for item in &*items {
        let middle = item.low + item.high;
        (low, high) = (least(middle, low), greatest(middle, high));
    }
    let bins = if n <= FEW { BINS / 2 } else { BINS };
    let per_unit = |axis: usize| bins as f32 * 0.9999 / (high[axis] - low[axis]);
    let mut best: Option<(f32, usize, usize)> = None;
    if depth < DEEP {
        let (mut all, mut counts) = ([[Extent::NONE; BINS]; 3], [[0u32; BINS]; 3]);
        // An axis without an extent has one bin: infinity times zero is NaN, which becomes bin 0.
        let scale = [0, 1, 2].map(per_unit);
        for item in &*items {
            for axis in 0..3 {
                let bin = (((item.middle(axis) - low[axis]) * scale[axis]) as usize).min(bins - 1);
                all[axis][bin].hold(item.low, item.high);
                counts[axis][bin] += 1;
            }
        }
        for axis in 0..3 {
            let found = best_plane(&all[axis][..bins], &counts[axis][..bins], max_leaf);
            if let Some((cost, plane)) = found
                && best.is_none_or(|(least, ..)| cost < least)
            {
                best = Some((cost, axis, plane));
            }
        }
    }
    let Some((_, axis, plane)) = best else { return (around, halves(items, low, high)) };
    let scale = per_unit(axis);
    let mut middle = 0;
    for i in 0..n {
        let bin = (((items[i].middle(axis) - low[axis]) * scale) as usize).min(bins - 1);
        if bin < plane {
            items.swap(i, middle);
            middle += 1;
        }
    }
    (around, middle)
}

/// Equal halves along the longest axis.
fn halves(items: &mut [Item], low: Vec4, high: Vec4) -> usize {
    let axis = (high - low).truncate().max_position();
    let middle = items.len() / 2;
    items.select_nth_unstable_by(middle, |a, b| a.middle(axis).total_cmp(&b.middle(axis)));
    middle
}

/// The minimum cost and the bin after its plane. The cost is area times the number of blocks of half of `max_leaf`,
/// because blocks are seldom full.
#[inline(always)]
fn best_plane(bins: &[Extent], counts: &[u32], max_leaf: usize) -> Option<(f32, usize)> {
    let blocks = |count: u32| (count as usize).div_ceil(max_leaf.div_ceil(2)) as f32;
    let mut behind = [(0.0, 0); BINS];
    let (mut held, mut count) = (Extent::NONE, 0);
    for i in (1..bins.len()).rev() {
        held.hold(bins[i].low, bins[i].high);
        count += counts[i];
        behind[i] = (if count > 0 { area(held.low, held.high) } else { 0.0 }, count);
    }
    let mut best: Option<(f32, usize)> = None;
    (held, count) = (Extent::NONE, 0);
    for i in 1..bins.len() {
        held.hold(bins[i - 1].low, bins[i - 1].high);
        count += counts[i - 1];
        if count == 0 || behind[i].1 == 0 {
            continue;
        }
        let cost = area(held.low, held.high) * blocks(count) + behind[i].0 * blocks(behind[i].1);
        if best.is_none_or(|(least, _)| cost < least) {
            best = Some((cost, i));
        }
    }
    best
}

/// A child of an eight-wide node: its box, and its items.
pub struct WideChild<'a> {
    /// Minimum corner.
    pub low: Vec3,
    /// Maximum corner.
    pub high: Vec3,
    /// All items below it.
    pub items: &'a [Item],
}

/// A tree of eight-wide nodes that grows from its root.
pub trait WideTree {
    /// Adds a node around its children, at max_leaf [`WIDE`], and returns its number. The children have no names yet.
    fn add_node(&mut self, children: &[WideChild<'_>]) -> u32;

    /// Adds a leaf and returns its name.
    fn add_leaf(&mut self, items: &[Item]) -> u32;

    /// Sets the name of a child: the number of a node, or the name of a leaf.
    fn name_child(&mut self, node: u32, lane: usize, name: u32);
}

/// Makes eight-wide nodes of a tree of halves.
pub fn widen(halves: &[Half], items: &[Item], tree: &mut impl WideTree) {
    if !halves.is_empty() {
        add_below(halves, items, 0, tree);
    }
}

fn add_below(halves: &[Half], items: &[Item], at: u32, tree: &mut impl WideTree) -> u32 {
    let mut own = [0; WIDE];
    let mut count = 1;
    own[0] = at;
    // The largest one is replaced by its children until there are eight.
    while count < WIDE {
        let large = (0..count)
            .filter(|i| halves[own[*i] as usize].children.is_some())
            .map(|i| (area(halves[own[i] as usize].low, halves[own[i] as usize].high), i))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, i)) = large else { break };
        let Some([left, right]) = halves[own[i] as usize].children else { break };
        (own[i], own[count]) = (left, right);
        count += 1;
    }
    let items_of = |half: &Half| &items[half.first as usize..][..half.count as usize];
    let child = |number: &u32| {
        let half = &halves[*number as usize];
        WideChild { low: half.low.truncate(), high: half.high.truncate(), items: items_of(half) }
    };
    let node = tree.add_node(&own[..count].iter().map(child).collect::<Vec<_>>());
    for (lane, number) in own[..count].iter().enumerate() {
        let half = &halves[*number as usize];
        let name = match half.children {
            Some(_) => add_below(halves, items, *number, tree),
            None => tree.add_leaf(items_of(half)),
        };
        tree.name_child(node, lane, name);
    }
    node
}
