//! Families of scenes: the table, and functions that make the cases.

use super::family::{Case, Family, Finding, Outcome, powers};
use super::shapes::{Scene, camera, cuboid, frame, mesh, point, scanner, sensors, wall};
use crate::stability::judge::{ErrorSummary, TruthImage};
use crate::stability::subjects::Subject;
use glam::{DAffine3, DVec3, Vec3};
use presight_model::environment::NewObject;
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_render::plan::{FramePlan, IdScheme, ImageRequest, Images, Output, Outputs};
use std::sync::Arc;

/// A family of scenes.
#[derive(Clone, Copy)]
pub(super) struct SceneFamily {
    name: &'static str,
    about: &'static str,
    axis: &'static str,
    difficulties: fn(bool) -> Vec<f64>,
    cases: fn(f64) -> Result<Vec<Case>>,
}

/// The table of families.
pub(super) const SCENES: &[SceneFamily] = &[
    SceneFamily {
        name: "grazing",
        about: "A plate 10 m away that all rays meet at an ever smaller angle.",
        axis: "angle between ray and plate, rad",
        difficulties: |quick| powers(0, -9, quick),
        cases: grazing,
    },
    SceneFamily {
        name: "near-plane",
        about: "A floor of 100 x 100 m ever closer below the sensor.",
        axis: "distance to the plane, m",
        difficulties: |quick| powers(0, -12, quick),
        cases: near_plane,
    },
    SceneFamily {
        name: "sliver",
        about: "A triangle 1 m long and ever thinner, 2 m away.",
        axis: "length / width",
        difficulties: |quick| powers(0, 9, quick),
        cases: sliver,
    },
    SceneFamily {
        name: "scale",
        about: "A room with furniture, from the size of a grain to that of a planet.",
        axis: "size of the unit, m",
        difficulties: |quick| powers(-6, 7, quick),
        cases: scale,
    },
    SceneFamily {
        name: "offset",
        about: "A room at growing distances from the world's origin. Beyond 1e12 m it is refused.",
        axis: "distance from the origin, m",
        difficulties: |quick| [powers(0, 8, quick), vec![1e11, 1e13]].concat(),
        cases: offset,
    },
    SceneFamily {
        name: "depth-span",
        about: "Plates 1 mm and ever farther away in one image.",
        axis: "farthest / nearest range",
        difficulties: |quick| powers(0, 10, quick),
        cases: depth_span,
    },
    SceneFamily {
        name: "corners",
        about: "Polygons with ever more corners; more than 64 are refused.",
        axis: "corners",
        difficulties: |quick| {
            let all: &[f64] = if quick { &[3.0, 7.0, 64.0, 65.0] } else { &CORNERS };
            all.to_vec()
        },
        cases: corners,
    },
    SceneFamily {
        name: "dent",
        about: "A side of 2 m with an ever shallower reflex corner in its middle, and a neighbour that fills the dent; \
                too deep a dent is refused.",
        axis: "depth of the dent, m",
        difficulties: |quick| powers(-1, -9, quick),
        cases: dented,
    },
    SceneFamily {
        name: "bulge",
        about: "The scene with an ever flatter convex corner: three corners nearly in a line.",
        axis: "height of the bulge, m",
        difficulties: |quick| powers(-1, -9, quick),
        cases: |height| dented(-height),
    },
    SceneFamily {
        name: "warp",
        about: "A quadrilateral of 2 m with one corner ever farther from the plane of the others; too far is refused.",
        axis: "height of the corner, m",
        difficulties: |quick| powers(-9, -2, quick),
        cases: warped,
    },
    SceneFamily {
        name: "seam",
        about: "A plate that ends ever closer beyond a scanner's azimuth seam, with another behind it.",
        axis: "angle beyond the seam, rad",
        difficulties: |quick| powers(-1, -9, quick),
        cases: seam,
    },
    SceneFamily {
        name: "pole",
        about: "A plate above that ends ever closer beyond a scanner's pole, with another behind it.",
        axis: "angle beyond the pole, rad",
        difficulties: |quick| powers(-1, -9, quick),
        cases: pole,
    },
];

const CORNERS: [f64; 12] = [3.0, 4.0, 5.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 65.0];

