//! Features of a prediction: their polygons, their visibility, and their regions of interest.

use super::recovery::faulty;
use super::{Prediction, Predictor};
use crate::Backend;
use crate::engine;
use crate::probe::{Probe, SensorKind};
use crate::request::Request;
use presight_features::{
    BoxOptions, BoxQuery, FeatureOptions, FeaturePrediction, FeatureSamples, FeatureSettings, FeatureSource,
    FeatureTree, Hidden, OcclusionHint, PlacedFeature, PlacedFeatures, PreparedFeatures, SeenFeature, Vantage,
    Visibility, add_boxes, check_placed, choose, predict_features, sides_seen_in_part,
};
use presight_model::clock::Instant;
use presight_model::contour::ContourSet;
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::placement;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_render::cost::DeadlineFrame;
use presight_render::plan::{CountName, Images, Output, StageName, Stats};
use std::sync::Arc;

/// A request for features.
pub(super) struct FeatureTask<'a> {
    pub vantage: Vantage<'a>,
    pub request: &'a Request,
    pub placed: &'a PlacedFeatures,
    /// For regions of interest, if they are requested.
    pub regions: Option<BoxOptions>,
}

impl<'a> FeatureTask<'a> {
    pub fn new(vantage: Vantage<'a>, request: &'a Request, placed: &'a PlacedFeatures) -> Self {
        let regions = request.regions.as_ref().map(|options| {
            let mut options = options.clone();
            options.objects.extend(placed.objects.iter().copied());
            options
        });
        Self { vantage, request, placed, regions }
    }
}

/// The features of a world's own layer, placed in one version of the world.
pub(super) struct WorldFeatures {
    /// [`World::stamp`].
    world: u64,
    class: String,
    placed: PlacedFeatures,
}

/// The features of the last prediction: their tree, and the surfaces of contours.
pub(super) struct KnownTree {
    features: Arc<[PlacedFeature]>,
    /// [`World::stamp`] of the version that they were checked against.
    world: u64,
    class: String,
    tree: FeatureTree,
    contours: ContourSet,
}

impl KnownTree {
    /// Checks the features in this world. `before` was made from the same features in another version of it.
    fn new(world: &World, class: &str, placed: &Arc<[PlacedFeature]>, before: Option<Self>) -> Result<Self> {
        check_placed(world.environment(), placed)?;
        // The continuation of a surface into others depends on where these are.
        let (tree, contours) = match before.filter(|before| before.contours.is_empty()) {
            Some(before) => (before.tree, before.contours),
            None => {
                let contours = ContourSet::new(world, class, placed)?;
                (FeatureTree::new(placed, &contours), contours)
            }
        };
        Ok(Self { features: placed.clone(), world: world.stamp(), class: class.to_owned(), tree, contours })
    }

    pub fn parts(&self) -> (&FeatureTree, &ContourSet) {
        (&self.tree, &self.contours)
    }
}

impl Predictor {
    /// The requested features, on their polygons.
    pub(super) fn place(&mut self, world: &World, sensor: &Sensor, options: &FeatureOptions) -> Result<PlacedFeatures> {
        let class = &sensor.spec().class;
        match (&options.source, &self.own) {
            (FeatureSource::Placed(placed), _) => Ok(placed.clone()),
            (FeatureSource::World, Some(own)) if own.world == world.stamp() && own.class == *class => {
                Ok(own.placed.clone())
            }
            (FeatureSource::World, _) => {
                let Some(layer) = world.environment().layer(class) else {
                    let what = format!("features are requested, but the world has none for class {class:?}");
                    return Err(Error::usage(what, "generate a layer (presight features), or give placed features"));
                };
                let placed = self.on_threads(|| placement::place_layer(world, layer))??;
                self.own = Some(WorldFeatures { world: world.stamp(), class: class.clone(), placed: placed.clone() });
                Ok(placed)
            }
        }
    }

    /// Predicts features and their regions from images just made; adds `feature_id` to the images.
    pub(super) fn features(
        &mut self,
        task: &FeatureTask<'_>,
        images: &mut Images,
        stats: &mut Stats,
        timed: Option<&mut DeadlineFrame>,
    ) -> Result<FeaturePrediction> {
        let FeatureTask { vantage, request, placed, regions } = task;
        let features = match timed {
            Some(timed) => self.features_in_time(task, images, stats, timed)?,
            None => {
                let mut features = self.see(vantage, images, &placed.features, &settings(request), stats)?;
                images.feature_id = std::mem::take(&mut features.feature_id);
                if let Some(most) = request.features.as_ref().and_then(|options| options.max_features) {
                    let start = Instant::now();
                    let known = regions.as_ref().map(|regions| &regions.sensor);
                    let dropped = choose(&mut features, &placed.features, vantage, known, most);
                    stats.count(CountName::FeaturesNotChosen, dropped);
                    stats.stage(StageName::FeatureChoice, start);
                }
                if let Some(options) = regions {
                    let placed = &placed.features;
                    let Vantage { world, sensor, world_from_sensor } = *vantage;
                    let query = BoxQuery { placed, world, sensor, world_from_sensor, options };
                    self.add_regions(&mut features, &query, stats)?;
                }
                features
            }
        };
        tell_lost(&placed.lost, &vantage.sensor.spec().class, stats);
        if regions.is_none() {
            stats.leave_out(StageName::RegionsOfInterest, "no requested output shows them");
        }
        Ok(features)
    }

