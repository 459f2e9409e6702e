//! Random buildings of slabs, shafts, docks, ramps, mezzanines and boxes, with the truth of their main floor. The truth
//! is kept apart from the polygons: rectangles that are floor, rectangles that are missing, and boxes.

use super::Random;
use super::scenes::{cuboid, empty, mesh};
use glam::{DVec2, DVec3, Vec3};
use presight_model::environment::{Environment, NewObject};
use presight_model::geometry::Pose;

/// A rectangle along the axes of the building, metres.
#[derive(Clone, Copy, Debug)]
pub struct Rectangle {
    /// Least corner.
    pub min: DVec2,
    /// Greatest corner.
    pub max: DVec2,
}

impl Rectangle {
    fn new(min: [f64; 2], max: [f64; 2]) -> Self {
        Self { min: min.into(), max: max.into() }
    }

    /// Area of a convex polygon in it, square metres (Sutherland and Hodgman 1974).
    pub fn area_in(&self, polygon: &[DVec2]) -> f64 {
        let mut part = polygon.to_vec();
        for (axis, limit, sign) in
            [(0, self.min.x, 1.0), (0, self.max.x, -1.0), (1, self.min.y, 1.0), (1, self.max.y, -1.0)]
        {
            let depth = |p: DVec2| sign * (p[axis] - limit);
            let mut kept = Vec::new();
            for k in 0..part.len() {
                let (p, q) = (part[k], part[(k + 1) % part.len()]);
                if depth(p) >= 0.0 {
                    kept.push(p);
                }
                if (depth(p) < 0.0) != (depth(q) < 0.0) {
                    kept.push(p.lerp(q, depth(p) / (depth(p) - depth(q))));
                }
            }
            part = kept;
        }
        let sum: f64 = (0..part.len()).map(|k| part[k].perp_dot(part[(k + 1) % part.len()])).sum();
        0.5 * sum.abs()
    }

    /// Distance of a point, metres; 0 inside.
    pub fn distance(&self, p: DVec2) -> f64 {
        (self.min - p).max(p - self.max).max(DVec2::ZERO).length()
    }
}

/// A building, and the true state of its main floor.
#[derive(Clone, Debug)]
pub struct Building {
    /// Its polygons.
    pub environment: Environment,
    /// Height of most of its main floor, metres.
    pub height: f64,
    /// From the building's plan to the world: a turn about the vertical, and a shift.
    pub world_from_plan: Pose,
    /// Disjoint rectangles of the main floor, with the heights at their least and greatest x, metres.
    pub floors: Vec<(Rectangle, [f64; 2])>,
    /// Rectangles in these that have no floor.
    pub missing: Vec<Rectangle>,
    /// Boxes that stand on the floor, in the heights of a robot.
    pub boxes: Vec<Rectangle>,
    /// True if a yard lies below the hall.
    pub has_yard: bool,
}

impl Building {
    /// A building for a seed.
    pub fn new(seed: u64) -> Self {
        let mut draft = Draft::new(seed);
        draft.hall();
        draft.dock();
        draft.ramp();
        draft.mezzanine();
        draft.boxes();
        draft.building
    }

    /// A point of the world on the plan.
    pub fn on_plan(&self, p: DVec2) -> DVec2 {
        self.world_from_plan.inverse().transform_point(p.extend(0.0)).truncate()
    }

    /// The point of the floor at a point of the plan, in the world.
    pub fn in_world(&self, p: DVec2) -> DVec3 {
        let near = self.floors.iter().min_by(|a, b| a.0.distance(p).total_cmp(&b.0.distance(p)));
        let height = near.map_or(self.height, |(r, [low, high])| {
            let t = ((p.x - r.min.x) / (r.max.x - r.min.x)).clamp(0.0, 1.0);
            low + t * (high - low)
        });
        self.world_from_plan.transform_point(p.extend(0.0)).truncate().extend(height)
    }

    /// Area of a convex polygon of the world that the main floor does not cover, square metres.
    pub fn missing_area(&self, polygon: &[DVec2]) -> f64 {
        let plan: Vec<DVec2> = polygon.iter().map(|p| self.on_plan(*p)).collect();
        let everywhere = Rectangle::new([-1e6, -1e6], [1e6, 1e6]);
        let floor: f64 = self.floors.iter().map(|(r, _)| r.area_in(&plan)).sum();
        let holes: f64 = self.missing.iter().map(|r| r.area_in(&plan)).sum();
        everywhere.area_in(&plan) - floor + holes
    }

