//! Compares batches with single predictions and with a plain implementation of the formula.

#[cfg(feature = "gpu")]
mod device;
mod headings;
mod images;
mod likelihood;
mod logs;
mod oracle;
mod row;

use presight_testkit as common;

use presight_model::geometry::{Pose, SensorPose};
use presight_model::measured::{Frame, Measurement};
use presight_model::sensor::{Noise, Sensor};
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_render::plan::{Output, Outputs};

/// A predictor on the CPU engine.
fn predictor(threads: usize) -> Predictor {
    Predictor::new(Options::new(Backend::Cpu).with_threads(threads)).expect("threads start")
}

/// The sensor with another noise model, and with a finite range if it has none.
fn noisy(sensor: &Sensor, noise: Noise) -> Sensor {
    let spec = sensor.spec().clone();
    let range_max = if spec.range_max.is_finite() { spec.range_max } else { 100.0 };
    Sensor::new(spec.clone().with_limits(spec.range_min, range_max).with_noise(noise)).expect("a valid sensor")
}

/// A frame of ranges of a sensor.
fn frame_of(sensor: &Sensor, ranges: Vec<f32>) -> Frame {
    Frame::new(0.0, sensor.clone(), Measurement::Range(ranges)).expect("a valid scan")
}

/// The range and cos_incidence images of a single prediction.
fn single(predictor: &mut Predictor, world: &World, sensor: &Sensor, pose: &Pose) -> (Vec<f32>, Vec<f32>) {
    let outputs = Outputs::of(&[Output::Range, Output::CosIncidence]);
    let request = Request::of(outputs);
    let seen = predictor.predict(world, sensor, &SensorPose::new(*pose), &request).expect("it predicts");
    (seen.images.range, seen.images.cos_incidence)
}
