//! Features in a prediction: layers read and placed, visibility predicted, results written.

use super::predict::Shown;
use super::print;
use presight::features::roi::PoseCovariance;
use presight::features::{BoxOptions, FeatureOptions, FeaturePrediction, FeatureSource, Hidden};
use presight::frames::ExternalPose;
use presight::geometry::Pose;
use presight::io::{pose_covariance, prediction_json};
use presight::plan::{Output, Outputs};
use presight::sensor::Sensor;
use presight::virtual_sensors::VirtualSensor;
use presight::{Error, Prediction, Request, Result, Scene, SceneFeatures};
use std::path::{Path, PathBuf};

/// Which features are predicted, and where they go.
#[derive(Debug, clap::Args)]
pub struct LayerArgs {
    /// Predict the features of this layer, too, over the scene's own; later ones win by id
    #[arg(long = "layer", value_name = "FILE.json")]
    layers: Vec<PathBuf>,

    /// Write what is seen of the features
    #[arg(long, value_name = "OUT.json")]
    pub features: Option<PathBuf>,

    /// Of the features seen, keep those N that tell most of the sensor's pose
    ///
    /// One by one the feature that adds most to the information of the pose, weighted by existence and contrast.
    #[arg(long, value_name = "N")]
    max_features: Option<usize>,

    /// UTC seconds for which features' probabilities of existence are told [default: the newest confirmation]
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    time: Option<f64>,

    /// How uncertain the pose is, for regions of interest: sx,sy,sz,sroll_deg,spitch_deg,syaw_deg, or a file of 36 numbers
    ///
    /// Standard deviations, or a covariance as a JSON list, row-major, in metres and radians; along the world's axes.
    #[arg(long, value_name = "S|FILE.json")]
    pose_cov: Option<String>,

    /// Probability with which features are in their regions of interest [default: 0.99]
    #[arg(long, value_name = "P")]
    confidence: Option<f64>,

    /// Write the numbers of features into the preview
    #[arg(long)]
    feature_numbers: bool,
}

/// What is asked for by name, as far as features depend on it.
#[derive(Clone, Copy, Debug)]
pub struct NamedRequest {
    /// All outputs wanted.
    pub outputs: Outputs,
    /// The virtual sensor.
    pub virtual_sensor: Option<VirtualSensor>,
    /// A preview is drawn, which shows boxes.
    pub preview: bool,
}

impl NamedRequest {
    fn feature_id(self) -> bool {
        self.outputs.has(Output::FeatureId)
    }

    fn by_virtual_sensor(self) -> bool {
        self.virtual_sensor.is_some_and(VirtualSensor::needs_features)
    }
}

/// What is asked for of features.
pub struct Layers {
    options: FeatureOptions,
    /// Of the poses as they are given.
    covariance: PoseCovariance,
    boxes: BoxOptions,
    /// Something shows the boxes, or only they were asked for.
    boxed: bool,
}