    /// True for a point in the hall, and for one on a ramp or landing if nothing is near the end of the ramp.
    pub fn is_reached(&self, p: DVec2) -> bool {
        let plan = self.on_plan(p);
        let is_clear = |ramp: &Rectangle| {
            let near = |r: &Rectangle| {
                let gap = (r.min - ramp.max).max(ramp.min - r.max);
                gap.max_element() < 0.5
            };
            !self.missing.iter().chain(&self.boxes).any(near)
        };
        match &self.floors[..] {
            [hall, ramp, ..] => hall.0.distance(plan) == 0.0 || is_clear(&ramp.0),
            _ => true,
        }
    }

    /// Horizontal distance of a point of the world from the nearest box, metres.
    pub fn box_distance(&self, p: DVec2) -> f64 {
        let p = self.on_plan(p);
        self.boxes.iter().map(|r| r.distance(p)).fold(f64::INFINITY, f64::min)
    }
}

struct Draft {
    random: Random,
    building: Building,
    size: DVec2,
    count: usize,
}

impl Draft {
    fn new(seed: u64) -> Self {
        let mut random = Random(seed);
        let height = random.uniform(-2.0, 2.0);
        // Half of the buildings lie along the axes of the world.
        let yaw = if random.unit() < 0.5 { 0.0 } else { random.uniform(-3.0, 3.0) };
        let shift = DVec3::new(random.uniform(-9.0, 9.0), random.uniform(-9.0, 9.0), 0.0);
        let world_from_plan = Pose::from_xyz_rpy(shift, 0.0, 0.0, yaw);
        let size = DVec2::new(random.uniform(4.0, 6.0), random.uniform(3.5, 5.0));
        let building = Building {
            environment: empty(),
            height,
            world_from_plan,
            floors: Vec::new(),
            missing: Vec::new(),
            boxes: Vec::new(),
            has_yard: false,
        };
        Self { random, building, size, count: 0 }
    }

    fn insert(&mut self, mesh: presight_model::environment::Mesh) {
        self.count += 1;
        let new = NewObject::new(format!("part{}", self.count), self.building.world_from_plan, mesh.into());
        self.building.environment.insert(new).expect("a sound object");
    }

    fn solid(&mut self, plan: Rectangle, low: f64, high: f64) {
        let corner = |p: DVec2, z: f64| p.extend(z).as_vec3();
        self.insert(cuboid(corner(plan.min, low), corner(plan.max, high)));
    }

    /// A rectangle that may slope along x, from below to above, as a sheet.
    fn sheet(&mut self, plan: Rectangle, [low, high]: [f64; 2]) {
        let corner = |x: f64, y: f64, z: f64| Vec3::new(x as f32, y as f32, z as f32);
        let Rectangle { min, max } = plan;
        let corners = vec![
            corner(min.x, min.y, low),
            corner(max.x, min.y, high),
            corner(max.x, max.y, high),
            corner(min.x, max.y, low),
        ];
        self.insert(mesh(&[corners]));
    }

