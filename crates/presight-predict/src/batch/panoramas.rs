//! Stored panoramas of many places: measured images are weighed at all of them without another prediction.

use super::BatchRequest;
use super::headings::{HeadingWeights, Headings, Panorama};
use super::likelihood::RangeLikelihood;
use crate::predict::Predictor;
use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::memory;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_render::cpu::CpuEngine;
use presight_render::plan::{FramePlan, Images, Output, Outputs, PlanBuffers, Stats};
use presight_render::row::{Making, is_row};
use rayon::prelude::*;

/// Full-turn views of a level scanner at places in one version of a world.
#[derive(Clone, Debug)]
pub struct Panoramas {
    headings: Headings,
    places: Vec<DVec3>,
    /// Place by place.
    range: Vec<f32>,
    cos_incidence: Vec<f32>,
}

impl Predictor {
    /// Predicts and stores the panorama of `headings` at places of the sensor, all at one height: eight bytes per beam.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for places at several heights; [`presight_model::ErrorKind::System`] if
    /// there is no memory for them; the errors of [`Predictor::predict_images`].
    #[doc(hidden)]
    pub fn panoramas(&mut self, world: &World, headings: &Headings, places: Vec<DVec3>) -> Result<Panoramas> {
        let sensor = headings.panorama();
        let beams = sensor.width() as usize * sensor.height() as usize;
        let (mut range, mut cos_incidence) =
            (memory::reserved(places.len() * beams)?, memory::reserved(places.len() * beams)?);
        let level = |place: DVec3| Pose { translation: place, ..Pose::IDENTITY };
        let outputs = Outputs::of(&[Output::Range, Output::CosIncidence]);
        let first = places.first().filter(|_| is_row(sensor));
        if first.is_some_and(|first| places.iter().any(|p| p.z != first.z)) {
            return Err(Error::usage("the places have several heights", "give the places of one height at a time"));
        }
        let cut = first.and_then(|first| self.row_cuts().get(world, sensor, &level(*first), Making::AtOnce));
        if let Some(cut) = cut.filter(|cut| places.iter().all(|p| cut.serves(p.truncate()))) {
            let cpu = CpuEngine::new(self.task_threads()?)?;
            let see = |engine: &mut CpuEngine, place: &DVec3| {
                let (mut images, buffers) = (Images::default(), PlanBuffers::default());
                let plan = FramePlan::by_cut(buffers, world, sensor, &level(*place), outputs.into(), cut.clone());
                engine.render(&plan, &mut images, &mut Stats::default())?;
                Ok((images.range, images.cos_incidence))
            };
            let all: Result<Vec<_>> =
                self.on_threads(|| places.par_iter().map_init(|| cpu.on_one_thread(), see).collect())?;
            for (r, c) in all? {
                range.extend(r);
                cos_incidence.extend(c);
            }
        } else {
            let mut images = Images::default();
            for place in &places {
                self.predict_images(world, sensor, &SensorPose::new(level(*place)), outputs, &mut images)?;
                range.extend_from_slice(&images.range);
                cos_incidence.extend_from_slice(&images.cos_incidence);
            }
        }
        Ok(Panoramas { headings: headings.clone(), places, range, cos_incidence })
    }

    /// Ranges and cosines of incidence of a sensor at poses, pose by pose.
    ///
    /// # Errors
    /// The errors of [`Predictor::predict_images`].
    pub fn range_views(&mut self, world: &World, sensor: &Sensor, poses: &[SensorPose]) -> Result<Vec<[Vec<f32>; 2]>> {
        let outputs = Outputs::of(&[Output::Range, Output::CosIncidence]);
        let request = BatchRequest { images: Some(outputs.into()), ..BatchRequest::default() };
        let items = self.batch(world, sensor, poses.iter().copied(), &request)?;
        items.map(|item| item.map(|item| [item.images.range, item.images.cos_incidence])).collect()
    }

    /// Log-likelihoods of a measured image at all headings of all places, place by place.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] if the image belongs to another sensor than the panoramas.
    #[doc(hidden)]
    pub fn weigh_panoramas(&mut self, panoramas: &Panoramas, sensed: &RangeLikelihood) -> Result<Vec<f32>> {
        if sensed.sensor() != panoramas.headings.sensor() {
            let what = "the measured image belongs to another sensor than the panoramas";
            return Err(Error::usage(what, "make both from one sensor"));
        }
        let weigher = HeadingWeights::new(&panoramas.headings, sensed);
        let beams = panoramas.beams();
        let one = |panorama: &mut Panorama, (range, cos): (&[f32], &[f32])| weigher.weigh(range, cos, panorama);
        let parts = panoramas.range.par_chunks(beams).zip(panoramas.cos_incidence.par_chunks(beams));
        let all: Vec<Vec<f32>> = self.on_threads(|| parts.map_init(Panorama::default, one).collect())?;
        Ok(all.concat())
    }
}

impl Panoramas {
    /// The headings of these panoramas.
    pub fn headings(&self) -> &Headings {
        &self.headings
    }

    /// The places of the sensor.
    pub fn places(&self) -> &[DVec3] {
        &self.places
    }

    /// Removes the places whose ranges `keep` rejects.
    pub fn retain(&mut self, keep: impl Fn(&[f32]) -> bool) {
        let beams = self.beams();
        let kept: Vec<usize> =
            (0..self.places.len()).filter(|k| keep(&self.range[k * beams..(k + 1) * beams])).collect();
        let pick =
            |values: &[f32]| kept.iter().flat_map(|k| values[k * beams..(k + 1) * beams].iter().copied()).collect();
        (self.range, self.cos_incidence) = (pick(&self.range), pick(&self.cos_incidence));
        self.places = kept.iter().map(|k| self.places[*k]).collect();
    }

    /// Adds the places of other panoramas of the same headings.
    pub fn append(&mut self, mut more: Self) {
        self.places.append(&mut more.places);
        self.range.append(&mut more.range);
        self.cos_incidence.append(&mut more.cos_incidence);
    }

    fn beams(&self) -> usize {
        let sensor = self.headings.panorama();
        sensor.width() as usize * sensor.height() as usize
    }
}
