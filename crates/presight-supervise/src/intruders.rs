//! Intrusions: unknown objects in a corridor.
//!
//! Pixels that measure an unknown surface in the corridor are joined to clusters. A cluster is an intrusion if the
//! expected number of similar chance clusters in a frame is below [`super::SuperviseOptions::false_alarms`]. A pixel is
//! wrong by chance with probability p = e + Q(d). Here e is the share of arbitrary readings (mixed pixels, multipath),
//! and Q(d) is the tail of Gaussian noise beyond d deviations. With N pixels whose arbitrary readings lie in the
//! corridor, the expected number of chance clusters of m pixels is at most `N p_1 (8 p'_2) .. (8 p'_m)`. A cluster
//! grows by one of 8 neighbours, and p' = q e + Q(d), because an arbitrary reading agrees with its neighbour within the
//! gate only with probability q = 2 gate / range.

use super::options::SuperviseOptions;
use super::pixels::Comparison;
use super::rays::SensorRays;
use glam::{DMat3, DVec3};
use presight_localize::verdict::Verdict;
use presight_model::geometry::{Pose, PoseEstimate};
use presight_model::index::{QueryResult, Region};
use presight_model::measured::RangeNoise;
use presight_model::statistics::{NOISE_BOUND, tail};
use presight_model::world::World;
use presight_model::{Aabb, measured::Frame};
use presight_predict::free_poses::distance;
use presight_predict::virtual_sensors::Corridor;
use std::collections::BTreeMap;

/// An unknown object in the corridor.
#[derive(Clone, Debug)]
pub struct Intrusion {
    /// The visible point nearest to the sensor, robot's frame, metres.
    pub nearest: DVec3,
    /// Covariance of that point along the robot's axes, square metres. It includes the covariance of the robot's pose
    /// if the corridor is in the world.
    pub covariance: DMat3,
    /// Distance from the sensor to that point, metres.
    pub range: f64,
    /// Minimum distance of its points along the corridor, metres.
    pub along: f64,
    /// Box around its points, robot's frame, metres.
    pub extent: Aabb,
    /// Number of pixels that see it.
    pub pixels: usize,
    /// Expected number of similar chance clusters in a frame.
    pub false_alarms: f64,
    /// Index of an object of similar size whose place in the map was seen to be empty; the intrusion may be that
    /// object.
    pub object: Option<u32>,
}

/// A pixel that measures a point in the corridor.
#[derive(Clone, Copy)]
pub struct CorridorPoint {
    pub pixel: usize,
    /// Robot's frame, metres.
    pub point: DVec3,
    pub cell: usize,
    /// Distance along the corridor, metres.
    pub along: f64,
}

/// A frame and the model, from which clusters are made.
pub struct Search<'a> {
    pub rays: &'a SensorRays,
    pub frame: &'a Frame,
    pub comparison: Option<&'a Comparison>,
    pub world: &'a World,
    pub robot: &'a PoseEstimate,
    pub corridor: &'a Corridor,
    pub options: &'a SuperviseOptions,
    pub noise: RangeNoise,
    /// Standard deviation of the sensor's pose, metres and radians.
    pub pose_deviation: [f64; 2],
}