    /// The hall: a slab or sheets, with up to three holes, cut into rectangles along the sides of the holes.
    fn hall(&mut self) {
        let (size, height) = (self.size, self.building.height);
        let holes = self.random.below(4);
        let (mut xs, mut ys) = (vec![0.0, size.x], vec![0.0, size.y]);
        for _ in 0..holes {
            // Shafts, manholes and slots.
            let wide = [0.02, 0.2, 1.0][self.random.below(3)];
            let hole = DVec2::new(wide * self.random.uniform(1.0, 2.0), self.random.uniform(0.03, 1.2));
            let min = DVec2::new(
                self.random.uniform(0.1, size.x - hole.x - 0.1),
                self.random.uniform(0.1, size.y - hole.y - 0.1),
            );
            let new = Rectangle { min, max: min + hole };
            let apart = |r: &Rectangle| {
                let gap = (r.min - new.max).max(new.min - r.max);
                gap.max_element() > 0.02
            };
            if self.building.missing.iter().all(apart) {
                self.building.missing.push(new);
                xs.extend([min.x, min.x + hole.x]);
                ys.extend([min.y, min.y + hole.y]);
            }
        }
        self.building.floors.push((Rectangle { min: DVec2::ZERO, max: size }, [height; 2]));
        // A further cut, so that plain halls have several polygons too.
        xs.push(self.random.uniform(0.5, size.x - 0.5));
        xs.sort_by(f64::total_cmp);
        ys.sort_by(f64::total_cmp);
        let (kind, thick) = (self.random.below(3), self.random.uniform(0.03, 0.5));
        for x in xs.windows(2).filter(|w| w[1] - w[0] > 1e-3) {
            for y in ys.windows(2).filter(|w| w[1] - w[0] > 1e-3) {
                let middle = DVec2::new(x[0] + x[1], y[0] + y[1]) * 0.5;
                if self.building.missing.iter().any(|r| r.distance(middle) == 0.0) {
                    continue;
                }
                let tile = Rectangle::new([x[0], y[0]], [x[1], y[1]]);
                match kind {
                    0 => self.sheet(tile, [height; 2]),
                    _ => self.solid(tile, height - thick, height),
                }
            }
        }
        for hole in self.building.missing.clone() {
            if self.random.unit() < 0.3 {
                // A pit.
                let depth = self.random.uniform(0.3, 1.5);
                self.sheet(hole, [height - depth; 2]);
            }
        }
    }

    /// A yard below the hall.
    fn dock(&mut self) {
        if self.random.unit() < 0.5 {
            let depth = self.random.uniform(0.2, 1.3);
            let yard = Rectangle::new([-1.0, 0.0], [0.0, self.size.y]);
            self.sheet(yard, [self.building.height - depth; 2]);
            self.building.has_yard = true;
        }
    }

    /// A ramp behind the hall, and a landing at its end; or a ramp that is too steep.
    fn ramp(&mut self) {
        let height = self.building.height;
        let kind = self.random.below(3);
        if kind == 0 {
            return;
        }
        let degrees = if kind == 1 { self.random.uniform(2.0, 14.0) } else { self.random.uniform(17.0, 35.0) };
        let length = self.random.uniform(1.0, 2.5);
        let rise = degrees.to_radians().tan() * length * if self.random.unit() < 0.5 { 1.0 } else { -1.0 };
        let from = self.random.uniform(0.2, 1.0);
        let to = from + self.random.uniform(0.8, 2.0);
        let ramp = Rectangle::new([self.size.x, from], [self.size.x + length, to]);
        let landing = Rectangle::new([self.size.x + length, from], [self.size.x + length + 1.0, to]);
        self.sheet(ramp, [height, height + rise]);
        self.sheet(landing, [height + rise; 2]);
        if kind == 1 {
            self.building.floors.push((ramp, [height, height + rise]));
            self.building.floors.push((landing, [height + rise; 2]));
        }
    }

    /// A slab that the robot drives under.
    fn mezzanine(&mut self) {
        if self.random.unit() < 0.5 {
            let plan = Rectangle::new([0.3, 0.3], [self.random.uniform(0.8, 1.4), self.random.uniform(0.8, 1.4)]);
            let low = self.building.height + self.random.uniform(1.9, 3.0);
            let high = low + self.random.uniform(0.05, 0.3);
            self.solid(plan, low, high);
        }
    }

    /// Crates, tables and things that hang from above.
    fn boxes(&mut self) {
        for _ in 0..self.random.below(4) {
            let size = DVec2::new(self.random.uniform(0.03, 0.8), self.random.uniform(0.03, 0.8));
            let min = DVec2::new(
                self.random.uniform(0.0, self.size.x - size.x),
                self.random.uniform(0.0, self.size.y - size.y),
            );
            let plan = Rectangle { min, max: min + size };
            let low =
                self.building.height + if self.random.unit() < 0.5 { 0.0 } else { self.random.uniform(0.15, 1.5) };
            let high = low + self.random.uniform(0.15, 1.0);
            self.solid(plan, low, high);
            self.building.boxes.push(plan);
        }
    }
}
