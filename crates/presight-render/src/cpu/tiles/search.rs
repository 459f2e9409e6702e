//! The search of a tile in the trees, nearest first, in f32 with margins. It finds the polygon that each ray certainly
//! sees, or the polygons that the ray may see. A ray is (1, s, t) in the axes of its tile, and its inverse depth k at a
//! point is 1 over the point's first coordinate.

use super::object::{Margins, PlacedObject, Placing, TreeView};
use super::wide::{Eight, Make, Three, Width, cross, dot, size, three};
use crate::plan::FramePlan;
use glam::DMat3;
use presight_model::geometry::Pose;
use presight_model::index::{LEAF, NO_CHILD, ObjectTree, RayNode, TriangleBlock, WIDE};
use presight_model::sensor::{GROUPS, RayTile};

/// No polygon.
pub(super) const NONE: u32 = u32::MAX;

/// Maximum relative error of depth at which the sensor's side of a plane is decided.
const SURE: f32 = 0.25;

/// Minimum depth of corners with a position in the tile, relative to their distance.
const AHEAD: f32 = 1e-5;

/// The search pauses for the decision of this number of uncertain candidates. That bounds their memory where faces
/// coincide.
const MANY_UNSURE: usize = 1 << 14;

/// A polygon that rays of the tile may see.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    /// Number of the placed object.
    pub object: u32,
    pub polygon: u32,
}

/// A candidate that some rays of a group may see.
#[derive(Clone, Copy, Debug)]
pub(super) struct Unsure {
    pub candidate: u32,
    pub group: u32,
    pub lanes: u32,
    /// Upper bounds of its inverse depths.
    most: [f32; WIDE],
}

/// Results of a search.
pub(super) struct Found {
    pub candidates: Vec<Candidate>,
    /// The candidate that each ray sees, unless it has uncertain candidates.
    pub sure: [[u32; WIDE]; GROUPS],
    pub unsure: Vec<Unsure>,
    /// Lower bound of the inverse depth of each ray's visible polygon.
    least: [[f32; WIDE]; GROUPS],
    /// Upper bound of the inverse depth of the certain candidate.
    most: [[f32; WIDE]; GROUPS],
}

impl Found {
    pub fn new() -> Self {
        Self {
            candidates: Vec::new(),
            sure: [[NONE; WIDE]; GROUPS],
            unsure: Vec::new(),
            least: [[0.0; WIDE]; GROUPS],
            most: [[0.0; WIDE]; GROUPS],
        }
    }

    /// Removes all results. Lanes without a ray count as beyond the range.
    fn clear(&mut self, tile: &RayTile, least: f32) {
        self.candidates.clear();
        self.unsure.clear();
        self.sure = [[NONE; WIDE]; GROUPS];
        for (group, alive) in self.least.iter_mut().zip(&tile.alive) {
            for (lane, k) in group.iter_mut().enumerate() {
                *k = if alive >> lane & 1 == 1 { least } else { f32::INFINITY };
            }
        }
        self.most = self.least;
    }

    /// Minimum inverse depth of a visible polygon.
    #[inline(always)]
    fn farthest<S: Width, const N: usize>(&self, simd: S) -> f32 {
        let eight = Make::<S, N>(simd);
        let mut least = eight.load(&self.least[0]);
        for group in &self.least[1..] {
            least = least.min(eight.load(group));
        }
        least.least()
    }

    /// Removes candidates that are hidden by polygons found later.
    #[inline(always)]
    fn settle<S: Width, const N: usize>(&mut self, simd: S) {
        let eight = Make::<S, N>(simd);
        let mut kept = 0;
        for i in 0..self.unsure.len() {
            let mut unsure = self.unsure[i];
            let least = eight.load(&self.least[unsure.group as usize]);
            unsure.lanes &= !least.more_than(eight.load(&unsure.most)).bits();
            self.unsure[kept] = unsure;
            kept += usize::from(unsure.lanes != 0);
        }
        self.unsure.truncate(kept);
    }
}

