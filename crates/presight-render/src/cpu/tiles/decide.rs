//! The decision of a tile: planes, edges and ties of the polygons that the search has found. It shares the functions of
//! [`super::super::lanes`], [`super::super::setup`] and [`super::super::raster_lines`], so its results have the
//! raster's bits.

use super::super::batch::{NOTHING, Shade, Winners};
use super::super::lanes::PolygonLanes;
use super::super::raster_lines::bounds_of_lines;
use super::super::setup::{Room, push_bounds};
use super::object::PlacedObject;
use super::search::{Candidate, Found, NONE, Objects};
use crate::plan::FramePlan;
use glam::DVec3;
use presight_model::sensor::{GROUP, GROUPS, GroupLayout, LineAxis, LineGrid, PixelGrid, RayGrid, RayTile, RayTiles};

/// Numbers of the rays of a group.
type Row = [f64; GROUP];

/// Rays of a group: inverse depth of a plane is `(m.x a + m.y b) c + m.z d`.
#[derive(Clone, Copy)]
struct Rays {
    a: Row,
    b: Row,
    c: Row,
    d: Row,
    /// Positions on their lines; for line grids only.
    t: Row,
}

impl Rays {
    const NONE: Self = Self { a: [0.0; GROUP], b: [0.0; GROUP], c: [1.0; GROUP], d: [0.0; GROUP], t: [0.0; GROUP] };

    #[inline(always)]
    fn inverse(&self, m: [&Row; 3]) -> Row {
        let mut k = [0.0; GROUP];
        for i in 0..GROUP {
            k[i] = (m[0][i] * self.a[i] + m[1][i] * self.b[i]) * self.c[i] + m[2][i] * self.d[i];
        }
        k
    }

    #[inline(always)]
    fn inverse_of_one(&self, m: DVec3) -> Row {
        let mut k = [0.0; GROUP];
        for i in 0..GROUP {
            k[i] = (m.x * self.a[i] + m.y * self.b[i]) * self.c[i] + m.z * self.d[i];
        }
        k
    }
}

/// A polygon with the raster's arithmetic.
#[derive(Clone, Copy)]
struct Exact {
    m: DVec3,
    slot: u32,
    shade: Shade,
    /// Its number once it wins a ray, before that [`NOTHING`].
    number: u32,
    /// False if it covers no ray, because it is edge-on or turned away.
    is_drawn: bool,
    /// Index of its first edge, once its edges are made, and for lines the number of each kind.
    edges: u32,
    counts: [u8; 3],
}

/// Entries of the table of current polygons.
const KNOWN: usize = 1024;

/// A tile begins without current polygons if there are more than this, which bounds the memory by the polygons of one
/// tile.
const MAX_IN_HAND: usize = 1 << 15;

/// Current polygons, and the visible polygon of each ray of the last tile.
pub(super) struct Decision {
    /// By slot: a polygon, and its index among the current polygons.
    known: Vec<[u32; 2]>,
    polygons: Vec<Exact>,
    pub winners: Winners,
    bounds: Vec<[f64; 2]>,
    edges: Vec<DVec3>,
    lanes: Box<PolygonLanes<1>>,
    room: Box<Room>,
    /// By candidate of the tile: its index among the current polygons.
    places: Vec<u32>,
    /// Rays on which uncertain candidates were already drawn.
    drawn: [u32; GROUPS],
    rays: Box<[Rays; GROUPS]>,
    /// By group: inverse depths, 0 without a visible polygon, and the winners.
    pub inverse: [Row; GROUPS],
    pub winner: [[u32; GROUP]; GROUPS],
    /// Number of rays that the search left undecided.
    pub unsure: u64,
}

impl Decision {
    pub fn new() -> Self {
        Self {
            known: vec![[u32::MAX, 0]; KNOWN],
            polygons: Vec::new(),
            winners: Winners::default(),
            bounds: Vec::new(),
            edges: Vec::new(),
            lanes: Box::new(PolygonLanes::new()),
            room: Box::default(),
            places: Vec::new(),
            drawn: [0; GROUPS],
            rays: Box::new([Rays::NONE; GROUPS]),
            inverse: [[0.0; GROUP]; GROUPS],
            winner: [[NOTHING; GROUP]; GROUPS],
            unsure: 0,
        }
    }

    /// Removes all current polygons.
    pub fn clear(&mut self) {
        self.winners.clear();
        self.drop_polygons();
    }

