//! Rates a layer: how well its features determine a sensor's pose at each place, and which features suffice.
//!
//! At each free place of a grid, the sensor looks in eight directions. Each view sums the information of its visible
//! features about x, y and heading: J' J / s^2 per measured image coordinate, J its derivative, s^2 the variance of the
//! measurement plus the feature's position. The inverse bounds the covariance (Cramer-Rao); height, roll and pitch are
//! assumed known from the mount. A place is rated by the worst of its eight views.

use glam::DVec3;
use presight_features::{FeatureOptions, PlacedFeatures, Vantage, informations};
use presight_model::error::{Error, Result, short};
use presight_model::floor::{Footing, Mobility, height_below};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::index::QueryResult;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_model::{limits, memory};
use presight_predict::free_poses::{FREE_DISTANCE, is_clear};
use presight_predict::predict::Predictor;
use presight_predict::request::Request;
use presight_render::plan::{Output, Outputs};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Directions in which the sensor looks at each place.
pub const HEADINGS: u32 = 8;

/// Ratio of the information's determinant to the product of its diagonal below which a direction is undetermined.
const OPEN: f64 = 1e-12;

/// Minimum number of bytes of views in one check of the memory.
const CHECKED: u64 = 64 << 20;

/// Options for rating a layer.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct WorthOptions {
    /// Metres between the places of the grid.
    pub spacing: f64,
    /// Height of the robot's frame, metres. The sensor is higher by its mount's height.
    pub floor: f64,
}

impl Default for WorthOptions {
    fn default() -> Self {
        Self { spacing: 1.0, floor: 0.0 }
    }
}

/// A free place of the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorthPlace {
    /// World, metres.
    pub at: DVec3,
    /// Column and row of the grid: along x and along y.
    pub cell: [u32; 2],
    /// Minimum over the views of the number of visible features.
    pub features: usize,
    /// Maximum over the views of the standard deviation of the position, metres. Infinite if a view leaves a direction
    /// undetermined.
    pub position_sigma: f64,
    /// Maximum over the views of the standard deviation of the heading, radians.
    pub heading_sigma: f64,
}

/// Information of x, y and heading: xx, xy, xh, yy, yh, hh.
pub type Planar = [f64; 6];

/// The information of each feature that a view shows, with its index.
pub type View = Vec<(u32, Planar)>;

/// The free places of a grid: clear of polygons, with a floor all around below the robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// Columns and rows.
    pub size: [u32; 2],
    /// Column, row and position (world, metres) of each free place.
    pub places: Vec<([u32; 2], DVec3)>,
}

/// The views of the `placed` features by a sensor at a place, one for each heading.
///
/// # Errors
/// Those of [`Predictor::predict`].
pub fn views(
    world: &World,
    sensor: &Sensor,
    placed: &PlacedFeatures,
    at: DVec3,
    predictor: &mut Predictor,
    mut watch: impl FnMut(&View) -> Result<()>,
) -> Result<Vec<View>> {
    let outputs = Outputs::of(&[Output::PolygonId]);
    let request = Request::of(outputs).with_features(FeatureOptions::default().with_placed(placed.clone()));
    let mut views = Vec::with_capacity(HEADINGS as usize);
    for heading in 0..HEADINGS {
        let yaw = std::f64::consts::TAU * f64::from(heading) / f64::from(HEADINGS);
        let mount = Pose { translation: DVec3::ZERO, ..sensor.spec().mount };
        let pose = Pose::from_xyz_rpy(at, 0.0, 0.0, yaw) * mount;
        let seen = predictor.predict(world, sensor, &SensorPose::new(pose), &request)?.features.unwrap_or_default();
        let vantage = Vantage { world, sensor, world_from_sensor: &pose };
        let mut view: View = informations(&seen, &placed.features, &vantage)
            .into_iter()
            .map(|(i, m)| (seen.given_at(i) as u32, [m[0][0], m[0][1], m[0][5], m[1][1], m[1][5], m[5][5]]))
            .collect();
        // The list was collected in place, in an allocation five times as large.
        view.shrink_to_fit();
        watch(&view)?;
        views.push(view);
    }
    Ok(views)
}