/// A waiting node, block or object of a view, with a bound of its depth.
#[derive(Clone, Copy)]
struct Entry {
    near: f32,
    name: u32,
    view: u32,
}

/// The objects that a frame has placed so far on one thread.
pub(super) struct Objects<'a> {
    pub plan: &'a FramePlan,
    pub tree: &'a ObjectTree,
    /// The pose of the current rays.
    world_from_sensor: Pose,
    image_from_world: DMat3,
    /// By object of the environment: the last frame that placed it, and its number.
    known: Vec<(u64, u32)>,
    frame: u64,
    bundle: u32,
    margins: Margins,
    pub placed: Vec<PlacedObject<'a>>,
    /// Objects whose meshes have no tree.
    pub lacking: Vec<u32>,
}

impl<'a> Objects<'a> {
    pub fn new(plan: &'a FramePlan, mut known: Vec<(u64, u32)>, frame: u64, margins: Margins) -> Self {
        known.resize(plan.environment().objects().len(), (0, NONE));
        Self {
            plan,
            tree: plan.world.index().object_tree(plan.environment()),
            world_from_sensor: plan.world_from_sensor,
            image_from_world: image_from_world(plan, &plan.world_from_sensor),
            known,
            frame,
            bundle: u32::MAX,
            margins,
            placed: Vec::new(),
            lacking: Vec::new(),
        }
    }

    /// Gives up the objects and returns their memory for the next frame.
    pub fn into_known(self) -> Vec<(u64, u32)> {
        self.known
    }

    /// Takes the pose of a bundle of rays. Returns true if polygons have to be set up again.
    #[inline(always)]
    pub fn turn_to(&mut self, bundle: u32) -> bool {
        let Some(poses) = self.plan.bundles().filter(|_| bundle != self.bundle) else { return false };
        self.bundle = bundle;
        self.world_from_sensor = poses.poses()[bundle as usize];
        self.image_from_world = image_from_world(self.plan, &self.world_from_sensor);
        true
    }

    /// The number of a placed object; `None` if the sensor cannot see it.
    #[inline(always)]
    fn number(&mut self, object: u32) -> Option<u32> {
        let (frame, number) = self.known[object as usize];
        let number = if frame == self.frame { number } else { self.place(object) };
        if number == NONE {
            return None;
        }
        let placed = &mut self.placed[number as usize];
        if placed.bundle != self.bundle {
            placed.turn_to(self.plan, (self.bundle, &self.world_from_sensor));
        }
        Some(number)
    }

    #[cold]
    #[inline(never)]
    fn place(&mut self, object: u32) -> u32 {
        let number = match Placing::new(self.plan, (self.bundle, &self.world_from_sensor), object) {
            Placing::Placed(placed) => {
                self.placed.push(*placed);
                self.placed.len() as u32 - 1
            }
            Placing::Lacking => {
                self.lacking.push(object);
                NONE
            }
            Placing::Unseen => NONE,
        };
        self.known[object as usize] = (self.frame, number);
        number
    }
}

fn image_from_world(plan: &FramePlan, world_from_sensor: &Pose) -> DMat3 {
    (world_from_sensor.rotation_matrix() * plan.sensor.body_from_image()).transpose()
}

/// Memory of searches, and the results of the last one.
pub(super) struct Search<'a> {
    stack: Vec<Entry>,
    views: Vec<TreeView<'a>>,
    pub found: Found,
    pub counts: Counts,
}

/// Counts of search steps.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Counts {
    pub nodes: u64,
    pub blocks: u64,
}

impl<'a> Search<'a> {
    pub fn new() -> Self {
        Self { stack: Vec::new(), views: Vec::new(), found: Found::new(), counts: Counts::default() }
    }

