//! The cost of predicting a lidar as a simpler one: one pose for a scan, an even grid for its beams, one centre for its
//! origins.

use super::setup::Scene;
use crate::page::{Part, Section, Table};
use crate::{csv_field, median};
use glam::DVec3;
use presight_model::error::Result;
use presight_model::geometry::{Pose, SensorPose, Twist};
use presight_model::measured::{Frame, Measurement, ScanMotion};
use presight_model::sensor::{BeamTable, Geometry, RayTable, RayTimes, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_render::plan::{Output, Outputs};
use serde::Serialize;

/// Presets that every study compares with their approximations.
pub const LIDARS: [&str; 4] = ["vlp-16-real", "vlp-32c-real", "os1-128-real", "mid-360-like"];

/// Speed of the robot, m/s ahead, and its turn to the left, rad/s: a brisk drive indoors.
const SPEED: f64 = 1.5;
const TURN: f64 = 1.0;

/// The columns of the CSV, stable for scripts.
const COLUMNS: &str = "scene,sensor,approximation,rays,wrong_2cm,wrong_10cm,median_m";

/// A simpler sensor or motion in place of the true one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Approximation {
    /// All rays from the pose in the middle of the scan.
    MiddlePose,
    /// All rays from the pose at the stamp.
    StampPose,
    /// Measured points are moved to the middle of the scan by the true motion, and compared with one pose there.
    Deskewed,
    /// Even steps of elevation from one centre, rows shifted by whole columns; the sensor stands.
    EvenGrid,
    /// The true directions from one centre, the mean origin; the sensor stands.
    OneCentre,
}

impl Approximation {
    const ALL: [Self; 5] = [Self::MiddlePose, Self::StampPose, Self::Deskewed, Self::EvenGrid, Self::OneCentre];

    /// The description in texts and tables.
    fn description(self) -> &'static str {
        match self {
            Self::MiddlePose => "one pose, in the middle of the scan",
            Self::StampPose => "one pose, at the stamp",
            Self::Deskewed => "points moved to the middle of the scan, then one pose",
            Self::EvenGrid => "an even grid for the beam table, standing",
            Self::OneCentre => "one centre for the origins, standing",
        }
    }

    /// The name in the CSV.
    fn name(self) -> &'static str {
        match self {
            Self::MiddlePose => "middle_pose",
            Self::StampPose => "stamp_pose",
            Self::Deskewed => "deskewed",
            Self::EvenGrid => "even_grid",
            Self::OneCentre => "one_centre",
        }
    }

    /// True if the sensor has what the approximation leaves out.
    fn concerns(self, sensor: &Sensor) -> bool {
        match self {
            Self::MiddlePose | Self::StampPose | Self::Deskewed => !sensor.spec().times.is_at_once(),
            Self::EvenGrid => beams(sensor).is_some(),
            Self::OneCentre => sensor.has_origins(),
        }
    }

    fn is_standing(self) -> bool {
        matches!(self, Self::EvenGrid | Self::OneCentre)
    }
}

/// The cost of one approximation of one sensor in one scene, over the rays of all poses that meet a surface within the
/// limits of the sensor, in truth or by the approximation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ApproximationCost {
    /// Scene.
    pub scene: String,
    /// Sensor.
    pub sensor: String,
    /// The simpler sensor or motion.
    pub approximation: Approximation,
    /// Number of rays.
    pub rays: usize,
    /// Share of rays with a range that is wrong by over 2 cm.
    pub wrong_2cm: f64,
    /// Share of rays with a range that is wrong by over 10 cm.
    pub wrong_10cm: f64,
    /// Median error of the ranges, metres. Infinite if at least half of them are missing.
    pub median_m: f64,
}

