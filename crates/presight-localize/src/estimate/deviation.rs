//! The deviation of single points from the model's surfaces: the part of a frame's residuals that exceeds the sensor's noise.

/// Least deviation of a reading from its surface, noise included, metres, where the deviation is learnt: a finished wall may
/// be uneven by as much over 4 m (DIN 18202), and readings of one surface then err together. Without it a few surfaces that
/// agree by chance claim millimetres in a room that has changed.
pub(super) const LEAST: f64 = 0.01;
/// Largest residual that counts, standard deviations: things that were moved a little are seldom within it.
pub(super) const WITHIN: f64 = 2.0;
/// Variance of a standard normal variable that is truncated at [`WITHIN`].
const KEPT: f64 = 0.774;
/// A frame with fewer points teaches nothing.
const FEWEST: f64 = 30.0;
/// Part of the frames before that is forgotten in each, as of the offsets of polygons.
const FORGET: f64 = 0.1;

/// What the residuals of one frame say about the deviation, at the best pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SeenDeviation {
    /// Weighted sum of the squares that are beyond noise, square metres.
    excess: f64,
    /// Sum of the weights.
    weight: f64,
    /// Number of points.
    points: f64,
}

impl SeenDeviation {
    /// Takes in a residual, metres, that is within [`WITHIN`] standard deviations. `noise` is the variance of the measurement
    /// alone, `variance` the present one of the residual, square metres.
    pub(super) fn add_point(&mut self, e: f64, noise: f64, variance: f64) {
        // The variance of a square is proportional to the square of its mean.
        let weight = 1.0 / (variance * variance);
        self.excess += weight * (e * e / KEPT - noise);
        self.weight += weight;
        self.points += 1.0;
    }

    /// Adds the sums of other points.
    pub fn add(&mut self, other: &Self) {
        self.excess += other.excess;
        self.weight += other.weight;
        self.points += other.points;
    }
}

/// The variance of surfaces about their place in the model, learnt frame by frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct SurfaceVariance {
    /// Square metres, without bias: below 0 as noise has it.
    variance: f64,
    /// Number of frames behind it; the initial value counts as one.
    frames: f64,
}

impl SurfaceVariance {
    /// Begins with a usual deviation, metres.
    pub fn of_sigma(sigma: f64) -> Self {
        Self { variance: sigma * sigma, frames: 1.0 }
    }

    /// Standard deviation of the points, metres. What the polygons of a plane share is in it, too: points are weighed without
    /// that.
    pub fn sigma(&self) -> f64 {
        self.variance.max(0.0).sqrt()
    }

    /// Takes in what a frame says at a pose that is the robot's.
    pub fn learn(&mut self, seen: &SeenDeviation) {
        if seen.points < FEWEST {
            return;
        }
        let gain = (1.0 / (1.0 + self.frames)).max(FORGET);
        self.variance += gain * (seen.excess / seen.weight - self.variance);
        self.frames += 1.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::random::SplitMix64;

    /// 120 frames of 300 points with 1 cm of noise, of surfaces that are off by `truth`; a share of the points is of something that
    /// is up to 30 cm away.
    fn learnt(truth: f64, moved: f64) -> f64 {
        let (mut random, noise) = (SplitMix64(7), 1e-4);
        let mut surfaces = SurfaceVariance::of_sigma(0.03);
        for _ in 0..120 {
            let variance = noise + surfaces.variance.max(0.0);
            let mut seen = SeenDeviation::default();
            for _ in 0..300 {
                let own = random.normal(noise.sqrt().hypot(truth));
                let e = if random.unit() < moved { 0.6 * (random.unit() - 0.5) } else { own };
                if e * e <= WITHIN * WITHIN * variance {
                    seen.add_point(e, noise, variance);
                }
            }
            surfaces.learn(&seen);
        }
        surfaces.sigma()
    }

    /// By hand, without a deviation: 3 % of the points within the gate are of things that were moved, which leaves 1.5 mm, and the 19
    /// frames that count leave 1.3 mm of noise, one standard deviation. After 60 frames 2 mm of the 3 cm at the start were left, too.
    #[test]
    fn a_deviation_is_learnt_from_residuals() {
        for truth in [0.0, 0.02, 0.05] {
            for moved in [0.0, 0.3] {
                let found = learnt(truth, moved);
                assert!((found - truth).abs() < 0.003 + 0.15 * truth, "{found} instead of {truth}, {moved} moved");
            }
        }
        let mut few = SeenDeviation::default();
        (0..20).for_each(|_| few.add_point(0.0, 1e-4, 1e-4));
        let mut surfaces = SurfaceVariance::of_sigma(0.03);
        surfaces.learn(&few);
        assert!((surfaces.sigma() - 0.03).abs() < 1e-12, "20 points teach nothing");
    }
}
