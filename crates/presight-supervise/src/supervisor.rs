//! Supervision of a corridor, frame by frame.

use super::grid::Cells;
use super::intruders::{CorridorPoint, Intrusion, Search, deviation};
use super::look::{CellView, SensorView};
use super::options::SuperviseOptions;
use super::pixels::{Comparison, Readings};
use super::rays::SensorRays;
use super::report::Report;
use super::state::{CellState, UnseenReason};
use presight_localize::verdict::{ExpectedImage, Surfaces, Verdict, judge};
use presight_model::clock::Instant;
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::geometry::{Pose, PoseEstimate, RobotPose};
use presight_model::index::QueryResult;
use presight_model::measured::{Frame, RangeNoise};
use presight_model::world::World;
use presight_predict::predict::Predictor;
use presight_predict::request::Request;
use presight_predict::virtual_sensors::{Corridor, CorridorFrame};
use presight_render::plan::{Output, Outputs};
use std::collections::BTreeMap;
use std::time::Duration;

/// Supervises a corridor. It is not a safety device.
///
/// A scanner supervises an empty corridor of a room. Then a box stands in it.
/// ```
/// use presight::environment::Environment;
/// use presight::simulate::{Disturbances, Simulator};
/// use presight::supervise::{CellState, SuperviseOptions, Supervisor};
/// use presight::virtual_sensors::Corridor;
/// use presight::{Options, Pose, PoseEstimate, Predictor, RobotPose, World};
/// use glam::DVec3;
/// let at = |x: f64, y: f64, z: f64| Pose::from_xyz_rpy(DVec3::new(x, y, z), 0.0, 0.0, 0.0);
/// let mut environment = Environment::new();
/// environment.add_cuboid("wall", at(5.0, 0.0, 0.0), DVec3::new(0.2, 9.0, 4.0))?;
/// let model = World::new(environment.clone());
/// environment.add_cuboid("box", at(1.5, 0.0, 0.0), DVec3::splat(0.2))?;
///
/// let scanner = presight::preset("laser-scanner")?;
/// let predictor = || Predictor::new(Options::default());
/// let mut simulator = Simulator::new(predictor()?, scanner, Disturbances::default(), 1)?;
/// let frame = simulator.frame(&World::new(environment), 0.0, &RobotPose::IDENTITY)?;
///
/// let corridor = Corridor::new(vec![[0.5, 0.0], [3.0, 0.0]], 0.3, -0.1, 0.1)?;
/// let mut supervisor = Supervisor::new(corridor, SuperviseOptions::default().with_upright(true).with_speed(0.5))?;
/// let known = PoseEstimate::of_sigmas(RobotPose::IDENTITY, 0.002, 0.001);
/// let report = supervisor.supervise(&mut predictor()?, &model, &[&frame], Some(&known))?;
/// let box_seen = &report.intrusions[0];
/// assert!((box_seen.nearest.x - 1.4).abs() < 0.05 && report.intrusions.len() == 1);
/// assert!((report.time_to_reach.unwrap() - 1.8).abs() < 0.1, "0.9 m along the corridor at 0.5 m/s");
/// let cell = supervisor.cells().cell_at(DVec3::new(1.0, 0.0, 0.0)).unwrap();
/// assert_eq!(report.cells[cell], CellState::Free);
/// # Ok::<(), presight::Error>(())
/// ```
pub struct Supervisor {
    corridor: Corridor,
    options: SuperviseOptions,
    cells: Cells,
    /// Cells by distance along the corridor.
    order: Vec<u32>,
    rays: Vec<SensorRays>,
    surfaces: Surfaces,
}

/// Maximum number of sensors whose rays are remembered.
const MAX_SENSORS: usize = 8;
/// Number of cells between two readings of the clock.
const CLOCK_INTERVAL: usize = 64;

/// The contribution of one sensor.
struct Seen {
    /// By cell; `None` for a cell that the deadline left out.
    views: Vec<Option<CellView>>,
    known: BTreeMap<usize, u32>,
    intruded: Vec<usize>,
    intrusions: Vec<Intrusion>,
}

