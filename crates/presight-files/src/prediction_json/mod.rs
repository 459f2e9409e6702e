//! Predictions of features as JSON, `format = 1`. Numbers that are not finite are null.
//!
//! | key | meaning |
//! |---|---|
//! | `sensor` | name of the sensor |
//! | `world_from_sensor` | x, y, z, qx, qy, qz, qw; body axes |
//! | `pose_covariance` | 36 numbers, row-major, or null |
//! | `confidence` | probability of the regions of interest, or null |
//! | `given_up` | work dropped to meet a deadline, see [`Degradation`]; absent if none was |
//! | `features` | one entry each, see [`presight_features::SeenFeature`] |
//! | `virtual` | the reading of a virtual sensor; absent if none was requested |
//! | `all_features` | only if hidden features are left out: the number of all features |
//!
//! An entry has `id`, `kind`, `name`, `branch` (only for contours: each curve is an entry), `points_world`,
//! `visible_fraction`, `visible` (`t`, `pixels`), `hidden` (`t`, `reason`, `by` with `polygon` and `object`), `range`,
//! `cos_incidence`, `roi`, `roi_flag`, `image_covariance`, `properties` (`strength`, `contrast`, `normal` and
//! `direction` in the world, `family`, `code`, `existence` at the time of the prediction) and `history` (null without a
//! store). `range`, `cos_incidence`, `roi`, `roi_flag` and `image_covariance` are null for an invisible feature;
//! `image_covariance` also if a defining point has no image (behind a camera). `pixels` are both ends of a visible
//! part, and for a contour its polyline. If only the reasons of hidden features are requested, entries without a
//! visible part have only `id`, `kind`, `branch`, `visible_fraction`, `visible` and one `hidden` part, and stand on one
//! line.
//!
//! `virtual` has `name`, `robot_from_sensor` (the sensor's mount: x, y, z, qx, qy, qz, qw) and, by name:
//!
//! - `free-floor` ([`FreeFloor`](presight_predict::virtual_sensors::FreeFloor)): `floor_z_world`, `area`, `pixels`,
//!   `pixels_over_horizon`, `regions` (`area`, `pixels`, `outer_robot`, `holes_robot`: points), `mask` (`runs`: row,
//!   first column, count)
//! - `edges` ([`Edges`](presight_predict::virtual_sensors::Edges)): `edges` (`id`, `name`, `visible_fraction`,
//!   `visible`: `t`, `pixels`, `ends_world`), `segments`
//! - `radar-lines` ([`RadarLines`](presight_predict::virtual_sensors::RadarLines)): `lines` (`ends_robot`, `length`,
//!   `normal_robot`, `distance`, `columns`, `beams`, `polygons`, `objects`), `single_beams`
//! - `radar-nearest` ([`Nearest`](presight_predict::virtual_sensors::Nearest)): `directions` (`azimuth`, `range`,
//!   `object_id`, by column), `nearest` (`point_robot`, `range`, `pixel`, `polygon`, `object`), `corridor` (`length`,
//!   `arc_length`, `first`, `beams`), `complete_to` if work was dropped
//! - `radar-landmarks` ([`Landmarks`](presight_predict::virtual_sensors::Landmarks)): `landmarks` (`id`, `name`,
//!   `kind`, `family`, `code`, `position_robot`, `position_world`, `corners_robot`, `range`, `azimuth`, `elevation`,
//!   `cos_incidence`, `visible_fraction`, `existence`), `known`
//! - `depth-image` ([`DepthImage`](presight_predict::virtual_sensors::DepthImage)): `width`, `height`, `points`,
//!   `bounds_robot`, `points_robot` (row-major, null without a point)
//! - `vertical-planes` ([`VerticalPlanes`](presight_predict::virtual_sensors::VerticalPlanes)): `planes`
//!   (`normal_robot`, `distance`, `centre_robot`, `extent`, `pixels`, `area`, `object`, `pixel_bounds`), `pixels`
//! - `docking` ([`Docking`](presight_predict::virtual_sensors::Docking)): `landmarks` and `known` as above,
//!   `measurements`, `freedom`, `covariance`, `sigmas`, `information`, `unobservable` (`name`, `motion`)
//!
//! Lengths are metres, areas square metres, angles radians.

