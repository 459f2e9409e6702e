//! The start of a drive and the options of its estimates: flags are checked and become options of the library.

use super::{Drive, watching};
use crate::pose::parse_pose;
use indicatif::ProgressBar;
use presight::files::Observation;
use presight::localize::{ErrorRates, EstimateOptions, Estimator, LocalizeOptions, Localizer, Search, SearchOptions};
use presight::measured::OdometryNoise;
use presight::{Error, Pose, PoseEstimate, Result, RobotPose, Scene, Sensor};

impl Drive {
    /// Checks the values of the flags without opening any file.
    pub(super) fn check(&self) -> Result<()> {
        if self.from.is_some_and(f64::is_nan) {
            return Err(Error::usage("--from NaN", "give seconds"));
        }
        for (flag, sigma) in [("--init-sigma", self.init_sigma), ("--init-sigma-deg", self.init_sigma_deg)] {
            if !(sigma > 0.0 && sigma.is_finite()) {
                return Err(Error::usage(format!("{flag} {sigma}"), "give a finite deviation above 0"));
            }
        }
        if !(self.init_odds > 1.0 && self.init_odds.is_finite()) {
            return Err(Error::usage(
                format!("--init-odds {}", self.init_odds),
                "give finite odds above 1, such as 10000",
            ));
        }
        if let Some(sigma) = self.model_sigma.filter(|sigma| !(*sigma >= 0.0 && sigma.is_finite())) {
            return Err(Error::usage(format!("--model-sigma {sigma}"), "give finite metres of at least 0"));
        }
        self.odometry()?;
        self.search()?;
        self.given_start().map(drop)
    }

    /// The pose of `--init`; `None` for a word.
    fn given_start(&self) -> Result<Option<RobotPose>> {
        match self.init.as_deref() {
            None | Some("unknown" | "reference") => Ok(None),
            Some(pose) => parse_pose(pose).map(RobotPose::new).map(Some).map_err(|e| e.at(format!("--init {pose}"))),
        }
    }

    /// The start pose; `None` for `--init unknown`.
    pub(super) fn start(&self, first: &Observation) -> Result<Option<RobotPose>> {
        if self.init.as_deref() != Some("reference") {
            return self.given_start();
        }
        first.reference.map(Some).ok_or_else(|| {
            Error::usage("--init reference: the log has no poses", "give x,y,z,roll_deg,pitch_deg,yaw_deg")
        })
    }

    pub(super) fn localizer(
        &self,
        mut estimator: Estimator,
        start: Option<RobotPose>,
        scene: &Scene,
        sensor: &Sensor,
        progress: &ProgressBar,
    ) -> Result<Localizer> {
        let rates = ErrorRates { wrong_start: 1.0 / self.init_odds, ..ErrorRates::default() };
        let options = LocalizeOptions::default().with_rates(rates).with_search_starts(usize::from(self.search_starts));
        let Some(start) = start else {
            let mut watch = watching(progress);
            let search = Search::watched(&mut estimator, &scene.world, sensor, self.search()?, &mut watch);
            return Ok(Localizer::unknown(estimator, search.map_err(|e| e.at("--init unknown"))?, options));
        };
        let prior = PoseEstimate::of_sigmas(start, self.init_sigma, self.init_sigma_deg.to_radians());
        Ok(Localizer::new(estimator, prior, options))
    }

    fn search(&self) -> Result<SearchOptions> {
        let [roll, pitch] = self.lean[..] else {
            return Err(Error::usage("--lean", "give roll and pitch in degrees, as in --lean 0,20"));
        };
        let lean = [roll.to_radians(), pitch.to_radians()];
        let floor_to = self.floor_to.unwrap_or(self.floor);
        let (floor, margin, surrounded) = (self.floor, self.margin, self.surrounded);
        for (flag, value, is_sound, remedy) in [
            ("--lean", roll, roll.is_finite(), "give finite degrees"),
            ("--lean", pitch, pitch.is_finite(), "give finite degrees"),
            ("--floor", floor, floor.is_finite(), "give finite metres"),
            ("--floor-to", floor_to, floor_to.is_finite(), "give finite metres"),
            ("--margin", margin, margin >= 0.0 && margin.is_finite(), "give finite metres of at least 0"),
            ("--surrounded", surrounded, (0.0..=1.0).contains(&surrounded), "give a share of 0 to 1"),
        ] {
            if !is_sound {
                return Err(Error::usage(format!("{flag} {value}"), remedy));
            }
        }
        Ok(SearchOptions::default()
            .with_floor(floor)
            .with_floor_to(floor_to)
            .with_margin(margin)
            .with_lean(lean)
            .with_surrounded(surrounded))
    }

    /// Options for a search of the whole map at the last height of the robot.
    pub(super) fn search_about(&self, pose: &Pose) -> Result<SearchOptions> {
        let height = pose.translation.z;
        Ok(self.search()?.with_floor(height).with_floor_to(height))
    }

    pub(super) fn odometry(&self) -> Result<OdometryNoise> {
        let part = self.odometry_sigma;
        if !(part >= 0.0 && part.is_finite()) {
            return Err(Error::usage(format!("--odometry-sigma {part}"), "give a finite fraction of at least 0"));
        }
        Ok(OdometryNoise::default().with_distance(part).with_turn(part).with_turn_per_distance(0.5 * part))
    }

    /// Estimator options by --preset, or by the sensor.
    pub fn options(&self, sensor: &Sensor) -> EstimateOptions {
        let preset = self.preset.as_deref().and_then(EstimateOptions::preset);
        let options = preset.unwrap_or_else(|| EstimateOptions::of(sensor));
        options.with_learns_sigma(self.learns_sigma).with_stated_sigma(self.model_sigma)
    }
}