    /// Predicts the visibility of features.
    fn see(
        &mut self,
        vantage: &Vantage<'_>,
        images: &Images,
        placed: &Arc<[PlacedFeature]>,
        settings: &FeatureSettings,
        stats: &mut Stats,
    ) -> Result<FeaturePrediction> {
        if placed.is_empty() {
            stats.leave_out(StageName::Features, "there are no features for this class");
        }
        let mut start = Instant::now();
        let tree = self.known_tree(vantage.world, &vantage.sensor.spec().class, placed)?;
        let known = Some(tree.parts());
        let prepare = || PreparedFeatures::new(vantage, images, placed, known, settings);
        let prepared = self.on_threads(prepare)??;
        if placed.is_empty() {
            return Ok(prepared.finish(None));
        }
        let hints = match settings.visibility {
            Visibility::Rays => None,
            Visibility::Image => self.query_occlusion(&prepared, vantage.sensor, stats)?,
        };
        if hints.is_some() {
            stats.stage(StageName::FeaturesOnDevice, start);
            start = Instant::now();
        }
        self.tell_of_software(StageName::FeaturesOnDevice, stats);
        let prediction = self.on_threads(|| prepared.finish(hints.as_deref()))?;
        stats.stage(StageName::Features, start);
        for (name, n) in prediction.stats.counts() {
            stats.count(name, n);
        }
        Ok(prediction)
    }

    /// The tree for features, after checking them in this world. It is kept for the next prediction.
    pub(super) fn known_tree(
        &mut self,
        world: &World,
        class: &str,
        placed: &Arc<[PlacedFeature]>,
    ) -> Result<Arc<KnownTree>> {
        let known = self.tree.take().filter(|known| Arc::ptr_eq(&known.features, placed) && known.class == class);
        let tree = match known {
            Some(known) if known.world == world.stamp() => known,
            known => Arc::new(KnownTree::new(world, class, placed, known.and_then(Arc::into_inner))?),
        };
        self.tree = Some(tree.clone());
        Ok(tree)
    }

    /// Adds regions of interest.
    fn add_regions(
        &mut self,
        prediction: &mut FeaturePrediction,
        query: &BoxQuery<'_>,
        stats: &mut Stats,
    ) -> Result<()> {
        if prediction.features.is_empty() {
            stats.leave_out(StageName::RegionsOfInterest, "there is no feature");
            return Ok(());
        }
        let start = Instant::now();
        match self.boxes(prediction, query, stats)? {
            Some(made) => stats.count(CountName::RegionsOnDevice, made),
            None => self.tell_of_software(StageName::RegionsOnDevice, stats),
        }
        stats.stage(StageName::RegionsOfInterest, start);
        Ok(())
    }

    /// [`engine::add_boxes`], with the CPU as fallback for an automatically chosen device. Returns the device's count.
    fn boxes(
        &mut self,
        prediction: &mut FeaturePrediction,
        query: &BoxQuery<'_>,
        stats: &mut Stats,
    ) -> Result<Option<usize>> {
        self.threads = self.threads.started()?;
        let before = self.engine.device().map(|device| device.work());
        let proven = self.prove_regions(query.sensor);
        let engine = &mut *self.engine;
        let made = proven.and_then(|()| engine::add_boxes(engine, &self.threads, prediction, query));
        match (made, before) {
            (Ok(Some(made)), Some(before)) => {
                stats.work.add(self.engine.device().map(|device| device.work().since(before)).unwrap_or_default());
                Ok(Some(made))
            }
            // The CPU computes the same boxes; the next prediction opens the device again.
            (Err(e), Some(_)) if self.backend == Backend::Auto && e.kind() != ErrorKind::Usage => {
                self.threads.run(|| add_boxes(prediction, query))??;
                Ok(None)
            }
            (made, _) => made,
        }
    }

    /// Records that a stage stays on the CPU because the adapter is software.
    fn tell_of_software(&mut self, stage: StageName, stats: &mut Stats) {
        if self.engine.device().is_some_and(|device| !device.takes_features()) {
            stats.leave_out(stage, "done on the CPU: the adapter is software on the CPU's own cores");
        }
    }

