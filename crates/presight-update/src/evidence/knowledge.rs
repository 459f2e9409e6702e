//! The evidence of all believed views, with the views themselves.

use crate::evidence::drive::PendingView;
use crate::evidence::features::book::FeatureBook;
use crate::evidence::joint::Joint;
use crate::evidence::objects::{Book, Evidence};
use crate::evidence::voxels::Voxels;
use crate::observe::mount::PoseCorrections;
use crate::observe::priors::Priors;
use crate::observe::view::View;
use crate::options::LearnOptions;
use presight_model::caster::RayCaster;
use presight_model::environment::Environment;
use presight_model::world::World;
use std::collections::{BTreeMap, VecDeque};

/// The evidence of all believed views.
pub(crate) struct Knowledge {
    pub options: LearnOptions,
    /// By class of sensor.
    pub casters: BTreeMap<String, RayCaster>,
    /// By class of sensor.
    pub priors: BTreeMap<String, Priors>,
    /// The poses of objects, by class of sensor.
    pub joints: BTreeMap<String, Joint>,
    pub book: Book,
    pub features: FeatureBook,
    pub voxels: Voxels,
    /// The newest views, at most [`LearnOptions::views`].
    pub views: VecDeque<View>,
    /// Corrections of the views' poses by their readings.
    pub corrections: PoseCorrections,
}

impl Knowledge {
    pub fn new(options: LearnOptions) -> Self {
        Self {
            options,
            casters: BTreeMap::new(),
            priors: BTreeMap::new(),
            joints: BTreeMap::new(),
            book: Book::default(),
            features: FeatureBook::default(),
            voxels: Voxels::new(options.voxel),
            views: VecDeque::new(),
            corrections: PoseCorrections::default(),
        }
    }

    /// The sensor class of the newest view; empty without a view.
    pub fn newest_class(&self) -> String {
        self.views.back().map_or_else(String::new, |view| view.class().to_owned())
    }

    /// Prepares a world for the rays of a class.
    pub fn prepare(&mut self, world: &World, class: &str) {
        if !self.casters.contains_key(class) {
            self.casters.insert(class.to_owned(), RayCaster::new(world, class));
        }
        if !self.priors.contains_key(class) {
            let priors = Priors::of(world.environment(), class, self.options.model_sigma);
            self.priors.insert(class.to_owned(), priors);
        }
    }

    /// Adds a believed view.
    pub fn add(&mut self, PendingView { view, sums, features, .. }: PendingView) {
        self.corrections.add(&view.correction);
        self.book.add(&sums, (view.stamp, view.class()), &self.options);
        features.iter().for_each(|features| self.features.add(features, view.stamp));
        if let Some(terms) = &view.terms {
            self.joints.entry(view.class().to_owned()).or_default().add(terms);
        }
        let size = self.voxels.size();
        for key in self.voxels.add_view(&view.new_points, |voxel| view.passed(&voxel.spot(size), size)) {
            let Some(spot) = self.voxels.spot(key) else { continue };
            let before = self.views.iter().filter(|earlier| earlier.passed(&spot, size)).count();
            self.voxels.add_passes(key, before as u32);
        }
        if self.views.len() >= self.options.views {
            self.views.pop_front();
        }
        self.views.push_back(view);
    }

    /// Forgets the evidence that a new model has used: on the changed objects, and in voxels near its surfaces.
    pub fn forget(&mut self, world: &World, changed: &[String]) {
        self.book.forget(world.environment(), changed);
        let caster = RayCaster::new(world, &self.newest_class());
        let reach = 2.0 * self.voxels.size();
        self.voxels.retain(|_, voxel| caster.nearest(voxel.mean(), reach).is_none());
    }

    /// The evidence on each object that a view supports or contradicts, by name.
    pub fn of_objects(&self, environment: &Environment) -> Vec<(String, Evidence)> {
        let objects = environment.objects();
        self.book.objects.iter().map(|(object, e)| (objects[*object as usize].name.clone(), *e)).collect()
    }

    /// The share of measured points that lie within some metres of the surface that a world predicts on their ray.
    pub fn share_explained(&self, world: &World, within: f64) -> f64 {
        let caster = RayCaster::new(world, &self.newest_class());
        let (mut all, mut near) = (0usize, 0usize);
        for view in &self.views {
            for (at, ray) in view.pixels.rays.iter().enumerate() {
                let z = f64::from(view.ranges[at]);
                if z.is_finite() && !ray.is_nan() {
                    let hit = caster.cast(view.origin(), view.world_from_image.rotation * *ray, view.reach(), None);
                    all += 1;
                    near += usize::from(hit.is_some_and(|hit| (hit.range - z).abs() <= within));
                }
            }
        }
        near as f64 / all.max(1) as f64
    }
}