impl Family for SceneFamily {
    fn name(&self) -> &'static str {
        self.name
    }

    fn about(&self) -> &'static str {
        self.about
    }

    fn axis(&self) -> &'static str {
        self.axis
    }

    fn difficulties(&self, quick: bool) -> Vec<f64> {
        (self.difficulties)(quick)
    }

    fn measure(&self, difficulty: f64, _quick: bool, subjects: &mut [Subject]) -> Result<Vec<Finding>> {
        match (self.cases)(difficulty) {
            Ok(cases) => measure(&cases, subjects),
            Err(e) => Ok(vec![Finding::rejected(&e)]),
        }
    }
}

/// The findings of all engines over all cases: the first fault, otherwise the largest error and bound.
pub(super) fn measure(cases: &[Case], subjects: &mut [Subject]) -> Result<Vec<Finding>> {
    let mut verdicts = vec![(ErrorSummary::default(), 0); subjects.len()];
    for case in cases {
        let outputs = if case.sensor.is_camera() { Outputs::ALL } else { Outputs::ALL.without(Output::DepthZ) };
        let request = ImageRequest { outputs, ids: IdScheme::Model };
        let plan = FramePlan::new(&case.world, &case.sensor, &case.pose, request)?;
        let picture = TruthImage::new(&plan);
        for (subject, (all, edge_on)) in subjects.iter_mut().zip(&mut verdicts) {
            let mut images = Images::default();
            *edge_on += subject.draw(&plan, &mut images).map_err(|e| e.at(subject.name.clone()))?;
            let one = picture.judge(&images, subject.engine.precision());
            let fault = one.fault.map(|what| format!("{}: {what}", case.sensor.spec().name));
            match (&all.fault, fault) {
                (Some(_), _) => {}
                (None, None) => (all.error, all.bound) = (all.error.max(one.error), all.bound.max(one.bound)),
                (None, fault) => (all.error, all.bound, all.fault) = (one.error, one.bound, fault),
            }
            all.hits += one.hits;
            all.other += one.other;
            all.unbounded += one.unbounded;
        }
    }
    Ok(subjects.iter().zip(verdicts).map(|(subject, (v, edge_on))| finding(subject.name.clone(), v, edge_on)).collect())
}

fn finding(engine: String, verdict: ErrorSummary, edge_on: usize) -> Finding {
    let ErrorSummary { error, bound, other, hits, unbounded, fault } = verdict;
    let outcome = if fault.is_some() { Outcome::Fault } else { Outcome::Ok };
    let told = [
        (unbounded, format!("the range has no bound at {unbounded} of {hits} pixels")),
        (other, format!("{other} pixels differ from the truth, as the bounds of edges and outlines allow")),
        (edge_on, format!("left out as edge-on: {edge_on} polygons, summed over images")),
    ];
    let told = told.into_iter().filter(|(n, _)| *n > 0).map(|(_, text)| text);
    let note = fault.into_iter().chain(told).collect::<Vec<_>>().join("; ");
    Finding { engine, error, bound, outcome, other, edge_on, note }
}

fn grazing(angle: f64) -> Result<Vec<Case>> {
    let mut scene = Scene::new(frame(DVec3::new(1.0, 2.0, 0.5)))?;
    let corner = |dx: f64, y: f64| point([10.0 + dx, y, angle * dx]);
    scene.add(&[vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)]], Pose::IDENTITY)?;
    scene.add(&[wall(20.0, [-30.0, 30.0], [-30.0, 30.0])], Pose::IDENTITY)?;
    let narrow = camera(150.0, (80.0 / angle).min(1e9), 16.3, 8.05)?;
    let row = scanner(-7.0, 0.45, 33, &[0.0])?;
    Ok(scene.seen_by([(narrow, Pose::IDENTITY), (row, Pose::IDENTITY)]))
}

fn near_plane(distance: f64) -> Result<Vec<Case>> {
    let mut scene = Scene::new(frame(DVec3::ZERO))?;
    let floor = [[-50.0, -50.0, 0.0], [50.0, -50.0, 0.0], [50.0, 50.0, 0.0], [-50.0, 50.0, 0.0]].map(point).to_vec();
    scene.add(&[floor], Pose::IDENTITY)?;
    scene.add(&[wall(40.0, [-60.0, 60.0], [-60.0, 60.0])], Pose::IDENTITY)?;
    Ok(scene.seen_by(sensors(DVec3::new(0.3, 0.2, distance))?))
}

