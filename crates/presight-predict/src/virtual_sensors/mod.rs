//! Virtual sensors: a sensor used for one task (the paper's Table 1).
//!
//! | name | sensor class | delivers | in the paper's Table 1 |
//! |---|---|---|---|
//! | `free-floor` | `video` | [`FreeFloor`]: visible free floor, as a mask and as polygons | free floor space |
//! | `edges` | `video` | [`Edges`]: visible segments of the layer | localization: edges |
//! | `radar-lines` | `radar` | [`RadarLines`]: line segments in the scan plane | localization: line segments |
//! | `radar-nearest` | `radar` | [`Nearest`]: nearest obstacle by direction and in a corridor | closest obstacle |
//! | `radar-landmarks` | `radar` | [`Landmarks`]: positions of visible artificial landmarks | surveying: landmarks |
//! | `depth-image` | `laser` | [`DepthImage`]: a point for every pixel | 3D-depth image |
//! | `vertical-planes` | `laser` | [`VerticalPlanes`]: connected regions of vertical planes | localization: planes |
//! | `docking` | `laser` | [`Docking`]: visible landmarks, and how well they fix the pose | docking: landmarks |
//!
//! Each virtual sensor states its request ([`VirtualSensor::class`], [`VirtualSensor::outputs`], and the feature filter
//! [`VirtualSensor::wants`]). Its pure function [`VirtualSensor::reduce`] takes a view, which is a prediction or a
//! measured image. Names that end in `_robot` are in the robot's frame (x forward, y left, z up), which the sensor's
//! mount defines. Names that end in `_world` are in the world frame. Units are metres, radians and square metres.
//! Unknown values are `null` in files.

mod corridor;
mod depth_image;
mod docking;
mod edges;
mod free_floor;
mod landmarks;
mod mask;
mod pixels;
mod radar_lines;
mod radar_nearest;
mod vertical_planes;
mod view;

pub use corridor::{Corridor, CorridorFrame};
pub use depth_image::DepthImage;
pub use docking::{Docking, Unobservable};
pub use edges::{Edge, EdgePiece, Edges};
pub use free_floor::{FLOOR_HEIGHT, FloorRegion, FreeFloor};
pub use landmarks::{Landmark, Landmarks};
pub use mask::{Mask, MaskRegion};
pub use pixels::{COPLANAR, TILT};
pub use radar_lines::{RadarLine, RadarLines};
pub use radar_nearest::{Directions, InCorridor, Nearest, NearestPoint};
pub use vertical_planes::{VerticalPlane, VerticalPlanes};
pub use view::{View, ViewIds};

use presight_model::environment::FeatureShape;
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::printable::did_you_mean;
use presight_model::sensor::{Geometry, Scanner, Sensor};
use presight_render::plan::{Output, Outputs};
use serde::Serialize;

presight_model::words! {
    /// The virtual sensors.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
    pub enum VirtualSensor {
        /// Visible free floor, for a camera.
        FreeFloor = "free-floor",
        /// Visible segments, for a camera.
        Edges = "edges",
        /// Line segments in the scan plane, for a radar.
        RadarLines = "radar-lines",
        /// The nearest obstacle, for a radar.
        RadarNearest = "radar-nearest",
        /// Visible artificial landmarks, for a radar.
        RadarLandmarks = "radar-landmarks",
        /// A point for every pixel, for a laser.
        DepthImage = "depth-image",
        /// Regions of vertical planes, for a laser.
        VerticalPlanes = "vertical-planes",
        /// Landmarks of a dock and the resulting pose covariance, for a laser.
        Docking = "docking",
    }
}

/// Settings of a virtual sensor.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Settings {
    /// For `free-floor`: height of the floor in the world, metres. `None` means the height of the robot's origin.
    pub floor_z_world: Option<f64>,
    /// For `radar-nearest`: the robot's planned path.
    pub corridor: Option<Corridor>,
}

/// The reading of a virtual sensor. Its serialized form has the keys of the guide to virtual sensors.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VirtualReading {
    /// [`VirtualSensor::name`].
    pub name: &'static str,
    /// The sensor's mount, x, y, z, qx, qy, qz, qw; body axes.
    pub robot_from_sensor: [f64; 7],
    /// The result.
    #[doc(hidden)]
    #[serde(flatten)]
    pub answer: Answer,
}

