//! Features in a prediction: layers read and placed, visibility predicted, results written.

use super::load::Scene;
use super::pose::GivenPose;
use super::pose_cov;
use super::print;
use crate::environment::{Feature, FeatureLayer};
use crate::error::{Error, Result};
use crate::features::roi::PoseCovariance;
use crate::features::{
    BoxOptions, FeatureOptions, FeaturePrediction, PlacedFeature, SeenFeature, place, predict_features,
    sides_seen_in_part,
};
use crate::geometry::Pose;
use crate::io::layer::LayerFile;
use crate::io::{layer, prediction_json};
use crate::placement::{self, Placement};
use crate::plan::{IdScheme, Images, Output, Outputs, Stats};
use crate::predict::{Prediction, Predictor};
use crate::sensor::Sensor;
use crate::virtual_sensors::{VirtualReading, VirtualSensor};
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
pub struct Asked {
    /// All outputs wanted.
    pub outputs: Outputs,
    /// The virtual sensor.
    pub virtual_sensor: Option<VirtualSensor>,
    /// A preview is drawn, which shows boxes.
    pub preview: bool,
}

impl Asked {
    fn feature_id(self) -> bool {
        self.outputs.has(Output::FeatureId)
    }

    fn by_virtual_sensor(self) -> bool {
        self.virtual_sensor.is_some_and(VirtualSensor::needs_features)
    }
}

/// Features placed in a world, ready to be predicted.
pub struct Layers {
    placed: Vec<PlacedFeature>,
    /// Sensor class, and numbers of the scene's own features that lie on no polygon any more.
    lost: (String, Vec<u32>),
    options: FeatureOptions,
    boxes: BoxOptions,
    /// Something shows the boxes, or only they were asked for.
    boxed: bool,
}

impl LayerArgs {
    /// Checks them without touching the world.
    pub fn check(&self, asked: Asked) -> Result<()> {
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
        let covariance = self.pose_cov.as_deref().and_then(pose_cov::file);
        self.layers.iter().map(PathBuf::as_path).chain(covariance)
    }

    /// True if features are to be predicted.
    fn is_asked(&self, asked: Asked) -> bool {
        !self.layers.is_empty() || self.features.is_some() || asked.feature_id() || asked.by_virtual_sensor()
    }

