//! Sensors: image geometry, range limits, class and mount.

mod beams;
mod bundles;
mod camera;
mod cone_tree;
mod direction_map;
mod directory;
mod distortion;
mod grid;
mod noise;
mod part;
mod pixel_fit;
mod polynomial;
mod presets;
mod project;
mod ray_grid;
mod ray_tiles;
mod rays;
mod scanner;
mod times;
mod undistort;

pub use beams::BeamTable;
pub use bundles::Bundles;
pub use camera::Camera;
pub use cone_tree::ConeTree;
pub use direction_map::DirectionMap;
pub use direction_map::{Cells as MapCells, PixelBox};
pub use distortion::Distortion;
pub use grid::Octet;
pub use grid::{LineAxis, LineGrid, PixelGrid};
pub use noise::{Mixture, Noise};
pub use part::{ImagePart, STRIDES};
pub use pixel_fit::{FitCell, on_side};
pub use presets::{PRESETS, Preset};
pub use ray_grid::{Cones, ForwardView, Sides, TILE_SIDE, TileLookup, TileRays};
pub use ray_grid::{RayGrid, Tile};
pub use ray_tiles::{GROUP, GROUPS, GroupLayout, RayTile, RayTiles};
pub use rays::{MAX_ORIGIN, RayTable};
pub use scanner::{Angles, SAME_ANGLE, Scanner};
pub use times::{RayTimes, StampAt};
pub use undistort::Lens;

use crate::error::{Error, ErrorKind, Result};
use crate::geometry::Pose;
use crate::limits;
use crate::memory;
use directory::Directory;
use glam::{DMat3, DQuat, DVec3};
use part::Thinned;
use project::Projector;
use std::sync::{Arc, OnceLock};

/// The image geometry of a sensor.
#[derive(Clone, Debug, PartialEq)]
pub enum Geometry {
    /// Planar image, with or without lens distortion.
    Camera(Camera),
    /// Spherical (equiangular) image: azimuth by elevation.
    Scanner(Scanner),
    /// Any set of rays, from one centre or each from its own point.
    Rays(RayTable),
}

/// The specification of a [`Sensor`].
///
/// ```
/// use presight::sensor::{Camera, Geometry, Noise, SensorSpec};
/// use presight::Pose;
/// let camera = Geometry::Camera(Camera::pinhole(640, 480, 525.0, 525.0, 319.5, 239.5));
/// let spec = SensorSpec::new("kinect", "video", camera)
///     .with_limits(0.5, 4.5)
///     .with_mount(Pose::from_xyz_rpy(glam::DVec3::new(0.1, 0.0, 0.9), 0.0, 0.2, 0.0))
///     .with_noise(Noise { range_sigma: 0.01, ..Noise::default() });
/// assert_eq!((spec.range_min, spec.range_max), (0.5, 4.5));
/// ```
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct SensorSpec {
    /// A free name, for messages and files.
    pub name: String,
    /// Sensor class, as materials and feature layers name it (`video`, `radar`, `laser`, ...).
    pub class: String,
    /// Image geometry.
    pub geometry: Geometry,
    /// Metres, inclusive. A nearer surface is not measured but still occludes.
    pub range_min: f64,
    /// Metres, inclusive; may be infinite.
    pub range_max: f64,
    /// Maximum angle of incidence, radians from the normal, at which the sensor extracts features. Images are not
    /// affected.
    pub max_incidence: Option<f64>,
    /// robot_from_sensor, body axes.
    pub mount: Pose,
    /// Cameras: rotation from the frame of the image (z along its optical axis, x right, y down) to the optical frame
    /// of the camera, which is that of poses and of `mount`. The identity but for rectified images, where it is the
    /// inverse of ROS's R. Other sensors do not use it.
    pub optical_from_image: DQuat,
    /// Measurement noise.
    pub noise: Noise,
    /// When each ray is measured.
    pub times: RayTimes,
}

impl SensorSpec {
    /// A sensor without range limits, mounted at the robot's origin.
    pub fn new(name: impl Into<String>, class: impl Into<String>, geometry: Geometry) -> Self {
        Self {
            name: name.into(),
            class: class.into(),
            geometry,
            range_min: 0.0,
            range_max: f64::INFINITY,
            max_incidence: None,
            mount: Pose::IDENTITY,
            optical_from_image: DQuat::IDENTITY,
            noise: Noise::default(),
            times: RayTimes::AtOnce,
        }
    }