impl WorthPlace {
    /// Rates a place by the worst of its views.
    pub fn of((cell, at): ([u32; 2], DVec3), views: &[View]) -> Self {
        let mut place = Self { at, cell, features: usize::MAX, position_sigma: 0.0, heading_sigma: 0.0 };
        for view in views {
            let [position, turn] = sigmas(&sum(view.iter().map(|(_, information)| information)));
            place.features = place.features.min(view.len());
            place.position_sigma = place.position_sigma.max(position);
            place.heading_sigma = place.heading_sigma.max(turn);
        }
        place
    }
}

/// The rating of a layer at the places of a grid.
#[derive(Clone, Debug)]
pub struct Worth {
    /// The free places, by row and column.
    pub places: Vec<WorthPlace>,
    /// Columns and rows of the grid.
    pub size: [u32; 2],
    /// Number of features in the layer.
    pub given: usize,
    views: Vec<View>,
}

/// The sufficient features of a layer.
#[derive(Clone, Debug, PartialEq)]
pub struct Thinned {
    /// By feature: true if it is kept.
    pub keep: Vec<bool>,
    /// Maximum relative growth of the standard deviation of the position.
    pub position_growth: f64,
    /// Maximum relative growth of the standard deviation of the heading.
    pub heading_growth: f64,
}

impl Worth {
    /// Predicts the features from every free place. Calls `watch` with the number of views done and the total.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for a spacing that is not positive, a grid of more than
    /// [`limits::MAX_WORTH_PLACES`] places, or a sensor without pixel noise; [`presight_model::ErrorKind::Invalid`] if
    /// no place is free; [`presight_model::ErrorKind::System`] if there is not enough memory for all views; errors of
    /// [`Predictor::predict`].
    pub fn of(
        world: &World,
        sensor: &Sensor,
        placed: &PlacedFeatures,
        options: &WorthOptions,
        predictor: &mut Predictor,
        mut watch: impl FnMut(usize, usize),
    ) -> Result<Self> {
        let grid = Grid::new(world, sensor, options)?;
        let mut worth = Self { places: Vec::new(), size: grid.size, given: placed.features.len(), views: Vec::new() };
        let count = grid.places.len() * HEADINGS as usize;
        let (mut held, mut granted, mut done) = (0, 0, 0);
        for place in grid.places {
            let views = views(world, sensor, placed, place.1, predictor, |view| {
                done += 1;
                held += size_of_val(&view[..]) as u64;
                if held > granted {
                    granted = 2 * held.max(CHECKED);
                    memory::require(granted).map_err(|e| e.at(format!("view {done} of {count}")))?;
                }
                watch(done, count);
                Ok(())
            })?;
            worth.places.push(WorthPlace::of(place, &views));
            worth.views.extend(views);
        }
        Ok(worth)
    }

