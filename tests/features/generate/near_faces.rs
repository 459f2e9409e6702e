//! Faces closer together than a millimetre. A camera sees the edges of the outer face, worked out by hand; generated
//! lines must cover them however small the gap.

use super::scenes::{cuboid, put};
use glam::{DAffine3, DVec3, Vec3};
use presight_features::generate::{GenerateOptions, generate};
use presight_features::{FeatureOptions, Hidden, place};
use presight_model::environment::{Environment, FeatureShape, NewObject};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::{Camera, Geometry, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_render::plan::{Output, Outputs};

/// Farther from an edge than this a line is another one, metres: over the largest gap.
const NEAR: f64 = 2.5e-3;

/// The share of an edge that visible generated lines cover, and whether a visible corner is at each of its ends.
struct Seen {
    share: f64,
    corners: [bool; 2],
}

fn see(environment: Environment, pose: &Pose, edges: &[[DVec3; 2]]) -> Vec<Seen> {
    let layer = generate(&environment, "video", &GenerateOptions::default()).unwrap().layer;
    let world = World::new(environment);
    let placed = place(&world, &layer).unwrap();
    let camera = Camera::pinhole(640, 480, 400.0, 400.0, 319.5, 239.5);
    let sensor = Sensor::new(SensorSpec::new("pinhole", "video", Geometry::Camera(camera))).unwrap();
    let options = FeatureOptions::default().with_placed(placed).with_hidden(Hidden::Full);
    let request = Request::of(Outputs::of(&[Output::PolygonId])).with_features(options);
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    let seen =
        predictor.predict(&world, &sensor, &SensorPose::new(*pose), &request).unwrap().features.unwrap().features;
    let cover = |[a, b]: &[DVec3; 2]| {
        let (d, length) = ((*b - *a).normalize(), a.distance(*b));
        let on = |p: DVec3| (p - *a - d * (p - *a).dot(d)).length() <= NEAR;
        let mut parts = Vec::new();
        for f in seen.iter().filter(|f| matches!(f.feature.shape, FeatureShape::Segment { .. })) {
            let [p, q] = [f.points_world[0], f.points_world[1]];
            if !on(p) || !on(q) {
                continue;
            }
            for v in &f.visible {
                let [s, t] = v.t.map(|t| (p.lerp(q, t) - *a).dot(d).clamp(0.0, length));
                parts.push((s.min(t), s.max(t)));
            }
        }
        parts.sort_by(|x, y| x.0.total_cmp(&y.0));
        let (mut covered, mut reached) = (0.0, 0.0f64);
        for (from, to) in parts {
            covered += (to - from.max(reached)).max(0.0);
            reached = reached.max(to);
        }
        let corner = |at: &DVec3| {
            let points = seen.iter().filter(|f| matches!(f.feature.shape, FeatureShape::Point { .. }));
            points.into_iter().any(|f| f.visible_fraction == 1.0 && f.points_world[0].distance(*at) <= NEAR)
        };
        Seen { share: covered / length, corners: [corner(a), corner(b)] }
    };
    edges.iter().map(cover).collect()
}

fn assert_seen(environment: Environment, pose: &Pose, edges: &[[DVec3; 2]], what: &str) {
    for (k, seen) in see(environment, pose, edges).into_iter().enumerate() {
        assert!(seen.share > 0.99, "{what}: {} of edge {k} is seen", seen.share);
        assert_eq!(seen.corners, [true; 2], "{what}: the corners of edge {k}");
    }
}

const GAPS: [f32; 12] = [0.0, 1e-6, 5e-6, 1e-5, 1.2e-5, 2e-5, 5e-5, 1e-4, 5e-4, 1e-3, 1.1e-3, 2e-3];

/// A box with its front at x = 0, and one whose front is behind it by a gap. The camera sees the outline of the nearer
/// front, whichever box comes first, and whether they are one object or two.
#[test]
fn the_outline_of_the_nearer_of_two_fronts_is_seen() {
    let pose = Pose::from_xyz_rpy(DVec3::new(-4.0, 0.1, 1.2), 0.0, 0.0, 0.0);
    let corners = [[-1.0, 0.0], [1.0, 0.0], [1.0, 2.0], [-1.0, 2.0]].map(|[y, z]| DVec3::new(0.0, y, z));
    let edges: Vec<[DVec3; 2]> = (0..4).map(|k| [corners[k], corners[(k + 1) % 4]]).collect();
    for gap in GAPS {
        let outer = cuboid(Vec3::new(0.0, -1.0, 0.0), Vec3::new(1.0, 1.0, 2.0));
        // As large as the outer one; over a part of its width; through its sides.
        for (k, width) in [[-1.0, 1.0], [-0.5, 0.4], [-2.0, 0.3]].into_iter().enumerate() {
            let inner = cuboid(Vec3::new(gap, width[0], 0.0), Vec3::new(0.9, width[1], 2.0));
            for order in [[&outer, &inner], [&inner, &outer]] {
                let mut two = super::scenes::empty();
                order.iter().for_each(|loops| at_origin(&mut two, loops));
                let mut one = super::scenes::empty();
                at_origin(&mut one, &[order[0].clone(), order[1].clone()].concat());
                // Through the sides at no gap the outer front continues: only two corners of it remain.
                if k == 2 && gap < 2e-3 {
                    continue;
                }
                assert_seen(two, &pose, &edges, &format!("two objects, gap {gap}, inner {k}"));
                assert_seen(one, &pose, &edges, &format!("one object, gap {gap}, inner {k}"));
            }
        }
    }
}

fn at_origin(environment: &mut Environment, loops: &[super::scenes::Loop]) {
    environment.insert(NewObject::new("o", Pose::IDENTITY, super::scenes::mesh(loops))).unwrap();
}

/// Two walls 10.15 m long and 0.15 m thick, as Gazebo's building editor writes them: with a yaw of 1.57079 the end of
/// the second wall is off the first wall's outer edge by 5.075 m (pi / 2 - 1.57079) = 32 micrometres.
#[test]
#[allow(clippy::approx_constant)] // The editor's own digits.
fn the_corner_of_a_building_is_seen() {
    let wall = cuboid(Vec3::new(-5.075, -0.075, -1.25), Vec3::new(5.075, 0.075, 1.25));
    let poses = [([0.0, 0.0], 0.0), ([5.0, 5.0], 1.57079), ([0.0, 10.0], 3.14159), ([-5.0, 5.0], -1.57079)];
    let vertical = |x: f64, y: f64| [DVec3::new(x, y, 0.0), DVec3::new(x, y, 2.5)];
    let top: [[f64; 2]; 4] = [[-5.075, -0.075], [5.075, -0.075], [5.075, 10.075], [-5.075, 10.075]];
    for order in [[0, 1, 2, 3], [3, 2, 1, 0], [1, 0, 3, 2]] {
        for (k, [x, y]) in top.into_iter().enumerate() {
            let mut environment = super::scenes::empty();
            for i in order {
                let ([x, y], yaw) = poses[i];
                let pose = Pose::from_xyz_rpy(DVec3::new(x, y, 1.25), 0.0, 0.0, yaw);
                environment.insert(NewObject::new("wall", pose, super::scenes::mesh(&wall))).unwrap();
            }
            let world = || environment.clone();
            // From the diagonal, and nearly along each of the two walls.
            for turn in [-1.0f64, 0.0, 1.0] {
                let yaw = (y - 5.0).atan2(x) + turn;
                let eye = DVec3::new(x + 3.0 * yaw.cos(), y + 3.0 * yaw.sin(), 1.3);
                let pose = Pose::from_xyz_rpy(eye, 0.0, 0.0, yaw + std::f64::consts::PI);
                assert_seen(world(), &pose, &[vertical(x, y)], &format!("order {order:?}, corner {k}, turn {turn}"));
            }
        }
    }
}

/// Lines that only continue each other with a step are joined, on the longer one. A line that lies on it is the same
/// line, and one 0.2 mm away is another.
#[test]
fn pieces_of_one_edge_stay_one_line() {
    let tile = |x: [f32; 2], y: f32| {
        let corners = [[x[0], y], [x[1], y], [x[1], 1.0], [x[0], 1.0]].map(|[x, y]| Vec3::new(x, y, 0.0));
        (corners.to_vec(), 0)
    };
    let (short, long) = (tile([0.0, 1.0], 0.0), tile([1.0, 2.5], 2e-4));
    // The outline of both tiles has four lines. The lower side of the short tile is 0.2 mm from the joined line.
    for (second, expected) in [(&long, 4), (&short, 5)] {
        let mut environment = super::scenes::empty();
        put(&mut environment, DAffine3::IDENTITY, &[short.clone(), long.clone()]);
        put(&mut environment, DAffine3::IDENTITY, std::slice::from_ref(second));
        let counts = generate(&environment, "video", &GenerateOptions::default()).unwrap().counts;
        assert_eq!(counts.made[1], expected);
    }
}
