//! What a user may need to state of an estimate, and what goes with a kind of sensor.

use super::normal::Freedom;
use presight_model::sensor::{Geometry, Sensor};

/// How an [`super::Estimator`] works.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct EstimateOptions {
    /// Which numbers of the pose are estimated.
    pub freedom: Freedom,
    /// Share of the measured points that the right pose has to explain.
    pub least_explained: f64,
    /// Most full predictions of an estimate.
    pub most_predictions: usize,
    /// How far polygons may be off along their normals, one standard deviation, metres. It is each point's own.
    pub model_sigma: f64,
    /// `model_sigma` is what learning begins with: a localizer learns it from the residuals of the frames that it tracks.
    pub learns_sigma: bool,
    /// Standard deviation of the offsets that polygons of one plane share, metres, until it is learnt.
    pub offset_sigma: f64,
    /// A direction is weak where the measurement alone is looser, metres.
    pub loosest: f64,
    /// Only the surfaces of this object count, by its index: the pose then holds as if the object stood where the model has it, and
    /// [`crate::estimate::Estimate::relative_to`] returns it in the object's own frame, for docking.
    pub only: Option<u32>,
}

impl Default for EstimateOptions {
    fn default() -> Self {
        Self {
            freedom: Freedom::Full,
            least_explained: 0.75,
            most_predictions: 12,
            model_sigma: 0.0,
            learns_sigma: false,
            offset_sigma: 0.003,
            loosest: 0.5,
            only: None,
        }
    }
}

presight_model::with_options!(
    EstimateOptions:
    with_freedom freedom: Freedom,
    with_least_explained least_explained: f64,
    with_most_predictions most_predictions: usize,
    with_learns_sigma learns_sigma: bool,
    with_offset_sigma offset_sigma: f64,
    with_loosest loosest: f64,
    with_only only: Option<u32>,
);

impl EstimateOptions {
    /// For a level scanner of one row on a level floor. Plans and maps of buildings are off by centimetres, and a row meets much
    /// that they leave out.
    pub fn planar() -> Self {
        let (freedom, model_sigma) = (Freedom::Planar, 0.03);
        Self { freedom, model_sigma, offset_sigma: 0.02, least_explained: 0.5, ..Self::default() }
    }

    /// For scans of points all round, in maps made of such scans: leaves and wires are seen at other places each time, and much
    /// was hidden before.
    pub fn scan() -> Self {
        Self { model_sigma: 0.1, offset_sigma: 0.02, least_explained: 0.5, ..Self::default() }
    }

    /// With a deviation of polygons that is stated, metres: it is not learnt.
    #[must_use]
    pub fn with_model_sigma(self, model_sigma: f64) -> Self {
        Self { model_sigma, learns_sigma: false, ..self }
    }

    /// The options for a kind of sensor: `indoor_scanner`, `depth_camera` or `lidar_3d`.
    pub fn preset(name: &str) -> Option<Self> {
        Preset::ALL.into_iter().find(|preset| preset.name() == name).map(Preset::options)
    }

    /// The options that go with a sensor.
    pub fn of(sensor: &Sensor) -> Self {
        Preset::of(sensor).options()
    }

    /// With a deviation of the model that is stated by a user, if any.
    #[must_use]
    pub fn with_stated_sigma(self, sigma: Option<f64>) -> Self {
        let Some(sigma) = sigma else { return self };
        // The offset shared by the polygons of one plane is about as large as the offset of each polygon.
        self.with_model_sigma(sigma).with_offset_sigma((0.7 * sigma).max(1e-3))
    }
}

/// Kinds of sensors, each with its options.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Preset {
    /// A level scanner of one row on a level floor.
    IndoorScanner,
    /// A depth camera, or a scanner of some rows, in any pose.
    DepthCamera,
    /// Scans of points all round, in maps of such scans.
    Lidar3d,
}

impl Preset {
    const ALL: [Self; 3] = [Self::IndoorScanner, Self::DepthCamera, Self::Lidar3d];

    /// The name in commands.
    fn name(self) -> &'static str {
        match self {
            Self::IndoorScanner => "indoor_scanner",
            Self::DepthCamera => "depth_camera",
            Self::Lidar3d => "lidar_3d",
        }
    }

    /// That of a sensor.
    pub fn of(sensor: &Sensor) -> Self {
        match sensor.spec().geometry {
            Geometry::Scanner(_) if sensor.height() == 1 => Self::IndoorScanner,
            Geometry::Rays(_) => Self::Lidar3d,
            _ => Self::DepthCamera,
        }
    }

    /// The options of an estimator.
    fn options(self) -> EstimateOptions {
        match self {
            Self::IndoorScanner => EstimateOptions::planar(),
            Self::DepthCamera => EstimateOptions::default(),
            Self::Lidar3d => EstimateOptions::scan(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stated_sigma_replaces_both_deviations() {
        let planar = Preset::IndoorScanner.options();
        assert_eq!(planar.with_stated_sigma(None), planar);
        let stated = planar.with_stated_sigma(Some(0.1));
        assert!((stated.model_sigma - 0.1).abs() < 1e-12 && (stated.offset_sigma - 0.07).abs() < 1e-12);
        assert_eq!(planar.with_stated_sigma(Some(0.0)).offset_sigma, 1e-3);
    }
}