    /// With another name.
    #[must_use]
    pub fn with_name(self, name: impl Into<String>) -> Self {
        Self { name: name.into(), ..self }
    }

    /// With another sensor class.
    #[must_use]
    pub fn with_class(self, class: impl Into<String>) -> Self {
        Self { class: class.into(), ..self }
    }

    /// With another image geometry.
    #[must_use]
    pub fn with_geometry(self, geometry: Geometry) -> Self {
        Self { geometry, ..self }
    }

    /// With other range limits, metres, inclusive; `range_max` may be infinite.
    #[must_use]
    pub fn with_limits(self, range_min: f64, range_max: f64) -> Self {
        Self { range_min, range_max, ..self }
    }

    /// With a largest angle of incidence at which features are extracted, radians from the normal.
    #[must_use]
    pub fn with_max_incidence(self, max_incidence: f64) -> Self {
        Self { max_incidence: Some(max_incidence), ..self }
    }

    /// With another mount: robot_from_sensor, body axes.
    #[must_use]
    pub fn with_mount(self, mount: Pose) -> Self {
        Self { mount, ..self }
    }

    /// The frame of a camera's image, turned from body axes: see [`Sensor::body_from_image`].
    pub fn body_from_image(&self) -> DMat3 {
        match self.geometry {
            Geometry::Camera(_) if self.optical_from_image == DQuat::IDENTITY => body_from_optical(),
            Geometry::Camera(_) => body_from_optical() * DMat3::from_quat(self.optical_from_image),
            _ => DMat3::IDENTITY,
        }
    }

    /// With other times of its rays.
    #[must_use]
    pub fn with_times(self, times: RayTimes) -> Self {
        Self { times, ..self }
    }

    /// With other noise.
    #[must_use]
    pub fn with_noise(self, noise: Noise) -> Self {
        Self { noise, ..self }
    }
}

/// A checked sensor with its ray tables, cheap to clone.
///
/// ```
/// use presight::sensor::{Camera, Geometry, SensorSpec};
/// use presight::Sensor;
/// let camera = Camera::pinhole(640, 480, 525.0, 525.0, 319.5, 239.5);
/// let sensor = Sensor::new(SensorSpec::new("kinect", "video", Geometry::Camera(camera)))?;
/// assert_eq!((sensor.width(), sensor.height()), (640, 480));
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Sensor(Arc<SensorData>);

#[derive(Debug)]
struct SensorData {
    spec: SensorSpec,
    grid: PixelGrid,
    projector: Projector,
    width: u32,
    height: u32,
    /// Set if this sensor is a part of another one.
    part: Option<ImagePart>,
    thinned: Thinned,
    /// Only for ray tables; built on first use.
    directory: OnceLock<Directory>,
    /// Built on first use.
    tiles: OnceLock<RayTiles>,
    /// Of a sensor that stands, and of one that moves; built on first use.
    bundles: [OnceLock<Bundles>; 2],
}

impl Sensor {
    /// Checks the specification and builds the ray tables, f64. A scanner whose last beam is one turn on from the first
    /// within [`SAME_ANGLE`] gets a step, or a last angle, that leads there exactly.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`]: an image side of 0 or beyond [`limits::MAX_IMAGE_SIDE`], non-finite
    /// intrinsics, duplicate elevations, range limits out of order; [`ErrorKind::System`] if there is no memory for the
    /// ray tables.
    pub fn new(mut spec: SensorSpec) -> Result<Self> {
        if let Geometry::Scanner(scanner) = spec.geometry {
            spec.geometry = Geometry::Scanner(Scanner { azimuth: scanner.azimuth.closed(), ..scanner });
        }
        let checked = check(&spec).and_then(|()| {
            memory::require(ray_table_bytes(&spec))?;
            Ok(match &spec.geometry {
                Geometry::Camera(c) => c.grid()?,
                Geometry::Scanner(s) => s.grid()?,
                Geometry::Rays(r) => PixelGrid::Rays(RayGrid::new(r.width(), r.height(), r.directions())?),
            })
        });
        let grid = checked.map_err(|e| e.at(format!("sensor {:?}", spec.name)))?;
        let (width, height) = spec.geometry.size();
        let projector = Projector::new(&spec);
        let (part, thinned, directory, tiles) = (None, Thinned::default(), OnceLock::new(), OnceLock::new());
        let bundles = Default::default();
        let data = SensorData { spec, grid, projector, width, height, part, thinned, directory, tiles, bundles };
        Ok(Self(Arc::new(data)))
    }

