//! Features in a prediction: reads layers, requests their visibility, and writes the results.

use super::predict::Shown;
use super::print;
use clap::ValueEnum;
use presight::features::{BoxOptions, FeatureOptions, FeaturePrediction, FeatureSource, Hidden};
use presight::files::{self, PredictionHeader};
use presight::sensor::ExternalPose;
use presight::virtual_sensors::VirtualSensor;
use presight::{
    Error, InWorld, Output, Outputs, PoseCovariance, Prediction, Request, Result, Scene, SceneFeatures, Sensor,
    SensorPose,
};
use std::path::{Path, PathBuf};

/// Flags of features.
#[derive(Debug, clap::Args)]
pub struct LayerArgs {
    /// Add the features of this layer to the scene's features; a later feature replaces one with the same id
    #[arg(long = "layer", value_name = "FILE.json")]
    layers: Vec<PathBuf>,

    /// Write the visible parts of the features
    #[arg(long, value_name = "OUT.json")]
    pub features: Option<PathBuf>,

    /// Entries of the features file for features without a visible part [default: full; with --poses reason]
    #[arg(long, value_enum, requires = "features", value_name = "HOW")]
    hidden: Option<HiddenArg>,

    /// Keep only the N visible features that determine the sensor's pose best
    ///
    /// Each step adds the feature with the largest gain in pose information, weighted by existence and contrast.
    #[arg(long, value_name = "N")]
    max_features: Option<usize>,

    /// UTC seconds at which features' probabilities of existence are evaluated [default: the newest confirmation]
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    time: Option<f64>,

    /// Pose uncertainty for regions of interest: sx,sy,sz,sroll_deg,spitch_deg,syaw_deg, or a file of 36 numbers
    ///
    /// Standard deviations, or a covariance as a row-major JSON list in metres and radians, along the world's axes.
    #[arg(long, value_name = "S|FILE.json")]
    pose_cov: Option<String>,

    /// Probability that a feature is inside its region of interest [default: 0.99]
    #[arg(long, value_name = "P")]
    confidence: Option<f64>,

    /// Label features with their numbers in the preview
    #[arg(long)]
    feature_numbers: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum HiddenArg {
    /// Only the number of all features
    Count,
    /// One line each, with the reason
    Reason,
    /// All keys, with each hidden part and its reason
    Full,
}

/// The requests on the command line that features depend on.
#[derive(Clone, Copy, Debug)]
pub struct NamedRequest {
    /// All requested images.
    pub outputs: Outputs,
    /// The virtual sensor.
    pub virtual_sensor: Option<VirtualSensor>,
    /// True if a preview is drawn, which shows regions of interest.
    pub preview: bool,
    /// True if there is a file of poses.
    pub many_poses: bool,
}

impl NamedRequest {
    fn feature_id(self) -> bool {
        self.outputs.has(Output::FeatureId)
    }

    fn by_virtual_sensor(self) -> bool {
        self.virtual_sensor.is_some_and(VirtualSensor::needs_features)
    }
}

/// The features of a prediction.
pub struct Layers {
    options: FeatureOptions,
    /// Covariance of the poses in the frame in which they are given.
    covariance: PoseCovariance<InWorld>,
    boxes: BoxOptions,
    /// True if regions of interest are predicted.
    boxed: bool,
}

impl LayerArgs {
    /// Checks the flags without opening any file.
    pub fn check(&self, asked: NamedRequest) -> Result<()> {
        if let Some(time) = self.time.filter(|t| !t.is_finite()) {
            return Err(Error::usage(format!("--time {time}"), "give finite UTC seconds"));
        }
        if let Some(confidence) = self.confidence.filter(|p| !(0.5..1.0).contains(p)) {
            let what = format!("--confidence {confidence}");
            return Err(Error::usage(what, "give a probability from 0.5 to below 1"));
        }
        let of_features = [
            ("time", self.time.is_some()),
            ("pose-cov", self.pose_cov.is_some()),
            ("confidence", self.confidence.is_some()),
            ("feature-numbers", self.feature_numbers),
        ];
        match of_features.iter().find(|(_, given)| *given && !self.is_asked(asked)) {
            None => Ok(()),
            Some((flag, _)) => {
                let what = format!("--{flag} needs features, and none are requested");
                Err(Error::usage(what, "give a --layer, or --features OUT.json for the scene's own"))
            }
        }
    }

    /// The input files named on the command line.
    pub fn inputs(&self) -> impl Iterator<Item = &Path> {
        let covariance = self.pose_cov.as_deref().and_then(files::pose_covariance_file);
        self.layers.iter().map(PathBuf::as_path).chain(covariance)
    }

    /// Returns true if features are requested.
    fn is_asked(&self, asked: NamedRequest) -> bool {
        !self.layers.is_empty() || self.features.is_some() || asked.feature_id() || asked.by_virtual_sensor()
    }

    /// The image that features are predicted from, if features are requested.
    pub fn needs(&self, asked: NamedRequest) -> Option<Output> {
        self.is_asked(asked).then_some(Output::PolygonId)
    }