    /// Removes the current polygons, but not those that have won rays.
    pub fn drop_polygons(&mut self) {
        self.known.fill([u32::MAX, 0]);
        self.bounds.clear();
        self.edges.clear();
        self.polygons.clear();
    }

    /// Takes the rays of a tile, without visible polygons yet.
    #[inline(always)]
    pub fn begin(&mut self, grid: &PixelGrid, tiles: &RayTiles, tile: &RayTile) {
        if self.polygons.len() > MAX_IN_HAND {
            self.drop_polygons();
        }
        self.places.clear();
        self.drawn = [0; GROUPS];
        for g in 0..tile.groups {
            self.load(grid, tiles, tile.places[g], g);
        }
    }

    /// Draws all uncertain candidates, and removes them.
    #[inline(never)]
    pub fn draw_unsure(&mut self, objects: &Objects<'_>, found: &mut Found) {
        if self.polygons.len() > MAX_IN_HAND {
            self.drop_polygons();
            self.places.clear();
        }
        self.places.resize(found.candidates.len(), NONE);
        for i in 0..found.unsure.len() {
            let one = found.unsure[i];
            let (g, fresh) = (one.group as usize, one.lanes & !self.drawn[one.group as usize]);
            for lane in (0..GROUP).filter(|lane| fresh >> lane & 1 == 1) {
                (self.inverse[g][lane], self.winner[g][lane]) = (0.0, NOTHING);
            }
            self.drawn[g] |= one.lanes;
            self.draw(objects, found, one.candidate, g, one.lanes);
        }
        found.unsure.clear();
    }

    /// Decides which polygon each ray of a tile sees.
    #[inline(always)]
    pub fn run(&mut self, objects: &Objects<'_>, tile: &RayTile, found: &Found) {
        self.places.resize(found.candidates.len(), NONE);
        let mut unsure = self.drawn;
        for one in &found.unsure {
            unsure[one.group as usize] |= one.lanes;
        }
        for g in 0..tile.groups {
            self.unsure += u64::from(unsure[g].count_ones());
            let before = (self.inverse[g], self.winner[g]);
            self.take_sure(objects, found, g, tile.alive[g] & !unsure[g]);
            for lane in (0..GROUP).filter(|lane| self.drawn[g] >> lane & 1 == 1) {
                (self.inverse[g][lane], self.winner[g][lane]) = (before.0[lane], before.1[lane]);
            }
        }
        if unsure[..tile.groups].iter().all(|lanes| *lanes == 0) {
            return;
        }
        for g in 0..tile.groups {
            let mut left = unsure[g] & tile.alive[g];
            while left != 0 {
                let name = found.sure[g][left.trailing_zeros() as usize];
                let alike =
                    (0..GROUP).filter(|lane| found.sure[g][*lane] == name).fold(0, |bits, lane| bits | 1 << lane);
                if name != NONE {
                    self.draw(objects, found, name, g, left & alike);
                }
                left &= !alike;
            }
        }
        for one in &found.unsure {
            self.draw(objects, found, one.candidate, one.group as usize, one.lanes);
        }
    }

    /// Loads rays with the raster's coordinates.
    #[inline(always)]
    fn load(&mut self, grid: &PixelGrid, tiles: &RayTiles, at: [u32; 2], g: usize) {
        let rays = &mut self.rays[g];
        match (grid, tiles.layout) {
            (PixelGrid::Lines(grid), GroupLayout::Along) => along(rays, grid, at),
            (PixelGrid::Lines(grid), GroupLayout::Listed) => listed_on_lines(rays, grid, tiles.listed(at[0])),
            (PixelGrid::Lines(grid), _) => across(rays, grid, at),
            (PixelGrid::Rays(grid), GroupLayout::Listed) => listed(rays, grid, tiles.listed(at[0])),
            (PixelGrid::Rays(grid), _) => {
                let tile = at[0] as usize / GROUP * grid.tiles_across() + at[1] as usize / GROUP;
                let (own, row) = (grid.rays_of(tile), at[0] as usize % GROUP);
                (rays.a, rays.b, rays.c, rays.d) = (own.x[row], own.y[row], [1.0; GROUP], own.z[row]);
            }
        }
    }