mod lines;

use glam::{DVec2, DVec3};
use presight_features::{FeaturePrediction, Hidden as HiddenFeatures, HiddenInterval, Reason, SeenFeature};
use presight_features::{VisibleInterval, image_path};
use presight_model::environment::{Environment, FeatureShape};
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::geometry::{InWorld, Pose, PoseCovariance, SensorPose};
use presight_model::sensor::Sensor;
use presight_predict::virtual_sensors::VirtualReading;
use presight_read::atomic::write_atomically;
use presight_render::deadline::Degradation;
use serde::{Deserialize, Serialize};
use serde_json::value::{RawValue, to_raw_value};
use std::borrow::Cow;
use std::io::Write;
use std::path::Path;

/// The version that this build writes.
const FORMAT: u32 = 1;

/// The sensor and its pose, with uncertainty, and how much the file says.
#[derive(Clone, Debug)]
pub struct Header {
    /// The sensor.
    pub sensor: Sensor,
    /// The sensor's pose.
    pub pose: SensorPose,
    /// Covariance of that pose.
    pub pose_covariance: Option<PoseCovariance<InWorld>>,
    /// Probability that a feature lies in its region of interest.
    pub confidence: Option<f64>,
    /// Work dropped to meet a deadline.
    pub given_up: Option<Degradation>,
    /// How features without a visible part are listed: in full, with one reason, or only counted.
    pub hidden: HiddenFeatures,
}

impl Header {
    /// The header for a sensor at a pose, without uncertainty. Hidden features are listed in full.
    pub fn new(sensor: &Sensor, pose: SensorPose) -> Self {
        let (sensor, hidden) = (sensor.clone(), HiddenFeatures::Full);
        Self { sensor, pose, pose_covariance: None, confidence: None, given_up: None, hidden }
    }
}

/// Writes predicted features, and the reading of a virtual sensor if there is one. `environment` names the objects that
/// hide features.
///
/// # Errors
/// [`ErrorKind::System`] if the file cannot be written; no partial file is left.
pub fn write(
    path: &Path,
    header: &Header,
    prediction: &FeaturePrediction,
    environment: &Environment,
    reading: Option<&VirtualReading>,
) -> Result<()> {
    let text = to_string(header, prediction, environment, reading).map_err(|e| e.in_file(path))?;
    write_atomically(path, |file| file.write_all(text.as_bytes()))
}

/// The text of [`write()`].
///
/// # Errors
/// None in practice: every prediction can be written as JSON.
pub fn to_string(
    header: &Header,
    prediction: &FeaturePrediction,
    environment: &Environment,
    reading: Option<&VirtualReading>,
) -> Result<String> {
    let Pose { translation: t, rotation: q } = header.pose.world_from_sensor();
    let mut file = File {
        format: FORMAT,
        sensor: &header.sensor.spec().name,
        world_from_sensor: [t.x, t.y, t.z, q.x, q.y, q.z, q.w],
        pose_covariance: header.pose_covariance.map(|c| c.as_rows().as_flattened().to_vec()),
        confidence: header.confidence,
        given_up: header.given_up.as_ref(),
        all_features: (header.hidden == HiddenFeatures::Count).then_some(prediction.stats.features),
        features: Vec::with_capacity(prediction.features.len()),
        reading,
    };
    let wrong = |e| Error::invalid(format!("the prediction cannot be written as JSON: {e}"), "");
    for seen in &prediction.features {
        file.features.push(match header.hidden {
            hidden if hidden == HiddenFeatures::Full || !seen.visible.is_empty() => {
                Entry::Whole(Box::new(entry(seen, header, environment)))
            }
            HiddenFeatures::Reason => Entry::Line(to_raw_value(&unseen(seen)).map_err(wrong)?),
            _ => continue,
        });
    }
    lines::to_string(&file).map(|text| text + "\n").map_err(wrong)
}

