//! The pixels of another drive after an update: how many wrong ones are right now, and how many right ones it made
//! wrong.

use super::case::Case;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_render::plan::{Images, Output, Outputs};
use presight_update::{FindingKind, SiteFindings};

/// Ranges that differ by no more are the same, metres.
const SAME: f64 = 0.1;
/// Views of the drive that judges.
const VIEWS: usize = 60;

/// Counts of pixels.
#[derive(Clone, Copy, Debug, Default)]
pub struct Right {
    /// Pixels in which model and site differ, and how many are right after the update.
    pub differ: usize,
    pub mended: usize,
    /// All other pixels, and how many the update made wrong, provisional boxes apart.
    pub others: usize,
    pub spoilt: usize,
}

impl Right {
    pub fn add(&mut self, other: &Self) {
        (self.differ, self.mended) = (self.differ + other.differ, self.mended + other.mended);
        (self.others, self.spoilt) = (self.others + other.others, self.spoilt + other.spoilt);
    }

    pub fn row(&self, name: &str) -> String {
        let percent = |a: usize, b: usize| 100.0 * a as f64 / b.max(1) as f64;
        format!(
            "| {name} | {:.1} % of {} | {:.3} % of {} |",
            percent(self.mended, self.differ),
            self.differ,
            percent(self.spoilt, self.others),
            self.others
        )
    }
}

fn after(map: &World, findings: &SiteFindings, with_boxes: bool) -> World {
    let mut after = map.clone();
    let counts = |kind: &FindingKind| with_boxes || !matches!(kind, FindingKind::New(_));
    let changes = findings.changes.iter().filter(|finding| counts(&finding.kind));
    changes.for_each(|finding| drop(after.apply_unchecked(finding.change(&after))));
    after
}

/// Counts the pixels of a sensor on another way through the site.
pub fn count(case: &Case, sensor: &Sensor, findings: &SiteFindings, seed: u64) -> Right {
    let other = case.on_another_way(seed + 100, VIEWS);
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).expect("a predictor");
    let worlds =
        [case.map.clone(), case.site.clone(), after(&case.map, findings, true), after(&case.map, findings, false)];
    let mut right = Right::default();
    for k in 0..VIEWS {
        let pose: Pose = other.route.at(0.5 * k as f64) * sensor.spec().mount;
        let ranges = worlds.each_ref().map(|world| {
            let mut images = Images::default();
            let range = Outputs::of(&[Output::Range]);
            predictor.predict_images(world, sensor, &SensorPose::new(pose), range, &mut images).expect("a prediction");
            images.range
        });
        let same = |a: f32, b: f32| a == b || (f64::from(a) - f64::from(b)).abs() <= SAME;
        for i in 0..ranges[0].len() {
            let [map, site, with, without] = ranges.each_ref().map(|range| range[i]);
            if same(map, site) {
                right.others += 1;
                right.spoilt += usize::from(!same(without, site));
            } else {
                right.differ += 1;
                right.mended += usize::from(same(with, site));
            }
        }
    }
    right
}
