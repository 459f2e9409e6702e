//! Uploads for the boxes of one prediction, computed without a device. Points and square roots of covariances are
//! computed in f64, rotated into the image frame, and rounded once.

use crate::gpu::layout::GridKind;
use bytemuck::{Pod, Zeroable};
use glam::{DMat3, DVec3};
use presight_features::roi::{BodyPoint, ERRORS, FeatureErrorModel, KIND, Projection};
use presight_features::{BoxFrame, BoxMethod, BoxScratch, FeaturePrediction, ImageKind, PlacedFeature};

/// Maximum points of a feature on the device; larger features go to the CPU. `POINTS` in roi.wgsl.
pub(in crate::gpu) const MAX_POINTS: usize = 16;

/// `RoiParams` in roi.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(in crate::gpu) struct RoiParams {
    pub sensor: [[f32; 4]; 2 * KIND],
    pub by: [f32; 2],
    pub size: [f32; 2],
    pub turn: f32,
    pub log_fail: f32,
    pub lowest: f32,
    pub first: f32,
    pub highest: f32,
    pub margin: f32,
    pub bent: f32,
    pub much: f32,
    pub slightly: f32,
    pub slight: f32,
    pub tail_steps: f32,
    pub feature_count: u32,
}

/// `RoiFeature` in roi.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(in crate::gpu) struct RoiFeature {
    pub origin: [f32; 3],
    pub first_point: u32,
    pub points: u32,
    pub first_column: u32,
    pub object_columns: u32,
    pub columns: u32,
}

/// `RoiPoint` in roi.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(in crate::gpu) struct RoiPoint {
    pub p: [f32; 3],
    pub share: f32,
    pub at: [f32; 2],
    pub other_share: f32,
    pub spread: f32,
}

/// `RoiBox` in roi.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(in crate::gpu) struct RoiBox {
    pub bounds: [f32; 4],
    pub deviations: f32,
    pub flag: u32,
    pub padding: [u32; 2],
}

/// Uploads of one prediction's boxes; the buffers are reused.
#[derive(Default)]
pub(in crate::gpu) struct RoiPlan {
    pub params: RoiParams,
    pub features: Vec<RoiFeature>,
    pub points: Vec<RoiPoint>,
    /// Two columns of four numbers per error; the last number is 0.
    pub columns: Vec<[f32; 4]>,
    /// For each feature on the device, its index in the prediction.
    pub on_device: Vec<u32>,
    /// Indices of the visible features that go to the CPU from the start.
    pub on_host: Vec<u32>,
}

impl RoiPlan {
    /// Computes the uploads and sets the features' covariances. Returns the kind of grid for the shader, or `None` if
    /// it does not support the sensor's projection; all features then go to the CPU.
    pub fn fill(
        &mut self,
        frame: &BoxFrame<'_>,
        prediction: &mut FeaturePrediction,
        placed: &[PlacedFeature],
    ) -> Option<GridKind> {
        self.features.clear();
        self.points.clear();
        self.columns.clear();
        self.on_device.clear();
        self.on_host.clear();
        let known = match frame.image.kind {
            _ if frame.method != BoxMethod::AsNeeded => None,
            ImageKind::Pinhole(by) => Some((GridKind::Camera, by)),
            ImageKind::Beams(by) => Some((GridKind::Scanner, by)),
            _ => None,
        };
        let mut room = BoxScratch::default();
        for i in 0..prediction.features.len() {
            let placed = &placed[prediction.given_at(i)];
            let seen = &mut prediction.features[i];
            // Invisible features need no box.
            if seen.visible.is_empty() {
                continue;
            }
            let uncertain = frame.uncertain(placed);
            if !frame.prepare(seen, &uncertain, &mut room) {
                continue;
            }
            if known.is_some() && self.add(frame, &uncertain, &room.points) {
                self.on_device.push(i as u32);
            } else {
                self.on_host.push(i as u32);
            }
        }
        let (kind, by) = known?;
        self.params = params(frame, by, self.features.len() as u32);
        Some(kind)
    }

    /// Returns false if the feature does not suit the device: too many points, or a point outside the image.
    fn add(&mut self, frame: &BoxFrame<'_>, uncertain: &FeatureErrorModel, points: &[BodyPoint]) -> bool {
        let (image, turn) = (&frame.image, frame.image.image_from_body);
        let first_point = self.points.len();
        let mut first = None;
        for point in points.iter().take(MAX_POINTS + 1) {
            let placed = uncertain.nominal(point);
            let Some(mut at) = image.project(placed.p).filter(|_| points.len() <= MAX_POINTS) else {
                self.points.truncate(first_point);
                return false;
            };
            let (column, _) = *first.get_or_insert((at[0], placed.q));
            if let Some(columns) = image.turn() {
                at[0] -= columns * ((at[0] - column) / columns).round();
            }
            self.points.push(RoiPoint {
                p: (turn * placed.p).as_vec3().to_array(),
                share: placed.shares[0] as f32,
                at: at.map(|x| x as f32),
                other_share: placed.shares[1] as f32,
                spread: uncertain.spread(&placed) as f32,
            });
        }
        let Some((_, origin)) = first else { return false };
        let first_column = self.columns.len() as u32 / 2;
        let object_columns = self.add_columns(uncertain, KIND..2 * KIND, turn, Some(origin));
        let end_columns = self.add_columns(uncertain, 2 * KIND..ERRORS, turn, None);
        self.features.push(RoiFeature {
            origin: (turn * origin).as_vec3().to_array(),
            first_point: first_point as u32,
            points: points.len() as u32,
            first_column,
            object_columns,
            columns: object_columns + end_columns,
        });
        true
    }

    /// Adds the nonzero columns of some errors; `about` moves the reference point of pose errors.
    fn add_columns(
        &mut self,
        uncertain: &FeatureErrorModel,
        of: std::ops::Range<usize>,
        turn: DMat3,
        about: Option<DVec3>,
    ) -> u32 {
        let before = self.columns.len();
        for i in of {
            let [mut first, second] = uncertain.pair(i);
            if let Some(about) = about {
                first += second.cross(about);
            }
            if [first, second] != [DVec3::ZERO; 2] {
                self.columns.extend([first, second].map(|v| four(turn * v)));
            }
        }
        (self.columns.len() - before) as u32 / 2
    }
}

fn four(v: DVec3) -> [f32; 4] {
    v.as_vec3().extend(0.0).to_array()
}

fn params(frame: &BoxFrame<'_>, by: [f64; 2], feature_count: u32) -> RoiParams {
    use presight_features::roi::{BENT, MARGIN, MUCH, SLIGHT, SLIGHTLY};
    let (image, level) = (&frame.image, &frame.level);
    let (width, height) = image.size();
    let mut sensor = [[0.0; 4]; 2 * KIND];
    for i in 0..KIND {
        let [first, second] = frame.viewpoint.pair(i);
        sensor[2 * i] = four(image.image_from_body * first);
        sensor[2 * i + 1] = four(image.image_from_body * second);
    }
    RoiParams {
        sensor,
        by: by.map(|x| x as f32),
        size: [width as f32, height as f32],
        turn: image.turn().unwrap_or(0.0) as f32,
        log_fail: level.fail.ln() as f32,
        lowest: level.lowest as f32,
        first: level.first as f32,
        highest: level.highest as f32,
        margin: MARGIN as f32,
        bent: BENT as f32,
        much: MUCH as f32,
        slightly: SLIGHTLY as f32,
        slight: SLIGHT as f32,
        tail_steps: presight_model::statistics::TAIL_STEPS as f32,
        feature_count,
    }
}