/// The results of the virtual sensors.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
#[expect(missing_docs, reason = "each is its type")]
pub enum Answer {
    FreeFloor(FreeFloor),
    Edges(Edges),
    RadarLines(RadarLines),
    RadarNearest(Nearest),
    RadarLandmarks(Landmarks),
    DepthImage(DepthImage),
    VerticalPlanes(VerticalPlanes),
    Docking(Docking),
}

impl VirtualSensor {
    /// The sensor class that it needs.
    pub fn class(self) -> &'static str {
        match self {
            Self::FreeFloor | Self::Edges => "video",
            Self::RadarLines | Self::RadarNearest | Self::RadarLandmarks => "radar",
            Self::DepthImage | Self::VerticalPlanes | Self::Docking => "laser",
        }
    }

    /// The images that it needs.
    pub fn outputs(self) -> Outputs {
        match self {
            Self::Edges | Self::RadarLandmarks | Self::Docking => Outputs::of(&[]),
            Self::DepthImage => Outputs::of(&[Output::Range]),
            Self::FreeFloor | Self::RadarLines | Self::RadarNearest | Self::VerticalPlanes => {
                Outputs::of(&[Output::Range, Output::PolygonId, Output::ObjectId])
            }
        }
    }

    /// Returns true if the virtual sensor uses features of this shape. Other features need not be predicted.
    pub fn wants(self, shape: &FeatureShape) -> bool {
        match self {
            Self::Edges => matches!(shape, FeatureShape::Segment { .. }),
            Self::RadarLandmarks | Self::Docking => {
                matches!(shape, FeatureShape::Reflector { .. } | FeatureShape::Fiducial { .. })
            }
            _ => false,
        }
    }

    /// Returns true if it needs predicted features.
    pub fn needs_features(self) -> bool {
        matches!(self, Self::Edges | Self::RadarLandmarks | Self::Docking)
    }

    /// Checks that the virtual sensor can use a sensor, before anything is predicted.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for the wrong sensor class, an unsuitable geometry, or missing noise.
    pub fn check(self, sensor: &Sensor) -> Result<()> {
        let (spec, name) = (sensor.spec(), self.name());
        let preset = match self {
            Self::FreeFloor | Self::Edges => "video-camera",
            Self::RadarLines | Self::RadarNearest | Self::RadarLandmarks => "microwave-radar-scan",
            Self::DepthImage | Self::VerticalPlanes => "laser-range-camera",
            Self::Docking => "laser-scanner",
        };
        let wrong =
            |what: String, remedy: String| Err(Error::usage(format!("{name}: sensor {:?} {what}", spec.name), remedy));
        if spec.class != self.class() {
            let wanted = self.class();
            let remedy =
                format!("take one of class {wanted:?}, such as {preset}, or write class = {wanted:?} in its file");
            return wrong(format!("is of class {:?}", spec.class), remedy);
        }
        if sensor.has_origins() {
            return wrong("has rays that start at several points".into(), "take one whose rays have one origin".into());
        }
        let scanner = match &spec.geometry {
            Geometry::Scanner(scanner) => Some(scanner),
            _ => None,
        };
        match self {
            Self::FreeFloor if !sensor.is_camera() => wrong("is not a camera".into(), format!("take {preset}")),
            Self::RadarLines if scanner.and_then(scan_row).is_none() => {
                wrong("has no beams at elevation 0, which scan a plane".into(), format!("take {preset}"))
            }
            Self::RadarNearest if scanner.is_none() => {
                wrong("is not a scanner: its columns are not directions".into(), format!("take {preset}"))
            }
            Self::Docking => docking::check_noise(sensor),
            _ => Ok(()),
        }
    }

    /// Computes its reading from a view. This is a pure function.
    ///
    /// ```
    /// use presight::virtual_sensors::{Settings, View, VirtualSensor};
    /// use presight_predict::virtual_sensors::Answer;
    /// use presight::environment::Environment;
    /// use presight::{Options, Pose, Predictor, Request, SensorPose, World};
    /// use glam::DVec3;
    /// // A wall 2 m ahead of a radar, 4 m wide.
    /// let mut environment = Environment::new();
    /// let centre = Pose::from_xyz_rpy(DVec3::new(2.05, 0.0, 0.0), 0.0, 0.0, 0.0);
    /// environment.add_cuboid("wall", centre, DVec3::new(0.1, 4.0, 2.0))?;
    /// let world = World::new(environment);
    ///
    /// let (radar, task) = (presight::preset("microwave-radar-scan")?, VirtualSensor::RadarLines);
    /// let mut predictor = Predictor::new(Options::default())?;
    /// let prediction = predictor.predict(&world, &radar, &SensorPose::IDENTITY, &Request::of(task.outputs()))?;
    /// let reading = task.reduce(&View::of(&prediction, world.environment()), &Settings::default())?;
    /// let Answer::RadarLines(found) = &reading.answer else { unreachable!() };
    /// // The line ends at the hits of the outermost beams, 0.1 degrees apart.
    /// assert!(found.lines.len() == 1 && (found.lines[0].length - 4.0).abs() < 0.02);
    /// assert_eq!(found.lines[0].objects, ["wall"]);
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// The errors of [`VirtualSensor::check`] and [`Pose::check`]; [`presight_model::ErrorKind::Usage`] if features are
    /// needed but were not predicted; [`presight_model::ErrorKind::Invalid`] if an image is missing or has a wrong
    /// size, or if the task needs ids that the view lacks (`free-floor`, `radar-lines`, `vertical-planes`).
    pub fn reduce(self, view: &View<'_>, settings: &Settings) -> Result<VirtualReading> {
        view.pose.world_from_sensor().check()?;
        self.check(view.sensor)?;
        if view.moves {
            let remedy = "predict without a motion, or put the points to one moment first (Frame::deskewed)";
            return Err(Error::usage(format!("{} of a sensor that moves while it measures", self.name()), remedy));
        }
        let features = || {
            let class = self.class();
            view.features.ok_or_else(|| {
                let remedy =
                    format!("give `View::features` of a layer of class {class:?} (presight features generates one)");
                Error::usage(format!("{} needs features, and none were predicted", self.name()), remedy)
            })
        };
        let answer = match self {
            Self::FreeFloor => Answer::FreeFloor(free_floor::reduce(view, settings)?),
            Self::Edges => Answer::Edges(edges::reduce(features()?)),
            Self::RadarLines => Answer::RadarLines(radar_lines::reduce(view)?),
            Self::RadarNearest => Answer::RadarNearest(radar_nearest::reduce(view, settings.corridor.as_ref())?),
            Self::RadarLandmarks => Answer::RadarLandmarks(landmarks::reduce(view, features()?)),
            Self::DepthImage => Answer::DepthImage(depth_image::reduce(view)?),
            Self::VerticalPlanes => Answer::VerticalPlanes(vertical_planes::reduce(view)?),
            Self::Docking => Answer::Docking(docking::reduce(view, features()?)?),
        };
        let Pose { translation: t, rotation: q } = view.sensor.spec().mount;
        Ok(VirtualReading { name: self.name(), robot_from_sensor: [t.x, t.y, t.z, q.x, q.y, q.z, q.w], answer })
    }
}