impl Search<'_> {
    /// True if a point lies on a surface of the model, within the errors of noise, pose and model, although its pixel
    /// predicted another range.
    fn is_on_model(&self, point: &CorridorPoint, found: &mut QueryResult) -> bool {
        let z = f64::from(self.frame.ranges()[point.pixel]);
        let [metres, radians] = self.pose_deviation;
        let parts = [self.noise.range_sigma(z), z * self.noise.angle, metres, radians * z, self.options.model_sigma];
        let within = NOISE_BOUND * parts.iter().map(|x| x * x).sum::<f64>().sqrt();
        let p = self.robot.world_from_robot.transform_point(point.point);
        let environment = self.world.environment();
        let class = Some(self.frame.sensor().spec().class.as_str());
        self.world
            .polygons_in(&Region::cuboid(&Aabb { min: p - within, max: p + within }), class, found)
            .any(|(object, polygon)| distance(&environment.objects()[object as usize], polygon, p) <= within)
    }

    /// True if the model does not explain the pixel's reading.
    pub fn is_unknown(&self, point: &CorridorPoint, found: &mut QueryResult) -> bool {
        let Some(comparison) = self.comparison else { return true };
        match comparison.verdict(point.pixel) {
            Some(Verdict::Nearer | Verdict::Farther | Verdict::NotPredicted) => !self.is_on_model(point, found),
            _ => false,
        }
    }

    /// Probability that a pixel is wrong by chance: alone, and as the neighbour of a wrong pixel.
    fn chance(&self, pixel: usize, gate: f64) -> [f64; 2] {
        let arbitrary = self.options.arbitrary_readings;
        let z = f64::from(self.frame.ranges()[pixel]);
        let expected = self.comparison.map(|c| c.expected.pixels[pixel]);
        let mut gaussian = 0.0;
        let mut length = z.max(1.0);
        if let Some(expected) = expected.filter(|e| e.range.is_finite()) {
            let range = f64::from(expected.range);
            let sensor = self.rays.sensor.ray((pixel % self.rays.width) as u32, (pixel / self.rays.width) as u32);
            let cos = sensor.map_or(1.0, |ray| ray.dot(expected.normal.as_dvec3()).abs()).max(0.05);
            let [metres, radians] = self.pose_deviation;
            let across = range * self.noise.angle * (1.0 - cos * cos).max(0.0).sqrt();
            let off =
                (across * across + metres * metres + (radians * range).powi(2) + self.options.model_sigma.powi(2))
                    .sqrt();
            let sigma = self.noise.range_sigma(range).hypot(off / cos);
            gaussian = tail(((range - z).abs() / sigma).max(NOISE_BOUND));
            length = range.max(1.0);
        }
        let agreeing = (2.0 * gate / length).min(1.0);
        [arbitrary + gaussian, arbitrary * agreeing + gaussian]
    }

    /// Joins unknown points to intrusions, by distance along the corridor. `in_view` is the number of pixels whose
    /// arbitrary readings lie in the corridor. Also returns the points of each intrusion.
    pub fn intrusions(&self, points: &[CorridorPoint], in_view: f64) -> Vec<(Intrusion, Vec<CorridorPoint>)> {
        let by_pixel: BTreeMap<usize, usize> = points.iter().enumerate().map(|(i, p)| (p.pixel, i)).collect();
        let mut is_joined = vec![false; points.len()];
        let mut found = Vec::new();
        for start in 0..points.len() {
            if std::mem::replace(&mut is_joined[start], true) {
                continue;
            }
            let mut cluster = vec![start];
            let mut expected = in_view * self.chance(points[start].pixel, 0.0)[0];
            let mut next = 0;
            while next < cluster.len() {
                let here = points[cluster[next]];
                next += 1;
                for neighbour in self.rays.around(here.pixel) {
                    let Some(&i) = by_pixel.get(&neighbour).filter(|i| !is_joined[**i]) else { continue };
                    let gate = self.gate(&here, neighbour);
                    if points[i].point.distance(here.point) <= gate {
                        is_joined[i] = true;
                        expected *= 8.0 * self.chance(neighbour, gate)[1];
                        cluster.push(i);
                    }
                }
            }
            if expected <= self.options.false_alarms {
                let points: Vec<CorridorPoint> = cluster.into_iter().map(|i| points[i]).collect();
                found.push((self.intrusion(&points, expected), points));
            }
        }
        found.sort_by(|a, b| a.0.along.total_cmp(&b.0.along));
        found
    }

    /// Maximum distance between points of one object at neighbouring pixels, metres: the width of the smallest
    /// intruder, the spacing of the rays, and the noise of both readings.
    fn gate(&self, at: &CorridorPoint, neighbour: usize) -> f64 {
        let z = f64::from(self.frame.ranges()[at.pixel]);
        let angle = f64::from(self.rays.rays[at.pixel].distance(self.rays.rays[neighbour]));
        self.options.smallest + 2.0 * z * angle + 2.0 * NOISE_BOUND * self.noise.range_sigma(z)
    }

    fn intrusion(&self, points: &[CorridorPoint], false_alarms: f64) -> Intrusion {
        let ranges = self.frame.ranges();
        let pixels: BTreeMap<usize, DVec3> = points.iter().map(|p| (p.pixel, p.point)).collect();
        // The minimum of many noisy ranges is too small, so neighbours at the same distance are averaged first.
        let smooth = |p: &CorridorPoint| {
            let z = f64::from(ranges[p.pixel]);
            let within = NOISE_BOUND * std::f64::consts::SQRT_2 * self.noise.range_sigma(z);
            let same = self.rays.around(p.pixel).filter(|i| pixels.contains_key(i)).map(|i| f64::from(ranges[i]));
            let (sum, count) = same.filter(|r| (r - z).abs() <= within).fold((z, 1.0), |(s, n), r| (s + r, n + 1.0));
            sum / count
        };
        let mut nearest = (f64::INFINITY, points[0].pixel);
        for p in points {
            let range = smooth(p);
            if range < nearest.0 {
                nearest = (range, p.pixel);
            }
        }
        let (range, pixel) = nearest;
        let mount = self.rays.sensor.spec().mount;
        let ray = mount.rotation * self.rays.rays[pixel].as_dvec3();
        let nearest = mount.translation + range * ray;
        Intrusion {
            nearest,
            covariance: self.covariance(ray, range, pixel),
            range,
            along: points.iter().map(|p| p.along).fold(f64::INFINITY, f64::min),
            extent: Aabb::of(points.iter().map(|p| p.point)),
            pixels: points.len(),
            false_alarms,
            object: None,
        }
    }

    /// Covariance of a point at a range along a ray: the noise along the ray, and the width of a pixel across it.
    fn covariance(&self, ray: DVec3, range: f64, pixel: usize) -> DMat3 {
        let along = self.noise.range_sigma(range).powi(2);
        let spacing = self.rays.spacing[pixel].into_iter().filter(|s| s.is_finite()).fold(0.0, f32::max);
        // The variance of a uniform distribution over the pixel is its squared width divided by 12.
        let across = range * range * (f64::from(spacing).powi(2) / 12.0 + self.noise.angle.powi(2));
        let outer = DMat3::from_cols(ray * ray.x, ray * ray.y, ray * ray.z);
        let own = outer * along + (DMat3::IDENTITY - outer) * across;
        if self.corridor.frame() == presight_predict::virtual_sensors::CorridorFrame::Robot {
            return own;
        }
        let [metres, radians] = self.pose_deviation;
        own + DMat3::from_diagonal(DVec3::splat(metres * metres + (radians * range).powi(2)))
    }

    /// Objects whose place was seen to be empty, because more rays passed through it than met it.
    pub fn missing_objects(&self) -> Vec<u32> {
        let Some(comparison) = self.comparison else { return Vec::new() };
        let mut counts: BTreeMap<u32, [usize; 2]> = BTreeMap::new();
        for (at, pixel) in comparison.expected.pixels.iter().enumerate().filter(|(_, p)| p.range.is_finite()) {
            match comparison.verdict(at) {
                Some(Verdict::Farther) => counts.entry(pixel.object).or_default()[0] += 1,
                Some(Verdict::Confirmed) => counts.entry(pixel.object).or_default()[1] += 1,
                _ => {}
            }
        }
        counts.into_iter().filter(|(_, [passed, met])| *passed >= 3 && passed > met).map(|(object, _)| object).collect()
    }

    /// The missing object that an intrusion may be: the smallest one that is at least as large as the visible part.
    pub fn same_as(&self, intrusion: &Intrusion, missing: &[u32], gate: f64) -> Option<u32> {
        let objects = self.world.environment().objects();
        let seen = intrusion.extent.size();
        let size = |object: &u32| objects[*object as usize].world_bounds().size();
        let fits = missing.iter().filter(|object| {
            let size = size(object);
            seen <= size + gate && 4.0 * seen >= size
        });
        fits.min_by(|a, b| size(a).total_cmp(&size(b))).copied()
    }
}

/// Standard deviations of a sensor's pose over all axes, metres and radians.
pub fn deviation(robot: &PoseEstimate, mount: &Pose) -> [f64; 2] {
    let covariance = robot.sensor_covariance(mount);
    let root = |from: usize| (from..from + 3).map(|i| covariance[i][i]).sum::<f64>().max(0.0).sqrt();
    [root(0), root(3)]
}