    /// Fills the decided rays of a group, and clears the other rays.
    #[inline(always)]
    fn take_sure(&mut self, objects: &Objects<'_>, found: &Found, g: usize, sure: u32) {
        let names = &found.sure[g];
        let first = names[sure.trailing_zeros() as usize % GROUP];
        let alike = names.iter().fold(true, |alike, name| alike & (*name == first));
        if sure == 0 || (alike && first == NONE) {
            (self.inverse[g], self.winner[g]) = ([0.0; GROUP], [NOTHING; GROUP]);
            return;
        }
        if alike && sure == 0xff {
            let place = self.place(objects, found, first);
            self.inverse[g] = self.rays[g].inverse_of_one(self.polygons[place].m);
            self.winner[g] = [self.number(place); GROUP];
            return;
        }
        let (mut m, mut winner) = ([[0.0; GROUP]; 3], [NOTHING; GROUP]);
        let mut last = (NONE, NOTHING, DVec3::ZERO);
        for lane in (0..GROUP).filter(|lane| sure >> lane & 1 == 1 && names[*lane] != NONE) {
            if names[lane] != last.0 {
                let place = self.place(objects, found, names[lane]);
                last = (names[lane], self.number(place), self.polygons[place].m);
            }
            (m[0][lane], m[1][lane], m[2][lane], winner[lane]) = (last.2.x, last.2.y, last.2.z, last.1);
        }
        let k = self.rays[g].inverse(m.each_ref());
        for lane in 0..GROUP {
            self.inverse[g][lane] = if winner[lane] == NOTHING { 0.0 } else { k[lane] };
        }
        self.winner[g] = winner;
    }

    /// The number under which a current polygon wins rays.
    #[inline(always)]
    fn number(&mut self, place: usize) -> u32 {
        let exact = &mut self.polygons[place];
        if exact.number == NOTHING {
            exact.number = self.winners.push(exact.shade, exact.slot);
        }
        exact.number
    }

    /// The index of a candidate's polygon among the current polygons.
    #[inline(always)]
    fn place(&mut self, objects: &Objects<'_>, found: &Found, candidate: u32) -> usize {
        let place = self.places[candidate as usize];
        if place != NONE {
            return place as usize;
        }
        let Candidate { object, polygon } = found.candidates[candidate as usize];
        let placed = &objects.placed[object as usize];
        let slot = placed.at.first_slot + polygon;
        let entry = slot.wrapping_mul(0x9e37_79b1) as usize >> 22;
        let [known, place] = self.known[entry];
        let place = if known == slot { place } else { self.make(objects.plan, placed, polygon, slot) };
        self.known[entry] = [slot, place];
        self.places[candidate as usize] = place;
        place as usize
    }

    #[inline(never)]
    fn make(&mut self, plan: &FramePlan, placed: &PlacedObject<'_>, polygon: u32, slot: u32) -> u32 {
        let lanes = &mut *self.lanes;
        lanes.load(&placed.at, &[polygon], None);
        lanes.measure(&placed.at, &[polygon]);
        lanes.set_up_planes(&placed.at);
        let facing = (!placed.at.plain).then(|| plan.facings[usize::from(placed.at.mesh.material(polygon))]);
        let distance = lanes.distance[0];
        let is_seen = facing.is_none_or(|f| f.opaque && !(f.one_sided && distance > 0.0));
        let m = DVec3::new(lanes.m[0][0], lanes.m[1][0], lanes.m[2][0]);
        let is_drawn = is_seen && !lanes.edge_on[0];
        let shade = placed.at.shade(plan, polygon, distance);
        self.polygons.push(Exact { m, slot, shade, number: NOTHING, is_drawn, edges: u32::MAX, counts: [0; 3] });
        self.polygons.len() as u32 - 1
    }

    /// Makes the edges of a polygon.
    #[inline(never)]
    fn make_edges(&mut self, plan: &FramePlan, placed: &PlacedObject<'_>, polygon: u32, place: usize) {
        let lanes = &mut *self.lanes;
        lanes.load(&placed.at, &[polygon], None);
        lanes.measure(&placed.at, &[polygon]);
        lanes.set_up_edges(&placed.at, &[polygon]);
        let exact = &mut self.polygons[place];
        if let PixelGrid::Lines(_) = plan.sensor.grid() {
            lanes.bound();
            exact.edges = self.bounds.len() as u32;
            exact.counts = push_bounds(&mut self.bounds, lanes, 0, &mut self.room);
        } else {
            let count = lanes.corner_counts[0] as usize;
            (exact.edges, exact.counts) = (self.edges.len() as u32, [0, 0, count as u8]);
            self.edges.extend(lanes.edges[..count].iter().map(|e| DVec3::new(e[0][0], e[1][0], e[2][0])));
        }
    }