    /// Queries the images on the device for occluders of feature samples. Returns slots that may hide them, or `None`
    /// if the device does not hold the images.
    fn query_occlusion(
        &mut self,
        prepared: &PreparedFeatures<'_>,
        sensor: &Sensor,
        stats: &mut Stats,
    ) -> Result<Option<Vec<Vec<Option<u32>>>>> {
        if !self.engine.device().is_some_and(|device| device.takes_features() && device.holds_images()) {
            return Ok(None);
        }
        let samples = self.on_threads(|| prepared.query_samples())?;
        if samples.iter().all(Vec::is_empty) {
            stats.leave_out(StageName::FeaturesOnDevice, "no sample depends on surfaces in between");
            return Ok(None);
        }
        let Some(device) = self.engine.device() else { return Ok(None) };
        let before = device.work();
        let placed: Vec<&PlacedFeature> = prepared.asked().collect();
        let hints = match device.query_occlusion(&FeatureSamples { samples: &samples, placed: &placed, sensor }) {
            Ok(hints) => hints,
            // The images on the CPU hold the same information; the next prediction opens the device again.
            Err(_) if self.backend == Backend::Auto => return Ok(None),
            Err(e) => return Err(e),
        };
        stats.work.add(device.work().since(before));
        let doubtful = hints.iter().filter(|hint| **hint == OcclusionHint::Doubt).count();
        stats.count(CountName::FeatureSamplesInDoubt, doubtful);
        let mut slots = hints.iter().map(|hint| match hint {
            OcclusionHint::Hidden(slot) => Some(*slot),
            _ => None,
        });
        Ok(Some(samples.iter().map(|samples| slots.by_ref().take(samples.len()).collect()).collect()))
    }

    /// Verifies a device's regions of interest against the CPU before their first use for a kind of sensor. Visibility
    /// needs no such check, because the CPU verifies each answer.
    fn prove_regions(&mut self, sensor: &Sensor) -> Result<()> {
        let Some(device) = self.engine.device().filter(|device| device.takes_features()) else { return Ok(()) };
        let task = SensorKind::of(sensor);
        let known = self.proven.regions.iter().find(|(of, _)| *of == task).map(|(_, check)| *check);
        let check = match known {
            Some(check) => check,
            None => {
                let check = Probe::new()?.regions(task, device)?;
                self.proven.regions.push((task, check));
                check
            }
        };
        match check.wrong {
            0 => Ok(()),
            wrong => Err(faulty(device, format!("makes {wrong} of {} regions of a probe wrong", check.all))),
        }
    }

    /// Predicts the visible outlines of partly visible patches, for pictures. Needs the `polygon_id` image.
    ///
    /// # Errors
    /// [`ErrorKind::Usage`] if the world's version differs from the prediction's; [`ErrorKind::Invalid`] without
    /// `polygon_id`.
    pub fn predict_outlines(&mut self, world: &World, prediction: &Prediction) -> Result<Vec<SeenFeature>> {
        let Prediction { request, sensor, pose, images, .. } = prediction;
        let (Some(options), Some(seen)) = (&request.features, &prediction.features) else { return Ok(Vec::new()) };
        if world.version() != prediction.world_version {
            let (is, was) = (world.version(), prediction.world_version);
            let what = format!("the world is at version {is}, but the prediction is for version {was}");
            return Err(Error::usage(what, "predict again"));
        }
        let placed = self.place(world, sensor, options)?;
        let sides = sides_seen_in_part(&placed.features, seen);
        let settings = FeatureSettings { feature_id: false, hidden: Hidden::Full, ..settings(request) };
        let predict = || predict_features(world, sensor, &pose.world_from_sensor(), images, &sides, &settings);
        Ok(self.on_threads(predict)??.features)
    }
}

pub(super) fn settings(request: &Request) -> FeatureSettings {
    let FeatureOptions { time, hidden, visibility, step, .. } = request.features.clone().unwrap_or_default();
    let feature_id = request.outputs.has(Output::FeatureId);
    FeatureSettings {
        time,
        ids: request.ids,
        feature_id,
        hidden,
        visibility,
        step,
        is_partial: false,
        regions: request.regions.is_some(),
    }
}

/// Reports features that are left out because their surface is gone.
fn tell_lost(lost: &[u32], class: &str, stats: &mut Stats) {
    const LISTED: usize = 10;
    if lost.is_empty() {
        return;
    }
    stats.count(CountName::FeaturesOffPolygons, lost.len());
    let mut ids: Vec<String> = lost.iter().take(LISTED).map(u32::to_string).collect();
    ids.extend((lost.len() > LISTED).then(|| "..".to_owned()));
    let (count, ids) = (lost.len(), ids.join(", "));
    let subject = if count == 1 { "1 feature".to_owned() } else { format!("{count} features") };
    stats.notices.push(format!(
        "{subject} for class {class:?} left out: the surface below is gone ({ids}); change or delete them, \
         or restore the surface; see presight inspect"
    ));
}