fn sliver(aspect: f64) -> Result<Vec<Case>> {
    let mut scene = Scene::new(frame(DVec3::new(0.1, -0.2, 0.3)))?;
    scene.add(&[[[2.0, -0.5, 0.0], [2.0, 0.5, 0.0], [2.0, 0.1, 1.0 / aspect]].map(point).to_vec()], Pose::IDENTITY)?;
    scene.add(&[wall(5.0, [-9.0, 9.0], [-9.0, 9.0])], Pose::IDENTITY)?;
    let narrow = camera(55.0, (20.0 * aspect).min(1e9), 16.3, 12.1)?;
    let middle = (0.25 / aspect).to_degrees();
    Ok(scene.seen_by([(narrow, Pose::IDENTITY), (scanner(-20.0, 1.3, 31, &[middle])?, Pose::IDENTITY)]))
}

/// A room of 10 x 8 x 3 units, with a pillar and a plate.
fn room(unit: f64, world_from_scene: Pose) -> Result<Vec<Case>> {
    let mut scene = Scene::new(world_from_scene)?;
    let scaled = |faces: Vec<Vec<Vec3>>| -> Vec<Vec<Vec3>> {
        let by = |p: Vec3| (p.as_dvec3() * unit).as_vec3();
        faces.into_iter().map(|f| f.into_iter().map(by).collect()).collect()
    };
    scene.add(&scaled(cuboid([-5.0, -4.0, 0.0], [5.0, 4.0, 3.0])), Pose::IDENTITY)?;
    let at = |x: f64, y: f64, z: f64, yaw: f64| Pose::from_xyz_rpy(DVec3::new(x, y, z) * unit, 0.2, -0.4, yaw);
    scene.add(&scaled(vec![wall(0.0, [-0.7, 0.6], [-0.5, 0.4])]), at(2.2, 0.9, 1.3, 0.5))?;
    // The pillar's mesh has its own unit, and is scaled by its placement.
    let pillar = Arc::new(mesh(&cuboid([-0.3, -0.2, -1.0], [0.3, 0.2, 1.0]))?);
    let pose = scene.world_from_scene * at(-1.5, 1.0, 1.2, 1.1);
    let object_from_mesh = DAffine3::from_scale(DVec3::splat(unit));
    scene.insert(NewObject { object_from_mesh, ..NewObject::new("pillar", pose, pillar) })?;
    Ok(scene.seen_by(sensors(DVec3::new(0.5, 0.3, 1.2) * unit)?))
}

fn scale(unit: f64) -> Result<Vec<Case>> {
    room(unit, frame(DVec3::new(1.0, -2.0, 0.5) * unit))
}

fn offset(distance: f64) -> Result<Vec<Case>> {
    room(1.0, frame(DVec3::new(0.8, -0.5, 0.33) * distance))
}

fn depth_span(span: f64) -> Result<Vec<Case>> {
    let mut scene = Scene::new(frame(DVec3::new(0.4, 0.1, -0.3)))?;
    let mut plate = |range: f64, y: [f64; 2], z: [f64; 2]| {
        let [y, z] = [y, z].map(|side| side.map(|c| c * range));
        scene.add(&[wall(range, y, z)], Pose::from_xyz_rpy(DVec3::ZERO, 0.01, 0.03, -0.02))
    };
    plate(1e-3, [0.1, 2.0], [-1.0, 1.0])?;
    plate(1e-3 * span.sqrt(), [-2.0, 0.3], [-1.0, 0.0])?;
    plate(1e-3 * span, [-9.0, 9.0], [-9.0, 9.0])?;
    Ok(scene.seen_by(sensors(DVec3::ZERO)?))
}

fn corners(count: f64) -> Result<Vec<Case>> {
    let mut scene = Scene::new(frame(DVec3::new(0.2, 0.4, -0.3)))?;
    let corner = |k: u32| {
        let (sin, cos) = (0.3 + std::f64::consts::TAU * f64::from(k) / count).sin_cos();
        point([0.0, cos, sin])
    };
    let outline: Vec<Vec3> = (0..count as u32).map(corner).collect();
    scene.add(&[outline], Pose::from_xyz_rpy(DVec3::new(2.0, 0.1, 0.05), 0.2, 0.5, -0.3))?;
    scene.add(&[wall(5.0, [-9.0, 9.0], [-9.0, 9.0])], Pose::IDENTITY)?;
    let [all, around] = sensors(DVec3::ZERO)?;
    Ok(scene.seen_by([(camera(30.0, 16.0, 16.3, 8.1)?, Pose::IDENTITY), all, around]))
}