/// One line of text: scene, sensor, approximation and its cost.
impl std::fmt::Display for ApproximationCost {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [two, ten] = [self.wrong_2cm, self.wrong_10cm].map(|share| 100.0 * share);
        let (scene, sensor, what) = (&self.scene, &self.sensor, self.approximation.description());
        write!(f, "{scene}, {sensor}: {what}: {two:.2} % of the rays wrong by over 2 cm, {ten:.2} % by over 10 cm")
    }
}

/// True for a sensor that an approximation simplifies.
pub fn is_approximated(sensor: &Sensor) -> bool {
    Approximation::ALL.iter().any(|approximation| approximation.concerns(sensor))
}

/// The costs of the approximations of a sensor, on a robot that drives ahead and turns.
///
/// # Errors
/// Errors from predictions.
pub(super) fn costs(scene: &Scene, sensor: &Sensor) -> Result<Vec<ApproximationCost>> {
    costs_on(scene, sensor, Twist::new(DVec3::X * SPEED, DVec3::Z * TURN))
}

fn costs_on(scene: &Scene, sensor: &Sensor, twist: Twist) -> Result<Vec<ApproximationCost>> {
    let motion = ScanMotion::Twist(twist);
    let mut predictor = Predictor::new(Options::new(Backend::Cpu))?;
    let concerned: Vec<_> = Approximation::ALL.into_iter().filter(|a| a.concerns(sensor)).collect();
    let mut errors = vec![Vec::new(); concerned.len()];
    for pose in &scene.poses {
        let mut ranges =
            |sensor: &Sensor, pose: &Pose, motion| predicted(&mut predictor, &scene.world, sensor, pose, motion);
        let moving = ranges(sensor, pose, Some(&motion))?;
        let standing = ranges(sensor, pose, None)?;
        for (approximation, errors) in concerned.iter().zip(&mut errors) {
            let truth = if approximation.is_standing() { &standing } else { &moving };
            let (truth, simple) = match approximation {
                Approximation::MiddlePose => {
                    (truth.clone(), ranges(sensor, &in_the_middle(sensor, pose, &motion)?, None)?)
                }
                Approximation::StampPose => (truth.clone(), standing.clone()),
                Approximation::Deskewed => {
                    let (moved, points) = deskewed(sensor, truth, &motion)?;
                    let mut there = ranges(&moved, &in_the_middle(sensor, pose, &motion)?, None)?;
                    // Rays without a point have no place to be compared at.
                    let missing = there.iter_mut().zip(&points).filter(|(_, point)| !point.is_finite());
                    missing.for_each(|(range, _)| *range = f32::NAN);
                    (points, there)
                }
                Approximation::EvenGrid => (truth.clone(), ranges(&even_grid(sensor)?, pose, None)?),
                Approximation::OneCentre => (truth.clone(), ranges(&one_centre(sensor)?, pose, None)?),
            };
            errors.extend(differences(&truth, &simple));
        }
    }
    let cost = |(approximation, errors)| cost(scene, sensor, approximation, errors);
    Ok(concerned.into_iter().zip(errors).map(cost).collect())
}

fn cost(scene: &Scene, sensor: &Sensor, approximation: Approximation, errors: Vec<f64>) -> ApproximationCost {
    let share = |limit: f64| errors.iter().filter(|e| **e > limit).count() as f64 / errors.len().max(1) as f64;
    ApproximationCost {
        scene: scene.name.clone(),
        sensor: sensor.spec().name.clone(),
        approximation,
        rays: errors.len(),
        wrong_2cm: share(0.02),
        wrong_10cm: share(0.1),
        median_m: median(errors),
    }
}

fn predicted(
    predictor: &mut Predictor,
    world: &World,
    sensor: &Sensor,
    pose: &Pose,
    motion: Option<&ScanMotion>,
) -> Result<Vec<f32>> {
    let request = Request::of(Outputs::of(&[Output::Range]));
    let request = motion.map_or(request.clone(), |motion| request.with_motion(motion.clone()));
    Ok(predictor.predict(world, sensor, &SensorPose::new(*pose), &request)?.images.range)
}