impl LayerArgs {
    /// Checks them without touching the world.
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
                let what = format!("--{flag} is of features, and none are asked for");
                Err(Error::usage(what, "give a --layer, or --features OUT.json for the scene's own"))
            }
        }
    }

    /// Files that are named to be read.
    pub fn inputs(&self) -> impl Iterator<Item = &Path> {
        let covariance = self.pose_cov.as_deref().and_then(pose_covariance::file);
        self.layers.iter().map(PathBuf::as_path).chain(covariance)
    }

    /// True if features are to be predicted.
    fn is_asked(&self, asked: NamedRequest) -> bool {
        !self.layers.is_empty() || self.features.is_some() || asked.feature_id() || asked.by_virtual_sensor()
    }

    /// Images that features are predicted from.
    pub fn needs(&self, asked: NamedRequest) -> Option<Output> {
        self.is_asked(asked).then_some(Output::PolygonId)
    }

    /// True if a file of their own is asked for.
    pub fn writes_something(&self) -> bool {
        self.features.is_some()
    }

    /// True if features' numbers go into the preview.
    pub fn numbers(&self) -> bool {
        self.feature_numbers
    }

    /// Reads the layers over the scene's own and finds the polygons that their features lie on; `None` if none are asked
    /// for.
    pub fn load(&self, scene: &Scene, sensor: &Sensor, asked: NamedRequest) -> Result<Option<Layers>> {
        if !self.is_asked(asked) {
            return Ok(None);
        }
        let class = &sensor.spec().class;
        let own = scene.world.environment().layer(class);
        if self.layers.is_empty() && own.is_none() {
            // The file of features is then the virtual sensor's alone.
            if asked.virtual_sensor.is_some() && !asked.by_virtual_sensor() && !asked.feature_id() {
                return Ok(None);
            }
            let what = format!("features are asked for, and the scene has none for class {class:?}");
            return Err(Error::usage(what, "give a --layer (presight features generates one)"));
        }
        let wanted = asked.virtual_sensor.filter(|v| v.needs_features());
        let SceneFeatures { placed, other_classes } =
            scene.place_layers_of(&self.layers, class, |shape| wanted.is_none_or(|v| v.wants(shape)))?;
        if other_classes > 0 {
            print::message(&format!(
                "note: {other_classes} features are for other classes than {class:?} and left out"
            ));
        }
        let mut options = FeatureOptions::default().with_placed(placed);
        options.time = self.time;
        options.max_features = self.max_features;
        // Files and pictures show what is hidden, too.
        if self.features.is_some() || asked.preview || asked.virtual_sensor.is_some() {
            options.hidden = Hidden::Full;
        }
        let covariance = self
            .pose_cov
            .as_deref()
            .map(pose_covariance::parse)
            .transpose()
            .map_err(|e| e.at("--pose-cov"))?
            .unwrap_or_default();
        let mut boxes = BoxOptions::default();
        boxes.confidence = self.confidence.unwrap_or(boxes.confidence);
        // An image of numbers and the answer of a virtual sensor are made without boxes.
        let only_without = (asked.feature_id() || asked.virtual_sensor.is_some()) && self.pose_cov.is_none();
        let boxed = self.features.is_some() || asked.preview || !only_without;
        Ok(Some(Layers { options, covariance, boxes, boxed }))
    }

    /// Writes the prediction's file, if one is asked for.
    pub fn write(&self, scene: &Scene, prediction: &Prediction, shown: &Shown, path: Option<&Path>) -> Result<()> {
        let Some(path) = path else { return Ok(()) };
        let header = prediction_json::Header {
            sensor: prediction.sensor.spec().name.clone(),
            world_from_sensor: prediction.world_from_sensor,
            pose_covariance: shown.boxes.as_ref().map(|boxes| boxes.sensor),
            confidence: shown.boxes.as_ref().map(|boxes| boxes.confidence),
            given_up: prediction.degradation().cloned(),
        };
        let none = FeaturePrediction::default();
        let seen = prediction.features.as_ref().unwrap_or(&none);
        prediction_json::write(path, &header, seen, scene.world.environment(), shown.reading.as_ref())
    }
}

impl Layers {
    /// Takes the uncertainty of the sensor's next pose, along the axes of the world.
    pub fn move_to(&mut self, pose: &ExternalPose, sensor: &Sensor, world_from_sensor: &Pose, scene: &Scene) {
        let (covariance, world_from_gltf) = (&self.covariance, &scene.world_from_gltf);
        self.boxes.sensor = pose.covariance_of_sensor(covariance, sensor.spec(), world_from_sensor, world_from_gltf);
    }

    /// What regions of interest are of.
    pub fn boxes(&self) -> &BoxOptions {
        &self.boxes
    }

    /// Gives what is out of view its entries, as files and readings hold them.
    pub fn spell_out(&self, scene: &Scene, prediction: &mut Prediction) {
        if let (Some(features), FeatureSource::Placed(placed)) = (&mut prediction.features, &self.options.source) {
            features.spell_out(scene.world.environment(), &placed.features);
        }
    }

    /// The request with their features.
    pub fn add_to(&self, request: Request) -> Request {
        let request = request.with_features(self.options.clone());
        if self.boxed { request.with_regions(self.boxes.clone()) } else { request }
    }
}