/// The content of a file of predicted features, without the reading of a virtual sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PredictionFile {
    /// Version of the format.
    pub format: u32,
    /// The sensor's name.
    pub sensor: String,
    /// The sensor's pose, body axes.
    pub world_from_sensor: Pose,
    /// 36 numbers, row-major, or none.
    pub pose_covariance: Option<Vec<f64>>,
    /// Probability that a feature lies in its region of interest, if there are regions.
    pub confidence: Option<f64>,
    /// Work dropped to meet a deadline, if any was.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub given_up: Option<Degradation>,
    /// The number of all features, if hidden ones are only counted.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub all_features: Option<usize>,
    /// The predicted features.
    pub features: Vec<FeatureRecord<'static>>,
}

/// Reads the text of [`write()`].
///
/// # Errors
/// [`ErrorKind::Invalid`] for any other text; [`ErrorKind::Unsupported`] for a newer format.
pub fn parse(text: &str) -> Result<PredictionFile> {
    let remedy = "give a file that `prediction_json::write` wrote";
    let file: PredictionFile = serde_json::from_str(text)
        .map_err(|e| Error::invalid(format!("not a prediction of features: {e}"), remedy).caused_by(e))?;
    match file.format {
        FORMAT => Ok(file),
        newer => {
            let what = format!("format {newer} is not the format {FORMAT} of this presight");
            Err(Error::new(ErrorKind::Unsupported, what, "update presight"))
        }
    }
}

#[derive(Serialize)]
struct File<'a> {
    format: u32,
    sensor: &'a str,
    world_from_sensor: [f64; 7],
    pose_covariance: Option<Vec<f64>>,
    confidence: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    given_up: Option<&'a Degradation>,
    #[serde(skip_serializing_if = "Option::is_none")]
    all_features: Option<usize>,
    features: Vec<Entry<'a>>,
    #[serde(rename = "virtual", skip_serializing_if = "Option::is_none")]
    reading: Option<&'a VirtualReading>,
}

/// An entry of the file.
#[derive(Serialize)]
#[serde(untagged)]
enum Entry<'a> {
    /// Every key.
    Whole(Box<FeatureRecord<'a>>),
    /// A feature without a visible part, on one line.
    Line(Box<RawValue>),
}

/// A feature without a visible part, with the reason alone. A [`FeatureRecord`] has the same keys.
#[derive(Serialize)]
struct UnseenRecord<'a> {
    id: u32,
    kind: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    branch: Option<u32>,
    visible_fraction: f64,
    visible: [Visible; 0],
    hidden: [Hidden<'a>; 1],
}

/// A predicted feature, as the file holds it. Entries that give only a reason lack most keys.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the keys of the file, see the module")]
pub struct FeatureRecord<'a> {
    pub id: u32,
    pub kind: Cow<'a, str>,
    pub name: Option<Cow<'a, str>>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub branch: Option<u32>,
    #[serde(default)]
    pub points_world: Vec<[f64; 3]>,
    pub visible_fraction: f64,
    pub visible: Vec<Visible>,
    pub hidden: Vec<Hidden<'a>>,
    pub range: Option<f64>,
    pub cos_incidence: Option<f64>,
    pub roi: Option<[f64; 4]>,
    pub roi_flag: Option<Cow<'a, str>>,
    pub image_covariance: Option<Cow<'a, [[[f64; 2]; 2]]>>,
    pub properties: Option<Properties<'a>>,
    pub history: Option<()>,
}

/// A visible part, as the file holds it; see [`VisibleInterval`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the keys of the file")]
pub struct Visible {
    pub t: [f64; 2],
    pub pixels: Vec<[f64; 2]>,
}

/// A hidden part, as the file holds it; see [`HiddenInterval`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the keys of the file")]
pub struct Hidden<'a> {
    pub t: [f64; 2],
    pub reason: Cow<'a, str>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub by: Option<By<'a>>,
}

/// The occluder: its `polygon_id`, and the path of its object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the keys of the file")]
pub struct By<'a> {
    pub polygon: u32,
    pub object: Cow<'a, str>,
}