    /// Images that features are predicted from.
    pub fn needs(&self, asked: Asked) -> Option<Output> {
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
    pub fn load(
        &self,
        scene: &Scene,
        sensor: &Sensor,
        (pose, world_from_sensor): (&GivenPose, &Pose),
        ids: IdScheme,
        asked: Asked,
    ) -> Result<Option<Layers>> {
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
        let mut loaded = layer::load(own, &self.layers, class)?;
        if let Some(v) = asked.virtual_sensor.filter(|v| v.needs_features()) {
            loaded.layers.iter_mut().for_each(|l| l.layer.features.retain(|f| v.wants(&f.shape)));
        }
        if loaded.other_classes > 0 {
            let n = loaded.other_classes;
            print::message(&format!("note: {n} features are for other classes than {class:?} and left out"));
        }
        let (Placement { placed, off }, objects) = place_all(scene, &loaded.layers)?;
        let feature_id = asked.feature_id();
        let options = FeatureOptions { time: self.time, ids, feature_id, ..FeatureOptions::default() };
        let covariance = self.pose_cov.as_deref().map(pose_cov::parse).transpose()?.unwrap_or_default();
        let default = BoxOptions::default();
        let boxes = BoxOptions {
            sensor: pose.covariance_of_sensor(&covariance, sensor.spec(), world_from_sensor, &scene.world_from_gltf),
            objects,
            confidence: self.confidence.unwrap_or(default.confidence),
            ..default
        };
        // An image of numbers and the answer of a virtual sensor are made without boxes.
        let only_without = (feature_id || asked.virtual_sensor.is_some()) && self.pose_cov.is_none();
        let boxed = self.features.is_some() || asked.preview || !only_without;
        Ok(Some(Layers { placed, lost: (class.clone(), off), options, boxes, boxed }))
    }

    /// Writes the prediction's file, if one is asked for.
    pub fn write(
        &self,
        scene: &Scene,
        prediction: &Prediction,
        features: Option<(&Layers, &FeaturePrediction)>,
        reading: Option<&VirtualReading>,
    ) -> Result<()> {
        let Some(path) = &self.features else { return Ok(()) };
        let header = prediction_json::Header {
            sensor: prediction.sensor.spec().name.clone(),
            world_from_sensor: prediction.world_from_sensor,
            pose_covariance: features.map(|(layers, _)| layers.boxes.sensor),
            confidence: features.map(|(layers, _)| layers.boxes.confidence),
            given_up: prediction.given_up().cloned(),
        };
        let none = FeaturePrediction::default();
        let seen = features.map_or(&none, |(_, seen)| seen);
        prediction_json::write(path, &header, seen, scene.world.environment(), reading)
    }
}

/// Covariances of objects' poses, by index.
type ObjectPoses = Vec<(u32, PoseCovariance)>;

/// Finds where the features of each layer lie, by that layer's tolerance, and what is known of objects' poses. Features of the
/// scene's own layer may have lost their surface since they were put in, and are set apart; those of a file are to be right, but for
/// those that it says lost theirs.
/// Errors name the layer's file; of the scene's own layer that is the scene's.
fn place_all(scene: &Scene, layers: &[LayerFile]) -> Result<(Placement, ObjectPoses)> {
    let (mut all, mut objects) = (Placement::default(), ObjectPoses::new());
    for LayerFile { layer, path, lost, .. } in layers {
        let in_file = |e: Error| e.in_file(path.as_ref().unwrap_or(&scene.path));
        let mut set_apart = |layer: &FeatureLayer| -> Result<()> {
            let Placement { placed, off } = placement::find(&scene.world, layer).map_err(in_file)?;
            all.placed.extend(placed);
            all.off.extend(off);
            Ok(())
        };
        match path {
            None => set_apart(layer)?,
            Some(_) if lost.is_empty() => all.placed.extend(place(&scene.world, layer).map_err(in_file)?),
            Some(_) => {
                let is_lost = |f: &Feature| lost.binary_search(&f.id).is_ok();
                let (marked, others) = layer.features.iter().cloned().partition(is_lost);
                set_apart(&FeatureLayer { features: marked, ..layer.clone() })?;
                let others = FeatureLayer { features: others, ..layer.clone() };
                all.placed.extend(place(&scene.world, &others).map_err(in_file)?);
            }
        }
        for (object, covariance) in &layer.pose_covariances {
            objects.push((scene.world.environment().index_of(object).map_err(in_file)?, *covariance));
        }
    }
    all.placed.sort_by_key(|p| p.feature.id);
    all.off.sort_unstable();
    Ok((all, objects))
}

impl Layers {
    /// What the sensor sees of the outlines of patches that it sees in part, for pictures.
    pub fn sides(
        &self,
        predictor: &mut Predictor,
        scene: &Scene,
        prediction: &Prediction,
        seen: &FeaturePrediction,
    ) -> Result<Vec<SeenFeature>> {
        let sides = sides_seen_in_part(&self.placed, seen);
        let (world, options) = (
            &scene.world,
            FeatureOptions { feature_id: false, is_partial: prediction.given_up().is_some(), ..self.options },
        );
        let Prediction { sensor, world_from_sensor, images, .. } = prediction;
        let predict = || predict_features(world, sensor, world_from_sensor, images, &sides, &options);
        Ok(predictor.on_threads(predict)??.features)
    }

    /// What is to be known of features that are left out because nothing is under them.
    fn tell_lost(&self, stats: &mut Stats) {
        const LISTED: usize = 10;
        let (class, lost) = &self.lost;
        if lost.is_empty() {
            return;
        }
        stats.count("features off their polygons", lost.len());
        let mut ids: Vec<String> = lost.iter().take(LISTED).map(u32::to_string).collect();
        ids.extend((lost.len() > LISTED).then(|| "..".to_owned()));
        let (count, ids) = (lost.len(), ids.join(", "));
        let subject = if count == 1 { "1 feature".to_owned() } else { format!("{count} features") };
        stats.notices.push(format!(
            "{subject} for class {class:?} left out: the surface below is gone ({ids}); alter or delete them, or put back what \
             was moved; presight inspect tells more"
        ));
    }

    /// Predicts them from images just made, notes what it cost, and puts `feature_id` among the images.
    pub fn predict(
        &self,
        predictor: &mut Predictor,
        scene: &Scene,
        prediction: &Prediction,
        images: &mut Images,
        stats: &mut Stats,
    ) -> Result<FeaturePrediction> {
        let (sensor, pose) = (&prediction.sensor, &prediction.world_from_sensor);
        let (world, placed) = (&scene.world, &self.placed);
        let mut features = predictor.predict_features(world, sensor, pose, images, placed, &self.options, stats)?;
        images.feature_id = std::mem::take(&mut features.feature_id);
        self.tell_lost(stats);
        if self.boxed {
            predictor.add_boxes(&mut features, placed, world, sensor, pose, &self.boxes, stats)?;
        } else {
            stats.leave_out("regions of interest", "nothing that is asked for shows them");
        }
        Ok(features)
    }
}