impl std::str::FromStr for VirtualSensor {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|v| v.name() == name).ok_or_else(|| {
            let names = Self::ALL.map(Self::name);
            let remedy = format!("{}choose from {}", did_you_mean(name, names), names.join(", "));
            Error::usage(format!("unknown virtual sensor {name:?}"), remedy)
        })
    }
}

/// The row of a scanner at elevation 0, whose beams scan the sensor's x-y plane.
fn scan_row(scanner: &Scanner) -> Option<u32> {
    let at = scanner.rows_deg().iter().position(|elevation| elevation.abs() < 1e-9)?;
    Some(at as u32)
}

impl VirtualReading {
    /// A one-line summary for people.
    pub fn summary(&self) -> String {
        let summary = match &self.answer {
            Answer::FreeFloor(a) => a.summary(),
            Answer::Edges(a) => a.summary(),
            Answer::RadarLines(a) => a.summary(),
            Answer::RadarNearest(a) => a.summary(),
            Answer::RadarLandmarks(a) => a.summary(),
            Answer::DepthImage(a) => a.summary(),
            Answer::VerticalPlanes(a) => a.summary(),
            Answer::Docking(a) => a.summary(),
        };
        format!("{}: {summary}", self.name)
    }

    /// The pixels marked in the image, if this virtual sensor marks pixels.
    pub fn mask(&self) -> Option<&Mask> {
        match &self.answer {
            Answer::FreeFloor(floor) => Some(&floor.mask),
            _ => None,
        }
    }
}