impl Supervisor {
    /// Cuts a corridor into cells.
    ///
    /// # Errors
    /// Those of [`SuperviseOptions::check`] and [`Cells::new`].
    pub fn new(corridor: Corridor, options: SuperviseOptions) -> Result<Self> {
        options.check()?;
        let cells = Cells::new(&corridor, options.cell)?;
        let mut order: Vec<u32> = (0..cells.count() as u32).collect();
        order.sort_by(|a, b| {
            let along = |cell: &u32| cells.along[*cell as usize / cells.layers];
            along(a).total_cmp(&along(b))
        });
        Ok(Self { corridor, options, cells, order, rays: Vec::new(), surfaces: Surfaces::default() })
    }

    /// The cells.
    pub fn cells(&self) -> &Cells {
        &self.cells
    }

    /// The corridor.
    pub fn corridor(&self) -> &Corridor {
        &self.corridor
    }

    /// Supervises the corridor by the frames of the robot's sensors at one time. Without a pose of the robot, frames
    /// cannot be compared with the model, and every surface in the corridor is an intrusion. The pose is that of the stamp.
    /// A scan that takes time is compared in its middle ([`Frame::at_one_moment`]): cells and intrusions are then in the
    /// frame of the robot at that moment.
    ///
    /// # Errors
    /// [`ErrorKind::Usage`] without a frame and for a frame without ranges; [`ErrorKind::Invalid`] for an invalid
    /// covariance; the errors of [`Predictor::predict`] and [`Frame::deskewed`].
    pub fn supervise(
        &mut self,
        predictor: &mut Predictor,
        world: &World,
        frames: &[&Frame],
        robot: Option<&PoseEstimate>,
    ) -> Result<Report> {
        let start = Instant::now();
        let Some(first) = frames.first() else {
            return Err(Error::usage("supervision without a measurement", "give a frame"));
        };
        if frames.iter().any(|frame| frame.grey().is_some()) {
            return Err(Error::usage("supervision with a grey image", "give a frame of ranges"));
        }
        robot.map_or(Ok(()), |robot| robot.covariance.check().map_err(|e| e.at("the robot's pose")))?;
        let needs_pose = self.corridor.frame() == CorridorFrame::World;
        let seen = match robot {
            None if needs_pose => Vec::new(),
            _ => {
                let each = frames.iter().map(|frame| self.see(predictor, world, frame, robot, start));
                each.collect::<Result<Vec<Seen>>>()?
            }
        };
        let mut report = self.merged(
            first.stamp,
            &seen,
            if seen.is_empty() { UnseenReason::NoPose } else { UnseenReason::Deadline },
        );
        report.is_compared = robot.is_some();
        Ok(report)
    }

    fn time_left(&self, start: Instant) -> Option<Duration> {
        self.options.deadline.map(|deadline| deadline.saturating_sub(start.elapsed()))
    }

    /// The contribution of one sensor.
    fn see(
        &mut self,
        predictor: &mut Predictor,
        world: &World,
        frame: &Frame,
        robot: Option<&PoseEstimate>,
        start: Instant,
    ) -> Result<Seen> {
        let moment = frame.at_one_moment()?;
        let frame = &*moment.frame;
        let robot = robot.map(|robot| moment.robot(robot));
        let robot = robot.as_ref();
        let comparison = match robot {
            Some(robot) => Some(self.compare(predictor, world, frame, robot, start)?),
            None => None,
        };
        let which = self.rays_of(frame);
        let rays = &self.rays[which];
        let mount = frame.sensor().spec().mount;
        let unknown = PoseEstimate::exact(RobotPose::IDENTITY);
        let robot = robot.unwrap_or(&unknown);
        let in_world = self.corridor.frame() == CorridorFrame::World;
        let corridor_from_robot = if in_world { robot.world_from_robot } else { Pose::IDENTITY };
        let pose_deviation = deviation(robot, &mount);
        let readings = Readings::new(rays, frame, comparison.as_ref());
        let search = Search {
            rays,
            frame,
            comparison: comparison.as_ref(),
            world,
            robot,
            corridor: &self.corridor,
            options: &self.options,
            noise: RangeNoise::of(frame.sensor()),
            pose_deviation,
        };
        let sensor_from_corridor = (corridor_from_robot * mount).inverse();
        let uncertainty = if in_world { pose_deviation } else { [0.0; 2] };
        let settings = (self.options.smallest, self.options.is_upright);
        let mut view = SensorView::new(rays, &readings, &self.cells, sensor_from_corridor, uncertainty, settings);
        let (points, in_view) = self.points(&search, &corridor_from_robot);
        let mut seen = self.find(&search, &points, in_view);
        for (k, cell) in self.order.iter().enumerate() {
            if k % CLOCK_INTERVAL == 0 && self.time_left(start).is_some_and(|left| left.is_zero()) {
                break;
            }
            seen.views[*cell as usize] = Some(view.cell(*cell as usize));
        }
        Ok(seen)
    }