/// The errors of the rays that have a range in one of two images at least; infinite if the other one has none.
fn differences(truth: &[f32], simple: &[f32]) -> Vec<f64> {
    let pairs = truth.iter().zip(simple).filter(|(a, b)| a.is_finite() || b.is_finite());
    let off = |(a, b): (&f32, &f32)| {
        let off = (f64::from(*a) - f64::from(*b)).abs();
        if off.is_nan() { f64::INFINITY } else { off }
    };
    pairs.map(off).collect()
}

/// World from sensor halfway between the first and the last ray.
fn in_the_middle(sensor: &Sensor, pose: &Pose, motion: &ScanMotion) -> Result<Pose> {
    let [first, last] = sensor.scan_interval();
    motion.sensor_at(sensor, pose, (first + last) / 2.0)
}

/// The points of a moving scan as localization and updates take them: from one point in the middle of the scan, where the
/// sensor gets rays through them, and their ranges there.
fn deskewed(sensor: &Sensor, ranges: &[f32], motion: &ScanMotion) -> Result<(Sensor, Vec<f32>)> {
    let frame = Frame::new(0.0, sensor.clone(), Measurement::Range(ranges.to_vec()))?;
    let moving = frame.with_scan_motion(motion.clone());
    let still = moving.at_one_moment()?.frame;
    // Ranges that cross a limit of the sensor on the way to the middle are not errors.
    Ok((Sensor::new(still.sensor().spec().clone().with_limits(0.0, f64::INFINITY))?, still.ranges().to_vec()))
}

/// The specification of a sensor that measures other rays, all at once.
fn still(sensor: &Sensor, geometry: Geometry) -> SensorSpec {
    sensor.spec().clone().with_geometry(geometry).with_times(RayTimes::AtOnce)
}

fn beams(sensor: &Sensor) -> Option<&BeamTable> {
    let Geometry::Rays(table) = &sensor.spec().geometry else { return None };
    table.beams()
}

/// The mean origin of the rays.
fn centre(sensor: &Sensor) -> DVec3 {
    let pixels = (0..sensor.height()).flat_map(|row| (0..sensor.width()).map(move |column| (column, row)));
    let origins = pixels.filter(|(c, r)| sensor.ray(*c, *r).is_some()).map(|(c, r)| sensor.origin(c, r));
    let (sum, count) = origins.fold((DVec3::ZERO, 0_u32), |(sum, count), origin| (sum + origin, count + 1));
    sum / f64::from(count.max(1))
}

/// Even steps from the highest elevation to the lowest, and rows shifted by whole columns.
fn even_grid(sensor: &Sensor) -> Result<Sensor> {
    let mut even = beams(sensor).expect("the approximation concerns beam tables").clone();
    let rows = even.elevations_deg.len();
    let mut falling: Vec<usize> = (0..rows).collect();
    falling.sort_by(|a, b| even.elevations_deg[*b].total_cmp(&even.elevations_deg[*a]));
    let [high, low] = [falling[0], falling[rows - 1]].map(|row| even.elevations_deg[row]);
    for (rank, row) in falling.into_iter().enumerate() {
        even.elevations_deg[row] = high + (low - high) * rank as f64 / rows.saturating_sub(1).max(1) as f64;
    }
    let columns = even.azimuth.len();
    let step = (even.azimuth.degrees(columns - 1) - even.azimuth.degrees(0)) / columns.saturating_sub(1).max(1) as f64;
    let whole = |offset: f64| if step == 0.0 { 0.0 } else { (offset / step).round() * step };
    even.azimuth_offsets_deg.iter_mut().for_each(|offset| *offset = whole(*offset));
    even.origins = Vec::new();
    even.range_lead = 0.0;
    even.body_from_head.translation = centre(sensor);
    Sensor::new(still(sensor, Geometry::Rays(RayTable::of_beams(even)?)))
}