    /// Begins the search of a tile.
    #[inline(always)]
    pub fn begin(&mut self, objects: &Objects<'a>, tile: &RayTile) {
        let range_max = (objects.plan.sensor.spec().range_max - objects.plan.sensor.range_lead()) as f32;
        // The inverse depth of a unit ray is at least its inverse range.
        self.found.clear(tile, (1.0 - 1e-5) / range_max);
        self.views.clear();
        let centre = objects.world_from_sensor.translation;
        self.views.push(TreeView::of_world(objects.tree, &objects.image_from_world, centre, tile, objects.margins));
        self.stack.clear();
        if !objects.tree.nodes.is_empty() {
            self.stack.push(Entry { near: 0.0, name: 0, view: 0 });
        }
    }

    /// Finds the polygons that the rays of a tile may see. Returns false when it pauses for a decision on uncertain
    /// candidates; the next call continues the search.
    #[inline(always)]
    pub fn go_on<S: Width, const N: usize>(&mut self, simd: S, objects: &mut Objects<'a>, tile: &RayTile) -> bool {
        let mut farthest = self.found.farthest::<S, N>(simd);
        while let Some(entry) = self.stack.pop() {
            if entry.near * farthest > 1.0 {
                continue;
            }
            if entry.name & LEAF == 0 {
                self.counts.nodes += 1;
                let view = &self.views[entry.view as usize];
                let node = &view.nodes[entry.name as usize];
                open_node::<S, N>(simd, view, node, farthest, entry.view, objects, &mut self.stack);
                continue;
            }
            let number = entry.name & !LEAF;
            if entry.view > 0 {
                self.counts.blocks += 1;
                let view = &self.views[entry.view as usize];
                let placed = &objects.placed[view.object as usize];
                let block = &placed.tree.blocks[number as usize];
                if meet_block::<S, N>(simd, view, block, tile, farthest, (placed, objects.plan), &mut self.found) {
                    farthest = self.found.farthest::<S, N>(simd);
                    if self.found.unsure.len() > MANY_UNSURE {
                        self.found.settle::<S, N>(simd);
                        if self.found.unsure.len() > MANY_UNSURE / 2 {
                            return false;
                        }
                    }
                }
            } else if let Some(placed) = objects.number(number) {
                let view = TreeView::of_object(&objects.placed[placed as usize], placed, tile, objects.margins);
                if !view.nodes.is_empty() {
                    self.stack.push(Entry { near: entry.near, name: 0, view: self.views.len() as u32 });
                    self.views.push(view);
                }
            }
        }
        self.found.settle::<S, N>(simd);
        true
    }
}

/// Puts the children of a node that rays may meet on the stack, the nearest on top.
#[inline(always)]
fn open_node<'a, S: Width, const N: usize>(
    simd: S,
    view: &TreeView<'a>,
    node: &RayNode,
    farthest: f32,
    number: u32,
    objects: &Objects<'a>,
    stack: &mut Vec<Entry>,
) {
    let eight = Make::<S, N>(simd);
    let centre = eight.three(&view.centre32);
    let [low, high] = [eight.load_three(&node.low), eight.load_three(&node.high)];
    let low: Three<S, N> = three!(i => low[i] - centre[i]);
    let high: Three<S, N> = three!(i => high[i] - centre[i]);
    let nothing = eight.splat(-view.slack);
    let mut open = 0xff;
    for plane in &view.planes {
        let most = dot(&eight.three(plane), &corner(plane, &low, &high));
        open &= !nothing.more_than(most).bits();
    }
    if open == 0 {
        return;
    }
    let ahead = &view.turn[0];
    let axis = eight.three(ahead);
    let near = dot(&axis, &corner(ahead, &high, &low)) + nothing;
    let far = dot(&axis, &corner(ahead, &low, &high));
    let hidden = (near * eight.splat(farthest)).more_than(eight.splat(1.0));
    open &= !(hidden.bits() | nothing.more_than(far).bits());
    let mut nears = [0.0; WIDE];
    near.store(&mut nears);
    let first = stack.len();
    while open != 0 {
        let lane = (open.trailing_zeros() & 7) as usize;
        open &= open - 1;
        let name = node.children[lane];
        if name == NO_CHILD {
            continue;
        }
        let entry = Entry { near: nears[lane], name, view: number };
        stack.push(entry);
        let mut at = stack.len() - 1;
        while at > first && stack[at - 1].near < entry.near {
            stack[at] = stack[at - 1];
            at -= 1;
        }
        stack[at] = entry;
        if number == 0 {
            continue;
        }
        if name & LEAF == 0 {
            simd.fetch(&view.nodes[name as usize], 4);
        } else {
            let tree = objects.placed[view.object as usize].tree;
            simd.fetch(&tree.blocks[(name & !LEAF) as usize], 6);
        }
    }
}