/// Moves the corner in the middle of the upper polygon's lower side up by `dent`, with a lower polygon that fills the
/// dent. A negative `dent` moves it down, without the lower polygon.
fn dented(dent: f64) -> Result<Vec<Case>> {
    let mut scene = Scene::new(frame(DVec3::new(0.2, 0.4, -0.3)))?;
    // Near z = 0, where f32 resolves the dent.
    let [a, b] = [[2.0, -1.0, 0.0], [2.0, 1.0, 0.0]].map(point);
    let middle = point([2.0, 0.0, dent]);
    let upper = vec![b, point([2.0, 1.0, 2.0]), point([2.0, -1.0, 2.0]), a, middle];
    let lower = vec![a, point([2.0, -1.0, -2.0]), point([2.0, 1.0, -2.0]), b, middle];
    scene.add(&if dent > 0.0 { vec![upper, lower] } else { vec![upper] }, Pose::IDENTITY)?;
    scene.add(&[wall(5.0, [-9.0, 9.0], [-9.0, 9.0])], Pose::IDENTITY)?;
    let narrow = camera(30.0, (16.0 / dent.abs()).min(1e9), 16.3, 8.1)?;
    let [all, _] = sensors(DVec3::ZERO)?;
    Ok(scene.seen_by([(narrow, Pose::IDENTITY), all]))
}

fn warped(height: f64) -> Result<Vec<Case>> {
    let mut scene = Scene::new(frame(DVec3::new(0.2, 0.4, -0.3)))?;
    let sheet = [[0.0, -1.0, -1.0], [0.0, 1.0, -1.0], [height, 1.0, 1.0], [0.0, -1.0, 1.0]].map(point).to_vec();
    scene.add(std::slice::from_ref(&sheet), Pose::from_xyz_rpy(DVec3::new(2.0, 0.1, 0.05), 0.2, 0.5, -0.3))?;
    // A sheet seen nearly along its plane.
    scene.add(&[sheet], Pose::from_xyz_rpy(DVec3::new(1.5, 0.6, -1.0), 0.1, 1.55, 0.0))?;
    scene.add(&[wall(5.0, [-9.0, 9.0], [-9.0, 9.0])], Pose::IDENTITY)?;
    let [all, around] = sensors(DVec3::ZERO)?;
    Ok(scene.seen_by([(camera(30.0, 16.0, 16.3, 8.1)?, Pose::IDENTITY), all, around]))
}

fn seam(angle: f64) -> Result<Vec<Case>> {
    let mut scene = Scene::new(frame(DVec3::new(0.2, 0.4, -0.3)))?;
    scene.add(&[wall(-2.0, [-2.0 * angle, 1.0], [-1.0, 1.0])], Pose::IDENTITY)?;
    scene.add(&[wall(-3.0, [-4.0, 4.0], [-2.0, 2.0])], Pose::IDENTITY)?;
    let rows = [25.0, 0.0, -10.0, -26.0];
    let sensors = [(-180.0, 12.0, 30), (170.0, 0.5, 40), (190.0, -0.625, 40), (540.0, -9.0, 39)];
    let sensors = sensors.map(|(start, step, count)| scanner(start, step, count, &rows));
    let sensors = sensors.into_iter().collect::<Result<Vec<_>>>()?;
    Ok(scene.seen_by(sensors.into_iter().map(|s| (s, Pose::IDENTITY))))
}

fn pole(angle: f64) -> Result<Vec<Case>> {
    let mut scene = Scene::new(frame(DVec3::new(0.2, 0.4, -0.3)))?;
    let above = |z: f64, [x0, x1]: [f64; 2], y: f64| [[x0, -y, z], [x1, -y, z], [x1, y, z], [x0, y, z]].map(point);
    scene.add(&[above(2.0, [-2.0 * angle, 1.0], 1.0).to_vec()], Pose::IDENTITY)?;
    scene.add(&[above(3.0, [-4.0, 4.0], 4.0).to_vec()], Pose::IDENTITY)?;
    scene.add(&[above(-2.0, [-1.0, 2.0 * angle], 1.0).to_vec()], Pose::IDENTITY)?;
    scene.add(&[above(-3.0, [-4.0, 4.0], 4.0).to_vec()], Pose::IDENTITY)?;
    let rows = [90.0, 89.999, 89.0, 60.0, 0.0, -60.0, -89.999_999, -90.0];
    Ok(scene.seen_by([(scanner(-180.0, 15.0, 24, &rows)?, Pose::IDENTITY)]))
}
