//! The next phase: whether a robot that is followed is lost, and whether frames that agree are enough.

use super::{COARSE, Localizer, Phase};
use crate::estimate::{Estimate, EstimateState};
use crate::verdict::{Verdict, Verdicts};

impl Localizer {
    /// Whether what was usual no longer is. A coarse model leaves much out: there only what it has and is not there counts.
    fn alarm(&mut self, estimate: &Estimate) -> Option<String> {
        let changed = tells_of_surfaces(estimate) && self.standing.add(share(standing(estimate)));
        let unexplained = self.explained.add(estimate.explained);
        if changed {
            let usual = &self.standing;
            return Some(format!("the share of surfaces that are still there has left its distribution ({usual})"));
        }
        if self.is_coarse() {
            self.explained.restart();
            return None;
        }
        let usual = &self.explained;
        unexplained.then(|| format!("the share of explained points has left its distribution ({usual})"))
    }

    pub(super) fn is_coarse(&self) -> bool {
        self.estimator.options.model_sigma >= COARSE
    }

    /// Why a frame may fit by chance, together with those that agreed before it.
    fn disagrees(&mut self, estimate: &Estimate) -> Option<String> {
        let (confirmed, decided) = standing(estimate);
        self.agreed += 1;
        self.agreed_shares += estimate.explained;
        self.agreed_points.0 += confirmed;
        self.agreed_points.1 += decided;
        let standing = share(self.agreed_points);
        if tells_of_surfaces(estimate) && standing < self.options.least_standing {
            return Some(format!("{:.0} % of the surfaces are not where the map has them", 100.0 * (1.0 - standing)));
        }
        if estimate.explained < self.options.least_agreeing {
            return Some("that is too little to tell a place by".to_owned());
        }
        let (mean, least) = (self.agreed_shares / self.agreed as f64, self.least_anew());
        let too_little = self.is_anew && self.agreed >= self.agreeing() && mean < least;
        let percent = |x: f64| (100.0 * x).round();
        too_little.then(|| {
            let frames = self.agreed;
            format!("{frames} frames explain {} % in the mean, less than {} %", percent(mean), percent(least))
        })
    }

    /// Frames in a row that have to agree. A coarse model explains frames from elsewhere, too, and nothing speaks for a pose that is found
    /// anew but these frames: as many as after an unknown start.
    fn agreeing(&self) -> usize {
        let super::LocalizeOptions { agreeing, least_frames, .. } = self.options;
        if self.is_anew || self.is_coarse() { agreeing.max(least_frames) } else { agreeing }
    }

    /// What a pose that is found anew has to explain: as much as one after an unknown start, or what was usual before.
    fn least_anew(&self) -> f64 {
        self.options.least_found.min(self.explained.least_usual().unwrap_or(f64::INFINITY))
    }

    fn restart_agreement(&mut self) {
        (self.agreed, self.agreed_shares, self.agreed_points) = (0, 0.0, (0, 0));
        self.is_anew = true;
    }

    /// For a robot that is followed from now on, with what was explained where it was found, and how many of the surfaces that were decided
    /// on were confirmed.
    pub(super) fn restart_tests(&mut self, explained: f64, standing: (usize, usize)) {
        (self.is_anew, self.disagreed, self.tracked, self.followed) = (false, 0, 0, None);
        self.explained.restart();
        self.explained.begin_with(explained);
        self.standing.restart();
        if standing.1 > 0 {
            self.standing.begin_with(share(standing));
        }
    }

    /// The next phase, and why. One frame that a coarse model does not explain speaks not against a pose that was given: there are places of
    /// which it has nothing right.
    pub(super) fn decide(&mut self, estimate: &Estimate) -> String {
        let explained = format!("{:.0} % explained", 100.0 * estimate.explained);
        let why = match &estimate.state {
            EstimateState::Determined => explained,
            EstimateState::Undetermined(why) => why.clone(),
        };
        match self.phase {
            Phase::Tracking => match self.alarm(estimate) {
                Some(alarm) => {
                    self.phase = Phase::Lost;
                    self.restart_agreement();
                    self.followed = (self.tracked >= self.options.patience).then_some(self.belief);
                    format!("{why}; {alarm}")
                }
                None => {
                    self.tracked += 1;
                    why
                }
            },
            Phase::Lost | Phase::Unknown | Phase::Candidates if estimate.is_determined() => {
                if let Some(but) = self.disagrees(estimate) {
                    self.disagreed += 1;
                    let given = self.is_coarse() && !self.is_anew && self.disagreed < self.options.patience;
                    self.restart_agreement();
                    self.is_anew = !given;
                    self.phase = if given { Phase::Candidates } else { Phase::Unknown };
                    return format!("{why}; {but}");
                }
                let agreeing = self.agreeing();
                if self.agreed >= agreeing {
                    self.phase = Phase::Tracking;
                    self.restart_tests(self.agreed_shares / self.agreed as f64, self.agreed_points);
                    return format!("{why}; {} frames in a row agree", self.agreed);
                }
                self.phase = Phase::Candidates;
                format!("{why}; {} of {agreeing} frames agree", self.agreed)
            }
            Phase::Lost | Phase::Unknown | Phase::Candidates => {
                self.restart_agreement();
                self.phase = Phase::Unknown;
                why
            }
        }
    }
}

/// False for grey images alone: they do not say which surfaces are there.
fn tells_of_surfaces(estimate: &Estimate) -> bool {
    estimate.findings.is_empty() || !estimate.verdicts.is_empty()
}

/// How many measured surfaces are where the map has them, and how many are decided on.
pub(super) fn standing(estimate: &Estimate) -> (usize, usize) {
    let counts = estimate.verdicts.iter().map(Verdicts::counts);
    counts.fold((0, 0), |(confirmed, decided), n| {
        let c = n[Verdict::Confirmed as usize];
        (confirmed + c, decided + c + n[Verdict::Farther as usize])
    })
}

fn share((part, whole): (usize, usize)) -> f64 {
    if whole > 0 { part as f64 / whole as f64 } else { 0.0 }
}