/// Properties, as the file holds them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the keys of the file, see the module")]
pub struct Properties<'a> {
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub strength: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub contrast: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub normal: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub direction: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub family: Option<Cow<'a, str>>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub code: Option<u32>,
    pub existence: f64,
}

fn entry<'a>(seen: &'a SeenFeature, header: &Header, environment: &'a Environment) -> FeatureRecord<'a> {
    FeatureRecord {
        id: seen.feature.id,
        kind: seen.feature.shape.kind().into(),
        name: seen.feature.name.as_deref().map(Cow::from),
        branch: seen.branch,
        points_world: seen.points_world.iter().map(DVec3::to_array).collect(),
        visible_fraction: seen.visible_fraction,
        visible: seen.visible.iter().map(|v| visible(v, seen, header)).collect(),
        hidden: seen.hidden.iter().map(|h| hidden(h, environment)).collect(),
        range: seen.range,
        cos_incidence: seen.cos_incidence,
        roi: seen.roi,
        roi_flag: seen.roi_flag.map(|flag| flag.name().into()),
        image_covariance: seen.image_covariance.as_deref().map(Cow::from),
        properties: Some(properties(seen)),
        history: None,
    }
}

/// The entry of a feature without a visible part: of all reasons of its parts the last one, as
/// [`HiddenFeatures::Reason`].
fn unseen(seen: &SeenFeature) -> UnseenRecord<'_> {
    let reason = seen.hidden.iter().map(|h| h.reason).max().unwrap_or(Reason::OutsideImage);
    UnseenRecord {
        id: seen.feature.id,
        kind: seen.feature.shape.kind(),
        branch: seen.branch,
        visible_fraction: seen.visible_fraction,
        visible: [],
        hidden: [Hidden { t: [0.0, 1.0], reason: reason.name().into(), by: None }],
    }
}

fn visible(v: &VisibleInterval, seen: &SeenFeature, header: &Header) -> Visible {
    let pixels = match seen.feature.shape {
        FeatureShape::Contour { .. } => {
            image_path(&header.sensor, &header.pose.world_from_sensor(), &seen.points_world, v)
        }
        _ => v.pixels.to_vec(),
    };
    Visible { t: v.t, pixels: pixels.iter().map(DVec2::to_array).collect() }
}

fn hidden<'a>(h: &HiddenInterval, environment: &'a Environment) -> Hidden<'a> {
    let by = h.by.map(|by| By {
        polygon: by.polygon_id,
        object: environment.objects()[by.object as usize].name.as_str().into(),
    });
    Hidden { t: h.t, reason: h.reason.name().into(), by }
}