    /// Predicts the frame of a sensor, and judges each pixel.
    fn compare(
        &mut self,
        predictor: &mut Predictor,
        world: &World,
        frame: &Frame,
        robot: &PoseEstimate,
        start: Instant,
    ) -> Result<Comparison> {
        let (sensor, surfaces) = (frame.sensor(), &mut self.surfaces);
        let pose = robot.robot().sensor(sensor);
        let mut given_up = Vec::new();
        let expected = match self.options.deadline {
            None => ExpectedImage::predict(predictor, world, surfaces, sensor, &robot.robot())?,
            Some(deadline) => {
                // Half of the time is reserved for the cells.
                let left = deadline.saturating_sub(start.elapsed()).max(Duration::from_micros(2)) / 2;
                let request = Request::of(Outputs::of(&[Output::Range, Output::PolygonId])).with_deadline(left);
                let predicted = match predictor.predict(world, sensor, &pose, &request) {
                    Err(e) if e.kind() == ErrorKind::Deadline => predictor.give_up(world, sensor, &pose, &request)?,
                    predicted => predicted?,
                };
                given_up = predicted.not_predicted();
                ExpectedImage::of_images(predictor, world, surfaces, sensor, &pose, &predicted.images)?
            }
        };
        let model_sigma = self.options.model_sigma;
        let verdicts = predictor.on_threads(|| judge(frame, &expected, robot, model_sigma))?;
        Ok(Comparison { expected, verdicts, given_up })
    }

    /// The index of the rays of a frame's sensor, which are remembered.
    fn rays_of(&mut self, frame: &Frame) -> usize {
        let known = self.rays.iter().position(|rays| rays.sensor.spec() == frame.sensor().spec());
        known.unwrap_or_else(|| {
            // Each scan of points has its own sensor, so the number is limited.
            if self.rays.len() >= MAX_SENSORS {
                self.rays.clear();
            }
            self.rays.push(SensorRays::new(frame.sensor()));
            self.rays.len() - 1
        })
    }

    /// Measured points in the corridor, and the number of pixels whose arbitrary readings lie in it.
    fn points(&self, search: &Search<'_>, corridor_from_robot: &Pose) -> (Vec<CorridorPoint>, f64) {
        let mount = search.rays.sensor.spec().mount;
        let corridor_from_sensor = *corridor_from_robot * mount;
        let mut points = Vec::new();
        for (pixel, z) in search.frame.ranges().iter().enumerate().filter(|(_, z)| z.is_finite()) {
            let in_sensor = f64::from(*z) * search.rays.rays[pixel].as_dvec3();
            let in_corridor = corridor_from_sensor.transform_point(in_sensor);
            let Some(cell) = self.cells.cell_at(in_corridor) else { continue };
            if let Some(along) = self.corridor.arc_length_at(in_corridor.to_array()) {
                points.push(CorridorPoint { pixel, point: mount.transform_point(in_sensor), cell, along });
            }
        }
        (points, self.chances(search.rays, &corridor_from_sensor.inverse()))
    }

    /// Expected number of pixels whose arbitrary readings lie in the corridor: the sum over all cells of the rays
    /// through the cell, times the share of their length in it. Arbitrary readings are uniform between the sensor and
    /// the cell, or over at least a metre.
    fn chances(&self, rays: &SensorRays, sensor_from_corridor: &Pose) -> f64 {
        let (side, height) = (self.cells.side, self.cells.layer_height);
        let each = (0..self.cells.count()).filter_map(|cell| {
            let p = sensor_from_corridor.transform_point(self.cells.middle(cell));
            let r = p.length().max(side);
            let [across, down] = rays.spacing[rays.pixel(rays.project(p)?)?].map(f64::from);
            let on_row = |tangent: f32| (p.z - f64::from(tangent) * p.x.hypot(p.y)).abs() <= 0.5 * height;
            let count = match rays.only_row {
                Some(tangent) if on_row(tangent) => side / (across * r),
                Some(_) => return None,
                None => side * height / (across * down * r * r),
            };
            Some(count * side / r.max(1.0))
        });
        each.filter(|count| count.is_finite()).sum::<f64>().clamp(1.0, rays.rays.len() as f64)
    }