    /// Draws a candidate on some rays of a group, as the raster does.
    #[inline(always)]
    fn draw(&mut self, objects: &Objects<'_>, found: &Found, candidate: u32, g: usize, lanes: u32) {
        let place = self.place(objects, found, candidate);
        if !self.polygons[place].is_drawn {
            return;
        }
        if self.polygons[place].edges == u32::MAX {
            let Candidate { object, polygon } = found.candidates[candidate as usize];
            self.make_edges(objects.plan, &objects.placed[object as usize], polygon, place);
        }
        let exact = self.polygons[place];
        let rays = &self.rays[g];
        let k = rays.inverse_of_one(exact.m);
        let mut inside = [true; GROUP];
        if let PixelGrid::Lines(_) = objects.plan.sensor.grid() {
            let edges = &self.bounds[exact.edges as usize..];
            let [low, high] = bounds_of_lines(exact.counts, edges, &rays.a, &rays.b);
            for i in 0..GROUP {
                inside[i] = (rays.t[i] >= low[i]) & (rays.t[i] <= high[i]);
            }
        } else {
            for e in &self.edges[exact.edges as usize..][..usize::from(exact.counts[2])] {
                for i in 0..GROUP {
                    inside[i] &= (e.x * rays.a[i] + e.y * rays.b[i]) + e.z * rays.d[i] >= 0.0;
                }
            }
        }
        for i in (0..GROUP).filter(|i| lanes >> i & 1 == 1 && inside[*i]) {
            // Among bit-equal inverse depths the lower slot wins.
            let (inverse, winner) = (self.inverse[g][i], self.winner[g][i]);
            let ties = k[i] == inverse && winner != NOTHING;
            if k[i] > inverse || (ties && exact.slot < self.winners.slots[winner as usize]) {
                (self.inverse[g][i], self.winner[g][i]) = (k[i], self.number(place));
            }
        }
    }
}

/// Eight samples of a line.
#[inline(always)]
fn along(rays: &mut Rays, grid: &LineGrid, [line, sample]: [u32; 2]) {
    let [c0, c1] = grid.lines()[line as usize];
    let octet = &grid.octets()[sample as usize / GROUP];
    (rays.a, rays.b, rays.c, rays.d, rays.t) = ([c0; GROUP], [c1; GROUP], octet.w0, octet.w1, octet.t);
}

/// A sample of eight lines.
#[inline(always)]
fn across(rays: &mut Rays, grid: &LineGrid, [line, sample]: [u32; 2]) {
    let [c0, c1] = grid.eight_lines(line as usize);
    let [w0, w1] = grid.weights()[sample as usize];
    (rays.a, rays.b) = (*c0, *c1);
    (rays.c, rays.d, rays.t) = ([w0; GROUP], [w1; GROUP], [grid.positions()[sample as usize]; GROUP]);
}

/// Rays anywhere on lines.
fn listed_on_lines(rays: &mut Rays, grid: &LineGrid, pixels: &[u32; GROUP]) {
    for (i, pixel) in pixels.iter().enumerate() {
        let (line, sample) = line_and_sample(grid.axis(), grid_width(grid), *pixel as usize);
        ([rays.a[i], rays.b[i]], [rays.c[i], rays.d[i]]) = (grid.lines()[line], grid.weights()[sample]);
        rays.t[i] = grid.positions()[sample];
    }
}

/// Columns of the image of a grid.
fn grid_width(grid: &LineGrid) -> usize {
    if grid.axis() == LineAxis::Columns { grid.lines().len() } else { grid.weights().len() }
}

/// Line and sample of a pixel of an image with this many columns.
pub(super) fn line_and_sample(axis: LineAxis, width: usize, pixel: usize) -> (usize, usize) {
    let (row, column) = (pixel / width, pixel % width);
    if axis == LineAxis::Columns { (column, row) } else { (row, column) }
}

/// Rays anywhere in a table.
#[inline(always)]
fn listed(rays: &mut Rays, grid: &RayGrid, pixels: &[u32; GROUP]) {
    rays.c = [1.0; GROUP];
    for (i, pixel) in pixels.iter().enumerate() {
        let ray = grid.direction(pixel % grid.width(), pixel / grid.width());
        (rays.a[i], rays.b[i], rays.d[i]) = (ray.x, ray.y, ray.z);
    }
}