fn properties(seen: &SeenFeature) -> Properties<'_> {
    let given = &seen.feature.properties;
    let (family, code) = match &seen.feature.shape {
        FeatureShape::Fiducial { family, code, .. } => (Some(family.as_str()), Some(*code)),
        _ => (None, None),
    };
    let direction = match (&seen.feature.shape, seen.points_world.as_slice()) {
        (FeatureShape::Segment { .. }, [a, b]) => (*b - *a).try_normalize(),
        _ => None,
    };
    Properties {
        strength: given.strength,
        contrast: given.contrast,
        normal: seen.normal_world.map(|n| n.to_array()),
        direction: direction.map(|d| d.to_array()),
        family: family.map(Cow::from),
        code,
        existence: seen.existence,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;
    use presight_features::Reason;
    use presight_model::environment::{Existence, Feature, Properties};
    use presight_read::preset;
    use presight_render::deadline::{DegradationKind, DegradationStep};

    fn seen() -> SeenFeature {
        let ends = [DVec3::ZERO, DVec3::Z * 2.0];
        SeenFeature {
            feature: Feature {
                id: 9,
                name: Some("door".into()),
                object: None,
                shape: FeatureShape::Segment { ends, covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO },
                existence: Existence::default(),
                properties: Properties::default(),
            }
            .into(),
            branch: None,
            points_world: ends.to_vec(),
            normal_world: None,
            visible_fraction: 0.25,
            visible: vec![VisibleInterval { t: [0.0, 0.25], pixels: [DVec2::new(1.0, 2.0), DVec2::new(1.5, 4.0)] }],
            hidden: vec![HiddenInterval { t: [0.25, 1.0], reason: Reason::BehindSensor, by: None }],
            range: Some(f64::NAN),
            cos_incidence: None,
            existence: 0.5,
            roi: None,
            roi_flag: None,
            image_covariance: None,
            windows: Vec::new(),
        }
    }

    #[test]
    fn fields_bear_the_names_that_others_read() {
        let prediction = FeaturePrediction { features: vec![seen()], ..FeaturePrediction::default() };
        let header = Header::new(&preset("video-camera").unwrap(), SensorPose::IDENTITY);
        let text = to_string(&header, &prediction, &Environment::new(), None).unwrap();
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        let keys = |v: &serde_json::Value| v.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
        let mut top = ["format", "sensor", "world_from_sensor", "pose_covariance", "confidence", "features"];
        let mut of_feature = [
            "id",
            "kind",
            "name",
            "points_world",
            "visible_fraction",
            "visible",
            "hidden",
            "range",
            "cos_incidence",
            "roi",
            "roi_flag",
            "image_covariance",
            "properties",
            "history",
        ];
        top.sort_unstable();
        of_feature.sort_unstable();
        let sorted = |mut keys: Vec<String>| {
            keys.sort_unstable();
            keys
        };
        assert_eq!(sorted(keys(&json)), top);
        let feature = &json["features"][0];
        assert_eq!(sorted(keys(feature)), of_feature);
        assert_eq!(feature["range"], serde_json::Value::Null);
        assert_eq!(feature["visible"][0]["pixels"][1][1], 4.0);
        assert_eq!(feature["hidden"][0]["reason"], "behind_sensor");
        assert_eq!(feature["properties"]["direction"][2], 1.0);
        assert_eq!(feature["properties"]["existence"], 0.5);
        let curve = FeaturePrediction {
            features: vec![SeenFeature { branch: Some(2), ..seen() }],
            ..FeaturePrediction::default()
        };
        let text = to_string(&header, &curve, &Environment::new(), None).unwrap();
        assert_eq!(parse(&text).unwrap().features[0].branch, Some(2));
    }

    #[test]
    fn what_is_written_reads_back_and_is_written_the_same() {
        let mut feature = seen();
        feature.image_covariance = Some(vec![[[1.0 / 3.0, 0.0], [0.0, 2.0]]]);
        (feature.roi, feature.roi_flag) = (Some([0.1, 0.2, 3.0, 4.0]), Some(presight_features::roi::RoiFlag::Linear));
        let prediction = FeaturePrediction { features: vec![feature], ..FeaturePrediction::default() };
        let pose = Pose::from_xyz_rpy(DVec3::new(1.0, 2.0, 3.0), 0.1, 0.2, 0.3);
        let taken = DegradationStep { means: DegradationKind::Clock, at_ms: 1.0 / 3.0, metres: Some(2.5) };
        let given_up = Degradation {
            complete_to: 2.5,
            samples: 7,
            stride: 4,
            features: vec![3],
            means: vec![taken],
            opening: None,
        };
        let given_up = Some(given_up);
        let header = Header {
            given_up: given_up.clone(),
            ..Header::new(&preset("video-camera").unwrap(), SensorPose::new(pose))
        };
        let text = to_string(&header, &prediction, &Environment::new(), None).unwrap();
        let read = parse(&text).unwrap();
        assert_eq!(read.given_up, given_up);
        assert_eq!((read.world_from_sensor, read.features[0].range), (pose, None), "NaN is written as null");
        assert_eq!(
            read.features[0],
            FeatureRecord { range: None, ..entry(&prediction.features[0], &header, &Environment::new()) }
        );
        let again = serde_json::to_value(&read).unwrap();
        assert_eq!(again, serde_json::from_str::<serde_json::Value>(&text).unwrap());
        assert_eq!(parse(&text.replace("\"format\": 1", "\"format\": 9")).unwrap_err().kind(), ErrorKind::Unsupported);
        assert!(parse("[]").is_err());
    }
}