    /// Cells with confirmed surfaces, and intrusions.
    fn find(&self, search: &Search<'_>, points: &[CorridorPoint], in_view: f64) -> Seen {
        let mut known = BTreeMap::new();
        let mut found = QueryResult::default();
        let mut unknown = Vec::new();
        for point in points {
            let verdict = search.comparison.and_then(|c| c.verdict(point.pixel));
            if let (Some(Verdict::Confirmed), Some(c)) = (verdict, search.comparison) {
                known.insert(point.cell, c.expected.pixels[point.pixel].object);
            } else if search.is_unknown(point, &mut found) {
                unknown.push(*point);
            }
        }
        let missing = search.missing_objects();
        let (mut intruded, mut intrusions) = (Vec::new(), Vec::new());
        for (mut intrusion, points) in search.intrusions(&unknown, in_view) {
            intruded.extend(points.iter().map(|p| p.cell));
            intrusion.object = search.same_as(&intrusion, &missing, 2.0 * self.options.smallest);
            intrusions.push(intrusion);
        }
        Seen { views: vec![None; self.cells.count()], known, intruded, intrusions }
    }

    /// One report of all sensors. `otherwise` is the reason for cells that no sensor evaluated.
    fn merged(&self, stamp: f64, seen: &[Seen], otherwise: UnseenReason) -> Report {
        let mut hidden = [0.0; 7];
        let share = 1.0 / self.cells.count().max(1) as f64;
        let mut cells: Vec<CellState> = (0..self.cells.count())
            .map(|cell| {
                let reasons = |of: fn(&CellView) -> Option<UnseenReason>| {
                    let each = seen.iter().map(|s| s.views[cell].map_or(Some(otherwise), |view| of(&view)));
                    best(each).unwrap_or(Some(otherwise))
                };
                if let Some(reason) = reasons(|view| view.hidden) {
                    hidden[reason as usize] += share;
                }
                reasons(|view| view.unseen).map_or(CellState::Free, CellState::Unseen)
            })
            .collect();
        for seen in seen {
            seen.known.iter().for_each(|(cell, object)| cells[*cell] = CellState::Known(*object));
        }
        seen.iter().flat_map(|s| &s.intruded).for_each(|cell| cells[*cell] = CellState::Intruded);
        let is_given_up = seen.iter().any(|s| s.views.iter().any(Option::is_none));
        if self.options.is_upright {
            self.assume_upright(&mut cells);
        }
        let mut intrusions: Vec<_> = seen.iter().flat_map(|s| s.intrusions.iter().cloned()).collect();
        intrusions.sort_by(|a, b| a.along.total_cmp(&b.along));
        let time = |along: f64| if self.options.speed > 0.0 { Some(along / self.options.speed) } else { None };
        let time_to_reach = intrusions.first().and_then(|first| time(first.along));
        let is_upright_assumed = self.options.is_upright;
        Report { stamp, cells, hidden, intrusions, time_to_reach, is_compared: true, is_upright_assumed, is_given_up }
    }

    /// Gives all cells of a column the state of one cell: intruded, else known, else free, else unseen for a reason.
    fn assume_upright(&self, cells: &mut [CellState]) {
        let rank = |cell: &CellState| match cell {
            CellState::Intruded => 0,
            CellState::Known(_) => 1,
            CellState::Free => 2,
            CellState::Unseen(UnseenReason::OutOfView) => 4,
            CellState::Unseen(_) => 3,
        };
        for column in cells.chunks_mut(self.cells.layers) {
            if let Some(first) = column.iter().min_by_key(|cell| rank(cell)).copied() {
                column.fill(first);
            }
        }
    }
}

/// The reason of the sensor with the best view: none, else the first reason other than out of view.
fn best(each: impl Iterator<Item = Option<UnseenReason>>) -> Option<Option<UnseenReason>> {
    each.min_by_key(|reason| match reason {
        None => 0,
        Some(UnseenReason::OutOfView) => 2,
        Some(_) => 1,
    })
}