    /// Entries of the features file for features without a visible part.
    fn hidden(&self, asked: NamedRequest) -> Hidden {
        match self.hidden {
            Some(HiddenArg::Count) => Hidden::Count,
            Some(HiddenArg::Reason) => Hidden::Reason,
            Some(HiddenArg::Full) => Hidden::Full,
            None if asked.many_poses => Hidden::Reason,
            None => Hidden::Full,
        }
    }

    /// Returns true if a features file is written.
    pub fn writes_something(&self) -> bool {
        self.features.is_some()
    }

    /// Returns true if the preview shows feature numbers.
    pub fn numbers(&self) -> bool {
        self.feature_numbers
    }

    /// Reads the layers, merges them over the scene's own layer, and finds the polygons under their features. Returns
    /// `None` if no features are requested.
    pub fn load(&self, scene: &Scene, sensor: &Sensor, asked: NamedRequest) -> Result<Option<Layers>> {
        if !self.is_asked(asked) {
            return Ok(None);
        }
        let class = &sensor.spec().class;
        let own = scene.world.environment().layer(class);
        if self.layers.is_empty() && own.is_none() {
            // The features file then holds the virtual sensor's reading only.
            if asked.virtual_sensor.is_some() && !asked.by_virtual_sensor() && !asked.feature_id() {
                return Ok(None);
            }
            let what = format!("features are requested, and the scene has none for class {class:?}");
            return Err(Error::usage(what, "give a --layer (presight features generates one)"));
        }
        let wanted = asked.virtual_sensor.filter(|v| v.needs_features());
        let SceneFeatures { placed, other_classes } =
            scene.place_layers_of(&self.layers, class, |shape| wanted.is_none_or(|v| v.wants(shape)))?;
        if other_classes > 0 {
            print::notices(&[format!("ignoring {other_classes} features for other classes than {class:?}")]);
        }
        let mut options = FeatureOptions::default().with_placed(placed);
        options.time = self.time;
        options.max_features = self.max_features;
        // Pictures and readings use every hidden part.
        if asked.preview || asked.virtual_sensor.is_some() {
            options.hidden = Hidden::Full;
        } else if self.features.is_some() {
            options.hidden = self.hidden(asked);
        }
        let covariance = self
            .pose_cov
            .as_deref()
            .map(files::parse_pose_covariance)
            .transpose()
            .map_err(|e| e.at("--pose-cov"))?
            .unwrap_or_default();
        let mut boxes = BoxOptions::default();
        boxes.confidence = self.confidence.unwrap_or(boxes.confidence);
        // A feature_id image and a virtual sensor need no regions of interest.
        let only_without = (asked.feature_id() || asked.virtual_sensor.is_some()) && self.pose_cov.is_none();
        let boxed = self.features.is_some() || asked.preview || !only_without;
        Ok(Some(Layers { options, covariance, boxes, boxed }))
    }

    /// Writes the features file, if one is requested.
    pub fn write(
        &self,
        scene: &Scene,
        prediction: &Prediction,
        (asked, shown): (NamedRequest, &Shown),
        path: Option<&Path>,
    ) -> Result<()> {
        let Some(path) = path else { return Ok(()) };
        let header = PredictionHeader {
            hidden: self.hidden(asked),
            pose_covariance: shown.boxes.as_ref().map(|boxes| boxes.sensor),
            confidence: shown.boxes.as_ref().map(|boxes| boxes.confidence),
            given_up: prediction.degradation().cloned(),
            ..PredictionHeader::new(&prediction.sensor, prediction.pose)
        };
        let none = FeaturePrediction::default();
        let seen = prediction.features.as_ref().unwrap_or(&none);
        files::write_prediction_json(path, &header, seen, scene.world.environment(), shown.reading.as_ref())
    }
}

impl Layers {
    /// Sets the covariance of the sensor's next pose, along the axes of the world.
    pub fn move_to(&mut self, given: &ExternalPose, sensor: &Sensor, pose: &SensorPose, scene: &Scene) {
        let (covariance, world_from_gltf) = (&self.covariance, &scene.world_from_gltf);
        self.boxes.sensor = given.covariance_of_sensor(covariance, sensor.spec(), pose, world_from_gltf);
    }

    /// The options of regions of interest.
    pub fn boxes(&self) -> &BoxOptions {
        &self.boxes
    }

    /// Adds entries for features out of view, which files and readings list too.
    pub fn spell_out(&self, scene: &Scene, prediction: &mut Prediction) {
        if let (Some(features), FeatureSource::Placed(placed)) = (&mut prediction.features, &self.options.source) {
            features.spell_out(scene.world.environment(), &placed.features);
        }
    }

    /// Adds the features to a request.
    pub fn add_to(&self, request: Request) -> Request {
        let request = request.with_features(self.options.clone());
        if self.boxed { request.with_regions(self.boxes.clone()) } else { request }
    }
}
