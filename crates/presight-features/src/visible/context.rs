//! Data that all features of a prediction share.

use super::FeatureSettings;
use crate::sample::Sampler;
use crate::{Occluder, PlacedFeature, STEP};
use glam::{DMat3, DVec3};
use presight_model::environment::{Appearance, Environment};
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_render::plan::{Facing, IdScheme, Images, Instance, facings};
use std::collections::HashMap;
use std::sync::OnceLock;

pub(super) struct VisibilityContext<'a> {
    pub world: &'a World,
    pub environment: &'a Environment,
    pub sensor: &'a Sensor,
    pub world_from_sensor: Pose,
    pub image_from_world: DMat3,
    pub images: &'a Images,
    pub options: FeatureSettings,
    pub time: f64,
    pub facings: Vec<Facing>,
    /// By material: true if the sensor class does not see it.
    pub invisible: Vec<bool>,
    pub instances: Vec<OnceLock<Instance>>,
    /// By object: its frame relative to the image frame.
    frames: Vec<OnceLock<FrameInImage>>,
    /// Slot by `source` id.
    pub of_source: HashMap<u32, u32>,
    pub sampler: Sampler<'a>,
}

/// The frame of an object, relative to the image frame.
#[derive(Clone, Copy)]
struct FrameInImage {
    turn: DMat3,
    shift: DVec3,
    /// Distance of its origin from the sensor, metres.
    apart: f64,
}

/// A feature in the image frame.
pub(super) struct InImage {
    pub points: Vec<DVec3>,
    /// The rotation from its object's frame.
    pub image_from_object: DMat3,
    /// Bound of the rounding errors of its points, metres.
    pub rounding: f64,
}

impl<'a> VisibilityContext<'a> {
    pub fn new(
        world: &'a World,
        sensor: &'a Sensor,
        world_from_sensor: &Pose,
        images: &'a Images,
        time: f64,
        options: &FeatureSettings,
    ) -> Result<Self> {
        let environment: &Environment = world.environment();
        let pixels = sensor.width() as usize * sensor.height() as usize;
        if images.polygon_id.len() != pixels || (images.width, images.height) != (sensor.width(), sensor.height()) {
            let what = format!("there is no polygon_id image of {} x {} pixels", sensor.width(), sensor.height());
            return Err(Error::invalid(what, "request polygon_id"));
        }
        sensor.check_projection()?;
        // Far finer than the resolution of any sensor.
        if !(1e-3..=STEP).contains(&options.step) {
            let what = format!("the sampling step of features is {} pixels", options.step);
            return Err(Error::usage(what, format!("give a step of 0.001 to {STEP} pixels")));
        }
        let objects = environment.objects().len();
        let world_from_image = world_from_sensor.rotation_matrix() * sensor.body_from_image();
        Ok(Self {
            world,
            environment,
            sensor,
            world_from_sensor: *world_from_sensor,
            image_from_world: world_from_image.transpose(),
            images,
            options: *options,
            time,
            facings: facings(environment, &sensor.spec().class).collect(),
            invisible: environment
                .materials()
                .iter()
                .map(|m| m.appearance(&sensor.spec().class) == Appearance::Invisible)
                .collect(),
            instances: (0..objects).map(|_| OnceLock::new()).collect(),
            frames: (0..objects).map(|_| OnceLock::new()).collect(),
            of_source: if options.ids == IdScheme::Source { slots_of_sources(environment) } else { HashMap::new() },
            sampler: Sampler::with_step(sensor, options.step),
        })
    }

    #[inline]
    pub fn instance(&self, object: u32) -> &Instance {
        self.instances[object as usize].get_or_init(|| {
            Instance::new(self.environment, self.sensor, &self.world_from_sensor, &self.facings, object)
        })
    }

    #[inline]
    pub fn slot_of_id(&self, id: u32) -> Option<u32> {
        match self.options.ids {
            IdScheme::Model => id.checked_sub(1),
            IdScheme::Source => self.of_source.get(&id).copied(),
        }
    }

    /// The slot of the polygon that the image shows in a direction.
    pub fn slot_in(&self, direction: DVec3) -> Option<u32> {
        let (u, v) = self.sensor.project(direction)?;
        let (w, h) = (self.images.width, self.images.height);
        let within = |x: f64, n: u32| x >= -0.5 && x <= f64::from(n) - 0.5;
        if !within(v, h) || !(self.sampler.turn().is_some() || within(u, w)) {
            return None;
        }
        let (column, row) = self.sampler.nearest_pixel((u, v).into());
        let id = self.images.polygon_id[row as usize * w as usize + column as usize];
        if id == 0 { None } else { self.slot_of_id(id) }
    }

    pub fn occluder(&self, slot: u32) -> Option<Occluder> {
        let (object, polygon) = self.environment.locate(slot)?;
        let o = &self.environment.objects()[object as usize];
        Some(Occluder { slot, polygon_id: self.options.ids.id_of(o, polygon), object })
    }

    /// Places a feature in the image frame.
    pub fn in_image(&self, placed: &PlacedFeature) -> InImage {
        let points = placed.feature.shape.points();
        let reach = points.iter().map(|p| p.length()).fold(0.0, f64::max);
        let rounding = self.rounding(reach, placed.object);
        let (points, image_from_object) = (self.in_image_of(points, placed.object), self.image_from(placed.object).0);
        InImage { points, image_from_object, rounding }
    }

    /// Points of an object's frame, or of the world, in the image frame.
    pub fn in_image_of(&self, points: &[DVec3], object: Option<u32>) -> Vec<DVec3> {
        let (turn, shift) = self.image_from(object);
        let place = |p: &DVec3| match object {
            // Subtract the sensor's position first to keep precision.
            None => turn * (*p - self.world_from_sensor.translation),
            Some(_) => turn * *p + shift,
        };
        points.iter().map(place).collect()
    }

    /// Rotation and translation from the frame of an object, or of the world, to the image frame.
    pub fn image_from(&self, object: Option<u32>) -> (DMat3, DVec3) {
        match object {
            None => (self.image_from_world, self.image_from_world * -self.world_from_sensor.translation),
            Some(object) => {
                let FrameInImage { turn, shift, .. } = self.frame_of(object);
                (*turn, *shift)
            }
        }
    }

    fn frame_of(&self, object: u32) -> &FrameInImage {
        self.frames[object as usize].get_or_init(|| {
            let pose = &self.environment.objects()[object as usize].world_from_object;
            let apart = pose.translation - self.world_from_sensor.translation;
            let turn = self.image_from_world * pose.rotation_matrix();
            FrameInImage { turn, shift: self.image_from_world * apart, apart: apart.length() }
        })
    }

    /// Rounding error bound (image frame, metres) of points at most `reach` metres from the origin of an object.
    pub fn rounding(&self, reach: f64, object: Option<u32>) -> f64 {
        let size = object.map_or(0.0, |object| self.frame_of(object).apart);
        // Rounding of the sums, of the matrices, and of the world positions themselves.
        let far = self.world_from_sensor.translation.abs().max_element();
        f64::EPSILON * (8.0 * (reach + size) + 2.0 * far)
    }
}

fn slots_of_sources(environment: &Environment) -> HashMap<u32, u32> {
    let polygons = environment
        .objects()
        .iter()
        .flat_map(|o| (0..o.mesh.polygon_count() as u32).map(|p| (IdScheme::Source.id_of(o, p), o.first_slot + p)));
    polygons.collect()
}