/// The corners of boxes that are farthest along a vector; the nearest if the ends are swapped.
#[inline(always)]
fn corner<S: Width, const N: usize>(along: &[f32; 3], low: &Three<S, N>, high: &Three<S, N>) -> Three<S, N> {
    three!(i => if along[i] > 0.0 { high[i] } else { low[i] })
}

/// The maximum of a linear function of the ray in a rectangle.
#[inline(always)]
fn most<S: Width, const N: usize>(e: &Three<S, N>, s: [Eight<S, N>; 2], t: [Eight<S, N>; 2]) -> Eight<S, N> {
    e[0] + (e[1] * s[0]).max(e[1] * s[1]) + (e[2] * t[0]).max(e[2] * t[1])
}

/// The values of a linear function for some rays.
#[inline(always)]
fn along<S: Width, const N: usize>(e: &Three<S, N>, s: Eight<S, N>, t: Eight<S, N>) -> Eight<S, N> {
    e[1].times_plus(s, e[2].times_plus(t, e[0]))
}

/// Eight triangles in a tile's axes.
struct Triangles {
    /// Edge planes and k as functions of the ray, then the margin and the relative error of k.
    numbers: [[f32; WIDE]; 14],
    /// Bounds of their positions in the tile: minimum and maximum s, minimum and maximum t.
    places: [[f32; WIDE]; 4],
    /// Bits for each triangle: it may be visible; the sensor's side of its plane is decided; it has a position.
    live: u32,
    sure: u32,
    placed: u32,
    /// True if its plane's normal points away from the sensor in the tile's axes.
    averted: u32,
}