/// The directions of the sensor from its mean origin.
fn one_centre(sensor: &Sensor) -> Result<Sensor> {
    let Geometry::Rays(table) = &sensor.spec().geometry else { unreachable!("rays with origins are a table") };
    let rays = table.directions().to_vec();
    let origins = vec![centre(sensor); rays.len()];
    let table = RayTable::new(table.width(), table.height(), rays)?.with_origins(origins)?;
    Sensor::new(still(sensor, Geometry::Rays(table)))
}

/// The costs as CSV, one per line.
pub fn approximations_to_csv(costs: &[ApproximationCost]) -> String {
    let mut csv = format!("{COLUMNS}\n");
    for c in costs {
        let names = [&c.scene, &c.sensor].map(|name| csv_field(name)).join(",");
        let name = c.approximation.name();
        csv += &format!("{names},{name},{},{:.6},{:.6},{:.6}\n", c.rays, c.wrong_2cm, c.wrong_10cm, c.median_m);
    }
    csv
}

/// The section of the page.
pub(super) fn section(costs: &[ApproximationCost]) -> Section {
    let text = format!(
        "How wrong the ranges of a lidar are if it is taken for a simpler one, on a robot that drives ahead at {SPEED} \
         m/s and turns to the left at {TURN} rad/s. The truth is predicted from each ray's own origin, pose and time, \
         by the CPU engine. A ray counts if it has a range in truth or by the approximation, and is wrong by over \
         10 cm if only one of the two has one. An even grid has even steps of elevation from one centre, and rows shifted by \
         whole columns. One centre is the mean origin. Sensors whose rays start at several points have no charts: a \
         single path of the CPU engine draws them."
    );
    let mut parts = vec![Part::Text(text)];
    let mut scenes: Vec<&str> = costs.iter().map(|c| c.scene.as_str()).collect();
    scenes.dedup();
    for scene in scenes {
        let row = |c: &ApproximationCost| {
            let shares = [c.wrong_2cm, c.wrong_10cm].map(|share| format!("{:.2}", 100.0 * share));
            let median = if c.median_m.is_finite() { format!("{:.1}", 1e3 * c.median_m) } else { "none".into() };
            let [two, ten] = shares;
            vec![c.sensor.clone(), c.approximation.description().into(), two, ten, median]
        };
        let head = ["sensor", "taken for it", "% of rays wrong by over 2 cm", "% by over 10 cm", "median, mm"];
        parts.push(Part::Table(Table {
            caption: scene.to_owned(),
            head: head.map(String::from).to_vec(),
            rows: costs.iter().filter(|c| c.scene == scene).map(row).collect(),
            marked: Vec::new(),
        }));
    }
    Section { title: "Lidars taken for simpler ones".into(), label: None, parts }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use presight_model::environment::NewObject;
    use presight_model::sensor::{Angles, StampAt};
    use presight_testkit::scenes;

    /// A wall across x, 4 m ahead.
    fn scene() -> Scene {
        let corners = [(-50.0, -50.0), (50.0, -50.0), (50.0, 50.0), (-50.0, 50.0)];
        let wall = scenes::mesh(&[corners.map(|(y, z)| Vec3::new(4.0, y, z)).to_vec()]);
        let mut environment = scenes::empty();
        environment.insert(NewObject::new("wall", Pose::IDENTITY, wall.into())).unwrap();
        Scene { name: "wall".into(), world: World::new(environment), poses: vec![Pose::IDENTITY] }
    }

    /// Rays along x from these places along x, 0.02 s apart.
    fn along_x(places: &[f64]) -> Sensor {
        let count = places.len();
        let origins = places.iter().map(|x| DVec3::X * *x).collect();
        let table = RayTable::new(count as u32, 1, vec![DVec3::X; count]).unwrap().with_origins(origins).unwrap();
        let times = RayTimes::turning(0.02 * count as f64, StampAt::First);
        Sensor::new(SensorSpec::new("five", "laser", Geometry::Rays(table)).with_times(times)).unwrap()
    }

    fn found(sensor: &Sensor, wanted: Approximation) -> [f64; 3] {
        let costs = costs_on(&scene(), sensor, Twist::new(DVec3::X * SPEED, DVec3::ZERO)).unwrap();
        let cost = costs.iter().find(|c| c.approximation == wanted).expect("it concerns the sensor");
        assert_eq!(cost.rays, (sensor.width() * sensor.height()) as usize);
        [cost.wrong_2cm, cost.wrong_10cm, (1e4 * cost.median_m).round() / 1e4]
    }

    /// By hand: at 1.5 m/s towards a wall 4 m away, five rays see it 0, 3, 6, 9 and 12 cm nearer. In the middle of the
    /// scan one pose sees it 6 cm nearer.
    #[test]
    fn one_pose_per_scan_costs_the_way_driven_meanwhile() {
        let sensor = along_x(&[0.0; 5]);
        assert_eq!(found(&sensor, Approximation::StampPose), [0.8, 0.2, 0.06]);
        assert_eq!(found(&sensor, Approximation::MiddlePose), [0.8, 0.0, 0.03]);
        assert_eq!(found(&sensor, Approximation::Deskewed), [0.0; 3]);
        // Planted: points are moved the wrong way, by 12, 6, 0, 6 and 12 cm.
        let drive = |speed: f64| ScanMotion::Twist(Twist::new(DVec3::X * speed, DVec3::ZERO));
        let mut predictor = Predictor::new(Options::new(Backend::Cpu)).unwrap();
        let scene = scene();
        let truth = predicted(&mut predictor, &scene.world, &sensor, &Pose::IDENTITY, Some(&drive(SPEED))).unwrap();
        let (rays, moved) = deskewed(&sensor, &truth, &drive(-SPEED)).unwrap();
        let middle = in_the_middle(&sensor, &Pose::IDENTITY, &drive(SPEED)).unwrap();
        let simple = predicted(&mut predictor, &scene.world, &rays, &middle, None).unwrap();
        let off: Vec<f64> = differences(&moved, &simple).iter().map(|e| (e * 100.0).round()).collect();
        assert_eq!(off, [12.0, 6.0, 0.0, 6.0, 12.0]);
    }

    /// By hand: origins 0, 3 and 15 cm off their mean along the ray.
    #[test]
    fn one_centre_costs_the_distance_from_it() {
        let sensor = along_x(&[0.0, 0.03, -0.03, 0.15, -0.15]);
        assert_eq!(found(&sensor, Approximation::OneCentre), [0.8, 0.4, 0.03]);
    }

    /// By hand: of beams at 30, 10 and -30 degrees the second is taken for a level one: 4 m for 4 m / cos 10 degrees,
    /// 6.2 cm off.
    #[test]
    fn an_even_grid_costs_the_angles_between() {
        let azimuth = Angles::Listed(vec![0.0]);
        let table = |elevations: Vec<f64>| RayTable::of_beams(BeamTable::new(azimuth.clone(), elevations)).unwrap();
        let sensor =
            |elevations| Sensor::new(SensorSpec::new("three", "laser", Geometry::Rays(table(elevations)))).unwrap();
        assert_eq!(found(&sensor(vec![30.0, 10.0, -30.0]), Approximation::EvenGrid), [1.0 / 3.0, 0.0, 0.0]);
        assert_eq!(found(&sensor(vec![-30.0, 30.0, 0.0]), Approximation::EvenGrid), [0.0; 3]);
    }

    #[test]
    fn rays_that_only_one_of_two_images_has_are_wrong() {
        let (none, near) = (f32::INFINITY, f32::NEG_INFINITY);
        let off = differences(&[1.0, none, 2.0, none, near], &[1.5, none, none, 3.0, near]);
        assert_eq!(off, [0.5, f64::INFINITY, f64::INFINITY]);
    }
}