    /// Drops features one at a time, each time the least informative one (at the view where it matters most), as long
    /// as no standard deviation of any view grows by more than the fraction `growth`. Views with an undetermined
    /// direction impose no condition. Features that no view shows are dropped.
    pub fn thinned(&self, growth: f64) -> Thinned {
        let mut of_feature: Vec<Vec<(u32, Planar)>> = vec![Vec::new(); self.given];
        for (number, view) in (0..).zip(&self.views) {
            for (feature, information) in view {
                // A contour appears as several curves, which are kept or dropped together.
                match of_feature[*feature as usize].last_mut().filter(|(before, _)| *before == number) {
                    Some((_, sum)) => (0..6).for_each(|i| sum[i] += information[i]),
                    None => of_feature[*feature as usize].push((number, *information)),
                }
            }
        }
        let mut sums: Vec<Planar> =
            self.views.iter().map(|view| sum(view.iter().map(|(_, information)| information))).collect();
        let before: Vec<[f64; 2]> = sums.iter().map(sigmas).collect();
        let holds = |now: &Planar, before: &[f64; 2]| {
            let now = sigmas(now);
            (0..2).all(|i| before[i].is_infinite() || now[i] <= before[i] * (1.0 + growth))
        };
        let share = |feature: usize, sums: &[Planar]| {
            let of_view = |(view, own): &(u32, Planar)| match inverse(&sums[*view as usize]) {
                Some(c) if before[*view as usize][0].is_finite() => product_trace(&c, own),
                _ => 0.0,
            };
            of_feature[feature].iter().map(of_view).fold(0.0, f64::max)
        };
        let mut keep = vec![false; self.given];
        // A feature's share only grows while others are dropped, so stale heap entries are lower bounds. Bits of
        // non-negative floats order like their values.
        let entry = |feature: usize, sums: &[Planar]| Reverse((share(feature, sums).to_bits(), feature));
        let mut heap: BinaryHeap<_> = (0..self.given).map(|feature| entry(feature, &sums)).collect();
        while let Some(Reverse((known, feature))) = heap.pop() {
            let now = entry(feature, &sums);
            if now.0.0 > known && heap.peek().is_some_and(|next| now < *next) {
                heap.push(now);
                continue;
            }
            let without =
                |(view, own): &(u32, Planar)| -> Planar { std::array::from_fn(|i| sums[*view as usize][i] - own[i]) };
            let fits = |of: &(u32, Planar)| holds(&without(of), &before[of.0 as usize]);
            if of_feature[feature].iter().all(fits) {
                let rest: Vec<(u32, Planar)> = of_feature[feature].iter().map(|of| (of.0, without(of))).collect();
                rest.into_iter().for_each(|(view, rest)| sums[view as usize] = rest);
            } else {
                keep[feature] = true;
            }
        }
        let reached = |i: usize| {
            let of_view = |(view, before): (&View, &[f64; 2])| {
                let now = sigmas(&sum(view.iter().filter(|(f, _)| keep[*f as usize]).map(|(_, own)| own)));
                if before[i].is_finite() { now[i] / before[i] - 1.0 } else { 0.0 }
            };
            self.views.iter().zip(&before).map(of_view).fold(0.0, f64::max)
        };
        let (position_growth, heading_growth) = (reached(0), reached(1));
        Thinned { keep, position_growth, heading_growth }
    }

    /// CSV with a line for each free place.
    pub fn csv(&self) -> String {
        let mut text = String::from("x,y,z,features,position_sigma_m,heading_sigma_deg\n");
        for p in &self.places {
            let degrees = p.heading_sigma.to_degrees();
            text += &format!("{},{},{},{},{},{degrees}\n", p.at.x, p.at.y, p.at.z, p.features, p.position_sigma);
        }
        text
    }

    /// A value for every place of the grid, row by row with rising y; NaN where no place is free.
    pub fn map(&self, value: impl Fn(&WorthPlace) -> f64) -> Vec<f64> {
        let mut map = vec![f64::NAN; self.size[0] as usize * self.size[1] as usize];
        for place in &self.places {
            map[place.cell[1] as usize * self.size[0] as usize + place.cell[0] as usize] = value(place);
        }
        map
    }
}

impl Grid {
    /// The free places of a world.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for a spacing that is not positive, a grid of more than
    /// [`limits::MAX_WORTH_PLACES`] places, or a sensor without pixel noise; [`presight_model::ErrorKind::Invalid`] if
    /// no place is free.
    pub fn new(world: &World, sensor: &Sensor, options: &WorthOptions) -> Result<Self> {
        if !(sensor.spec().noise.pixel_sigma > 0.0) {
            let what = format!("sensor {} states no pixel noise", sensor.spec().name);
            return Err(Error::usage(what, "set pixel_sigma in [noise]"));
        }
        grid(world, sensor, options)
    }
}