/// Sets up the triangles of a block for a tile.
#[inline(always)]
fn set_up<S: Width, const N: usize>(
    simd: S,
    view: &TreeView<'_>,
    block: &TriangleBlock,
    tile: &RayTile,
    farthest: f32,
) -> Option<Triangles> {
    let eight = Make::<S, N>(simd);
    let (zero, one) = (eight.splat(0.0), eight.splat(1.0));
    let turn: [Three<S, N>; 3] = three!(i => eight.three(&view.turn[i]));
    let base = view.place(block.base);
    let corner = eight.load_three(&block.corner);
    let sides = [eight.load_three(&block.edges[0]), eight.load_three(&block.edges[1])];
    let p0: Three<S, N> = three!(i => dot(&turn[i], &corner) + eight.splat(base[i]));
    let e1: Three<S, N> = three!(i => dot(&turn[i], &sides[0]));
    let e2: Three<S, N> = three!(i => dot(&turn[i], &sides[1]));
    let normal = cross(&e1, &e2);
    let determinant = dot(&normal, &p0);
    let flip = determinant.sign();
    let normal: Three<S, N> = three!(i => normal[i].flipped(flip));
    let raw = [cross(&p0, &e1), cross(&e2, &p0)];
    let first: Three<S, N> = three!(i => raw[0][i].flipped(flip));
    let last: Three<S, N> = three!(i => raw[1][i].flipped(flip));
    // The three edges together are the normal.
    let middle: Three<S, N> = three!(i => normal[i] - first[i] - last[i]);
    let inverse = one.over(determinant.abs());
    let k: Three<S, N> = three!(i => normal[i] * inverse);
    let reach = size(&p0) + eight.splat(view.stretch * block.diagonal);
    let (l1, l2) = (size(&e1), size(&e2));
    let unit = eight.splat(view.margin) * reach;
    let margin = unit * (l1 + l2);
    let off_plane = eight.splat(view.stretch * block.spread) * size(&normal);
    let error = eight.splat(2.0) * (off_plane + unit * l1 * l2) * inverse;
    let s = [eight.splat(tile.s_range[0]), eight.splat(tile.s_range[1])];
    let t = [eight.splat(tile.t_range[0]), eight.splat(tile.t_range[1])];
    let out = margin.flipped(eight.splat(-0.0));
    let sure = eight.splat(SURE).more_than(error).bits();
    let in_use = (1 << block.count) - 1;
    let greatest = most(&first, s, t).min(most(&middle, s, t)).min(most(&last, s, t));
    let mut live = !out.more_than(greatest).bits();
    live &= !(eight.splat(farthest).more_than(most(&k, s, t) * (one + error)).bits() & sure);
    if sure & in_use != in_use {
        // If the side of a plane is undecided, the triangle is tested against all rays.
        live |= !sure;
    }
    live &= in_use;
    if live == 0 {
        return None;
    }
    let mut triangles = Triangles {
        numbers: [[0.0; WIDE]; 14],
        places: [[0.0; WIDE]; 4],
        live,
        sure,
        placed: 0,
        averted: determinant.more_than(zero).bits(),
    };
    for i in 0..3 {
        first[i].store(&mut triangles.numbers[i]);
        middle[i].store(&mut triangles.numbers[3 + i]);
        last[i].store(&mut triangles.numbers[6 + i]);
        k[i].store(&mut triangles.numbers[9 + i]);
    }
    margin.store(&mut triangles.numbers[12]);
    error.store(&mut triangles.numbers[13]);
    locate_corners(eight, view, [&p0, &e1, &e2], reach, &mut triangles);
    Some(triangles)
}

/// Bounds the positions of triangles in the tile, given by their first corners and the edges from them.
#[inline(always)]
fn locate_corners<S: Width, const N: usize>(
    eight: Make<S, N>,
    view: &TreeView<'_>,
    [p0, e1, e2]: [&Three<S, N>; 3],
    reach: Eight<S, N>,
    triangles: &mut Triangles,
) {
    let one = eight.splat(1.0);
    let p1: Three<S, N> = three!(i => p0[i] + e1[i]);
    let p2: Three<S, N> = three!(i => p0[i] + e2[i]);
    let depth = p0[0].min(p1[0]).min(p2[0]);
    triangles.placed = depth.more_than(eight.splat(AHEAD) * reach).bits();
    let around = eight.splat(view.places) * reach.over(depth);
    let per_depth = [one.over(p0[0]), one.over(p1[0]), one.over(p2[0])];
    for i in 0..2 {
        let [a, b, c] = [p0[1 + i] * per_depth[0], p1[1 + i] * per_depth[1], p2[1 + i] * per_depth[2]];
        (a.min(b).min(c) - around).store(&mut triangles.places[2 * i]);
        (a.max(b).max(c) + around).store(&mut triangles.places[2 * i + 1]);
    }
}