    /// The specification from which the sensor was made.
    pub fn spec(&self) -> &SensorSpec {
        &self.0.spec
    }

    pub(self) fn projector(&self) -> &Projector {
        &self.0.projector
    }

    /// Image columns.
    pub fn width(&self) -> u32 {
        self.0.width
    }

    /// Image columns without the last one of a scanner that goes fully round and ends with the direction of its first.
    /// Both columns show that direction, and a measurement counts only in the first.
    pub fn distinct_columns(&self) -> u32 {
        match self.grid() {
            PixelGrid::Lines(grid) if grid.axis() == LineAxis::Columns && self.0.width > 1 => {
                self.0.width - u32::from(grid.lines()[0] == grid.lines()[self.0.width as usize - 1])
            }
            _ => self.0.width,
        }
    }

    /// Image rows.
    pub fn height(&self) -> u32 {
        self.0.height
    }

    /// True for cameras: their images have a planar `depth_z`.
    #[inline]
    pub fn is_camera(&self) -> bool {
        matches!(self.0.spec.geometry, Geometry::Camera(_))
    }

    /// The rays as engines use them.
    #[doc(hidden)]
    pub fn grid(&self) -> &PixelGrid {
        &self.0.grid
    }

    /// body_from_image: turns the image frame into body axes (x forward, y left, z up). The image frame is the optical
    /// frame of a camera (z forward, x right, y down), turned by [`SensorSpec::optical_from_image`], and the body axes
    /// of other sensors.
    #[inline]
    pub fn body_from_image(&self) -> DMat3 {
        self.spec().body_from_image()
    }

    /// Unit ray of a pixel in the image frame, f64; `None` where the sensor has no ray, and outside the image.
    #[inline]
    pub fn ray(&self, column: u32, row: u32) -> Option<DVec3> {
        let inside = column < self.0.width && row < self.0.height;
        inside.then(|| self.0.grid.ray(column, row)).flatten()
    }

    /// True if the rays of a table have origins of their own: see [`RayTable::with_origins`].
    pub fn has_origins(&self) -> bool {
        matches!(&self.0.spec.geometry, Geometry::Rays(table) if table.origins().is_some())
    }

    /// The point from which the range of a pixel is measured: metres from the sensor's own origin, body axes.
    #[inline]
    pub fn origin(&self, column: u32, row: u32) -> DVec3 {
        self.of_table(RayTable::origins, column, row)
    }

    /// The point at which the ray of a pixel leaves the sensor, [`RayTable::range_lead`] ahead of [`Sensor::origin`]:
    /// metres from the sensor's own origin, body axes, with the same bits for all rays that share the point.
    #[inline]
    pub fn start(&self, column: u32, row: u32) -> DVec3 {
        self.of_table(RayTable::starts, column, row)
    }

    /// Metres along each ray from [`Sensor::origin`] to [`Sensor::start`].
    #[inline]
    pub fn range_lead(&self) -> f64 {
        match &self.0.spec.geometry {
            Geometry::Rays(table) => table.range_lead(),
            _ => 0.0,
        }
    }

    #[inline]
    fn of_table(&self, points: impl Fn(&RayTable) -> Option<&[DVec3]>, column: u32, row: u32) -> DVec3 {
        match &self.0.spec.geometry {
            Geometry::Rays(table) => points(table).map_or(DVec3::ZERO, |points| {
                let (column, row) = (self.whole_column(column), row * self.part_stride());
                points[row as usize * table.width() as usize + column as usize]
            }),
            _ => DVec3::ZERO,
        }
    }

    /// Seconds from the stamp of a frame to when the ray of a pixel is measured.
    pub fn seconds_after_stamp(&self, column: u32, row: u32) -> f64 {
        let (column, row) = (self.whole_column(column), row * self.part_stride());
        self.spec().times.seconds(column, row, self.spec().geometry.size())
    }

    /// Seconds from the stamp of a frame to its earliest ray and to its latest.
    pub fn scan_interval(&self) -> [f64; 2] {
        self.spec().times.interval(self.spec().geometry.size())
    }

    /// The rays in bundles of one origin, and of one time too if the sensor moves; built on the first call.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if there is no memory for them.
    #[doc(hidden)]
    pub fn bundles(&self, moves: bool) -> Result<&Bundles> {
        let slot = &self.0.bundles[usize::from(moves)];
        if slot.get().is_none() {
            let _ = slot.set(Bundles::new(self, moves)?);
        }
        Ok(slot.get().expect("they were set"))
    }