fn grid(world: &World, sensor: &Sensor, options: &WorthOptions) -> Result<Grid> {
    let WorthOptions { spacing, floor } = *options;
    if !(spacing > 0.0 && spacing.is_finite() && floor.is_finite()) {
        let what = format!("a grid every {} m at a height of {} m", short(spacing), short(floor));
        return Err(Error::usage(what, "give a spacing above 0 and a finite height"));
    }
    let bounds = world.environment().bounds();
    if bounds.is_empty() {
        return Err(Error::invalid("the world has no polygons", "give a scene with a floor"));
    }
    let count = ((bounds.max - bounds.min) / spacing).max(DVec3::ZERO).ceil();
    if !(count.x * count.y <= limits::MAX_WORTH_PLACES as f64) {
        let what = format!("a grid every {} m has {} places", short(spacing), short(count.x * count.y));
        return Err(Error::usage(
            what,
            format!("at most {} are allowed: give a wider spacing", limits::MAX_WORTH_PLACES),
        ));
    }
    let size = [count.x.max(1.0) as u32, count.y.max(1.0) as u32];
    let height = floor + sensor.spec().mount.translation.z;
    let (mut found, mut free) = (QueryResult::default(), Vec::new());
    for row in 0..size[1] {
        for column in 0..size[0] {
            let at = |min: f64, n: u32| min + (f64::from(n) + 0.5) * spacing;
            let place = DVec3::new(at(bounds.min.x, column), at(bounds.min.y, row), height);
            if is_clear(world, place, &mut found) && stands(world, place, floor, &mut found) {
                free.push(([column, row], place));
            }
        }
    }
    if free.is_empty() {
        let what = format!("no place {} m above the floor at {} m is free", short(height - floor), short(floor));
        return Err(Error::invalid(what, "give the height of the floor, or a sensor with a mount height"));
    }
    Ok(Grid { size, places: free })
}

/// True if the floor at about this height covers the surroundings of a place, and nothing is between them.
fn stands(world: &World, place: DVec3, floor: f64, found: &mut QueryResult) -> bool {
    let mobility = Mobility::default();
    let below = height_below(world, place, (place.z - floor).max(0.0) + mobility.step, &mobility, found);
    below.is_some_and(|below| (below - floor).abs() <= mobility.step)
        && Footing::at(world, place.with_z(floor), FREE_DISTANCE, &mobility, found)
            .is_some_and(|footing| footing.edge >= FREE_DISTANCE)
}

fn sum<'a>(all: impl Iterator<Item = &'a Planar>) -> Planar {
    all.fold([0.0; 6], |sum, own| std::array::from_fn(|i| sum[i] + own[i]))
}

/// The covariance for an information, in the same order of entries; `None` if a direction is undetermined.
fn inverse(&[xx, xy, xh, yy, yh, hh]: &Planar) -> Option<Planar> {
    let cofactors = [
        yy * hh - yh * yh,
        xh * yh - xy * hh,
        xy * yh - xh * yy,
        xx * hh - xh * xh,
        xy * xh - xx * yh,
        xx * yy - xy * xy,
    ];
    let determinant = xx * cofactors[0] + xy * cofactors[1] + xh * cofactors[2];
    (determinant > OPEN * xx * yy * hh).then(|| cofactors.map(|c| c / determinant))
}

/// The largest standard deviation of the position along any direction, and the standard deviation of the heading.
fn sigmas(information: &Planar) -> [f64; 2] {
    let Some([xx, xy, _, yy, _, hh]) = inverse(information) else { return [f64::INFINITY; 2] };
    let largest = 0.5 * (xx + yy) + (0.5 * (xx - yy)).hypot(xy);
    [largest.sqrt(), hh.sqrt()]
}