/// Tests the triangles of a block against the rays of a tile. Returns true if a ray may see one.
#[inline(always)]
fn meet_block<S: Width, const N: usize>(
    simd: S,
    view: &TreeView<'_>,
    block: &TriangleBlock,
    tile: &RayTile,
    farthest: f32,
    (placed, plan): (&PlacedObject<'_>, &FramePlan),
    found: &mut Found,
) -> bool {
    let Some(triangles) = set_up::<S, N>(simd, view, block, tile, farthest) else { return false };
    let eight = Make::<S, N>(simd);
    let [s0, s1] = [eight.load(&tile.s_of_groups[0]), eight.load(&tile.s_of_groups[1])];
    let [t0, t1] = [eight.load(&tile.t_of_groups[0]), eight.load(&tile.t_of_groups[1])];
    let (all, mut live, mut any) = ((1u32 << tile.groups) - 1, triangles.live, false);
    while live != 0 {
        let lane = (live.trailing_zeros() & 7) as usize;
        live &= live - 1;
        let is_sure = triangles.sure >> lane & 1 == 1;
        let polygon = block.polygons[lane];
        if !placed.plain {
            let averted = is_sure && (triangles.averted >> lane & 1 == 1) != placed.mirrors;
            if !placed.shows(plan, polygon, averted) {
                continue;
            }
        }
        let mut groups = all;
        if triangles.placed >> lane & 1 == 1 {
            let place = &triangles.places;
            let in_s = s1.at_least(eight.splat(place[0][lane])).and(eight.splat(place[1][lane]).at_least(s0));
            let in_t = t1.at_least(eight.splat(place[2][lane])).and(eight.splat(place[3][lane]).at_least(t0));
            groups &= in_s.and(in_t).bits();
        }
        if groups != 0 {
            let candidate = Candidate { object: view.object, polygon };
            any |= meet_triangle::<S, N>(simd, &triangles, lane, is_sure, tile, groups, candidate, found);
        }
    }
    any
}

/// Tests one triangle against the rays of some groups.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "they stay in registers")]
fn meet_triangle<S: Width, const N: usize>(
    simd: S,
    triangles: &Triangles,
    lane: usize,
    is_sure: bool,
    tile: &RayTile,
    mut groups: u32,
    candidate: Candidate,
    found: &mut Found,
) -> bool {
    let eight = Make::<S, N>(simd);
    let numbers = &triangles.numbers;
    let first: Three<S, N> = three!(i => eight.splat(numbers[i][lane]));
    let middle: Three<S, N> = three!(i => eight.splat(numbers[3 + i][lane]));
    let last: Three<S, N> = three!(i => eight.splat(numbers[6 + i][lane]));
    let k: Three<S, N> = three!(i => eight.splat(numbers[9 + i][lane]));
    let (margin, error) = (eight.splat(numbers[12][lane]), numbers[13][lane]);
    let (up, down) = (eight.splat(1.0 + error), eight.splat(1.0 - error));
    let out = margin.flipped(eight.splat(-0.0));
    let mut name = NONE;
    while groups != 0 {
        let g = (groups.trailing_zeros() & 7) as usize;
        groups &= groups - 1;
        let (s, t) = (eight.load(&tile.s[g]), eight.load(&tile.t[g]));
        let (a, b, c) = (along(&first, s, t), along(&middle, s, t), along(&last, s, t));
        let inside = a.min(b).min(c);
        let value = along(&k, s, t);
        let most = if is_sure { value * up } else { eight.splat(f32::INFINITY) };
        let before = eight.load(&found.least[g]);
        let mut near = !(out.more_than(inside).bits());
        if !is_sure {
            near |= !a.max(b).max(c).more_than(margin).bits();
        }
        near &= !before.more_than(most).bits() & tile.alive[g];
        if near == 0 {
            continue;
        }
        if name == NONE {
            name = found.candidates.len() as u32;
            found.candidates.push(candidate);
        }
        let mut rest = near;
        if is_sure {
            let at_least = value * down;
            let certain = inside.at_least(margin);
            let better = certain.and(at_least.more_than(eight.load(&found.most[g])));
            // A certain hit hides everything farther, even if it does not win.
            certain.and(at_least.more_than(before)).select(at_least, before).store(&mut found.least[g]);
            let bits = better.bits();
            if bits != 0 {
                better.select(most, eight.load(&found.most[g])).store(&mut found.most[g]);
                better.put(name, &mut found.sure[g]);
                rest &= !bits;
            }
        }
        if rest != 0 {
            let mut bound = [0.0; WIDE];
            most.store(&mut bound);
            found.unsure.push(Unsure { candidate: name, group: g as u32, lanes: rest, most: bound });
        }
    }
    name != NONE
}