    /// Arrangement of rays in tiles, without building any.
    #[doc(hidden)]
    pub fn ray_layout(&self) -> GroupLayout {
        RayTiles::layout_of(self).0
    }

    /// The rays in compact tiles; built on the first call.
    ///
    /// # Errors
    /// [`ErrorKind::System`] if there is no memory for them.
    #[doc(hidden)]
    pub fn ray_tiles(&self) -> Result<&RayTiles> {
        if self.0.tiles.get().is_none() {
            let _ = self.0.tiles.set(RayTiles::new(self)?);
        }
        Ok(self.0.tiles.get().expect("they were set"))
    }

    /// A pixel of a ray table whose ray is nearer to a unit direction (image frame) than its neighbours' rays are.
    /// `None` for other sensors. Much faster than [`Sensor::project`], which finds the nearest of all rays.
    pub(crate) fn near_pixel(&self, direction: DVec3) -> Option<(u32, u32)> {
        let PixelGrid::Rays(table) = self.grid() else { return None };
        self.0.directory.get_or_init(|| Directory::of(table)).near(table, direction)
    }
}

/// The rotation from optical to body axes (REP-103).
pub fn body_from_optical() -> DMat3 {
    DMat3::from_cols(-DVec3::Y, -DVec3::Z, DVec3::X)
}

/// [`body_from_optical`] as a quaternion.
pub fn body_from_optical_rotation() -> DQuat {
    DQuat::from_mat3(&body_from_optical())
}

impl Geometry {
    /// Columns and rows.
    pub fn size(&self) -> (u32, u32) {
        match self {
            Self::Camera(c) => (c.width, c.height),
            Self::Scanner(s) => (s.azimuth.len() as u32, s.elevation.len() as u32),
            Self::Rays(r) => (r.width(), r.height()),
        }
    }
}

/// Bytes that the ray table of a sensor takes, if it needs one.
fn ray_table_bytes(spec: &SensorSpec) -> u64 {
    let (width, height) = spec.geometry.size();
    // A lens's directions are computed into a list first.
    let listed = u64::from(width) * u64::from(height) * size_of::<DVec3>() as u64;
    match &spec.geometry {
        Geometry::Camera(c) if !c.distortion.is_none() => listed + RayGrid::bytes_for(width, height),
        Geometry::Rays(_) => RayGrid::bytes_for(width, height),
        Geometry::Camera(_) | Geometry::Scanner(_) => 0,
    }
}

fn check(spec: &SensorSpec) -> Result<()> {
    let (width, height) = spec.geometry.size();
    let side = 1..=limits::MAX_IMAGE_SIDE;
    let pixels = u64::from(width) * u64::from(height);
    // A list of rays, as no image shows them.
    if matches!(spec.geometry, Geometry::Rays(_)) && height == 1 && width > limits::MAX_IMAGE_SIDE {
        if width > limits::MAX_LISTED_RAYS {
            let remedy = format!("give at most {} rays, or several rows of them", limits::MAX_LISTED_RAYS);
            return Err(Error::invalid(format!("a row of {width} rays"), remedy));
        }
    } else if !side.contains(&width) || !side.contains(&height) || pixels > limits::MAX_PIXELS {
        return Err(Error::invalid(
            format!("image of {width} x {height} pixels"),
            format!("give sides of 1 to {} and at most {} pixels", limits::MAX_IMAGE_SIDE, limits::MAX_PIXELS),
        ));
    }
    let limits_sound = spec.range_min >= 0.0 && spec.range_min.is_finite() && spec.range_max > spec.range_min;
    if !limits_sound {
        return Err(Error::invalid(
            format!("range limits {}..{}", spec.range_min, spec.range_max),
            "give 0 <= range_min < range_max, in metres",
        ));
    }
    spec.mount.check_as(ErrorKind::Invalid).map_err(|e| e.at("mount"))?;
    let image = Pose { rotation: spec.optical_from_image, translation: DVec3::ZERO };
    image.check_as(ErrorKind::Invalid).map_err(|e| e.at("optical_from_image"))?;
    if let Some(angle) = spec.max_incidence
        && !(angle > 0.0 && angle <= std::f64::consts::FRAC_PI_2)
    {
        return Err(Error::invalid(
            format!("max_incidence of {} deg", angle.to_degrees()),
            "give more than 0 and at most 90 degrees",
        ));
    }
    spec.times.check(spec.geometry.size())?;
    spec.noise.check()
}