/// Trace of the product of two symmetric matrices.
fn product_trace(a: &Planar, b: &Planar) -> f64 {
    let diagonal = a[0] * b[0] + a[3] * b[3] + a[5] * b[5];
    (diagonal + 2.0 * (a[1] * b[1] + a[2] * b[2] + a[4] * b[4])).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::environment::Environment;
    use presight_model::sensor::{Geometry, RayTable, SensorSpec};

    fn worth(views: Vec<Vec<(u32, Planar)>>, given: usize) -> Worth {
        Worth { places: Vec::new(), size: [1, 1], given, views }
    }

    const ALONG_X: Planar = [400.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    const ALONG_Y: Planar = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0];
    const TURN: Planar = [0.0, 0.0, 0.0, 0.0, 0.0, 100.0];

    #[test]
    fn an_empty_world_has_no_grid() {
        let world = World::new(Environment::new());
        let ray = RayTable::new(1, 1, vec![DVec3::X]).unwrap();
        let sensor = Sensor::new(SensorSpec::new("s", "laser", Geometry::Rays(ray))).unwrap();
        let e = grid(&world, &sensor, &WorthOptions { spacing: 1.0, floor: 0.0 }).unwrap_err();
        assert_eq!(e.what(), "the world has no polygons");
    }

    /// Information 4, 1 and 100: standard deviations of 1/2, 1 and 1/10. Rotated by 45 degrees, the largest stays 1.
    #[test]
    fn standard_deviations_match_hand_computed_values() {
        assert_eq!(sigmas(&[4.0, 0.0, 0.0, 1.0, 0.0, 100.0]), [1.0, 0.1]);
        let [position, heading] = sigmas(&[2.5, 1.5, 0.0, 2.5, 0.0, 100.0]);
        assert!((position - 1.0).abs() < 1e-12 && (heading - 0.1).abs() < 1e-12);
        // x and heading only together: [[2, 1], [1, 1]] has the inverse [[1, -1], [-1, 2]].
        let [position, heading] = sigmas(&[2.0, 0.0, 1.0, 1.0, 0.0, 1.0]);
        assert!((position - 1.0).abs() < 1e-12 && (heading - 2f64.sqrt()).abs() < 1e-12);
        assert_eq!(sigmas(&[4.0, 0.0, 0.0, 0.0, 0.0, 100.0]), [f64::INFINITY; 2]);
        // A single line, with rounding.
        assert_eq!(sigmas(&[1.0, 1.0, 1.0, 1.0 + 1e-15, 1.0, 1.0]), [f64::INFINITY; 2]);
    }

    /// Seven features give 1 each for y, which needs 7 / 1.1^2 = 5.8: one can go. x and heading have one feature each.
    #[test]
    fn features_go_while_the_rest_is_enough() {
        let mut view = vec![(0, ALONG_X), (1, TURN)];
        view.extend((2..9).map(|i| (i, ALONG_Y)));
        let thinned = worth(vec![view.clone()], 10).thinned(0.1);
        assert_eq!(thinned.keep, [true, true, false, true, true, true, true, true, true, false]);
        assert!((thinned.position_growth - ((7.0f64 / 6.0).sqrt() - 1.0)).abs() < 1e-12);
        assert_eq!(thinned.heading_growth, 0.0);
        // A view that shows only two of them needs both. A view with an undetermined direction needs none.
        let few = vec![(0, ALONG_X), (1, TURN), (2, ALONG_Y), (3, ALONG_Y)];
        let thinned = worth(vec![view, few, vec![(9, ALONG_Y)]], 10).thinned(0.1);
        assert_eq!(thinned.keep, [true, true, true, true, false, true, true, true, true, false]);
        // Two curves of one contour, out of 9 for y: without both, 7 are left, and sqrt(9 / 7) exceeds 1.1.
        let mut curves = vec![(0, ALONG_X), (1, TURN), (2, ALONG_Y), (2, ALONG_Y)];
        curves.extend((3..10).map(|_| (3, ALONG_Y)));
        let thinned = worth(vec![curves], 4).thinned(0.1);
        assert_eq!((thinned.keep, thinned.position_growth), (vec![true; 4], 0.0));
        // With no growth allowed, every informative feature is kept.
        assert_eq!(worth(vec![vec![(0, ALONG_X), (1, TURN), (2, ALONG_Y)]], 3).thinned(0.0).keep, [true; 3]);
    }
}
