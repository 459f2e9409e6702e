//! Measures the cost and selectivity of each spatial index over poses (paper section 2.2, Fig. 5).

use super::index::{Scheme, polygon_meets};
use super::{csv_field, median};
use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::geometry::{Aabb, Pose, SensorPose};
use presight_model::index::{Params, QueryResult, Region, SplitAxis};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::predict::{Options, Predictor};
use presight_render::plan::{ImageRequest, Images, region_of};
use std::time::Instant;

/// The paper's query: radius in metres, opening in degrees.
pub const PAPER_SECTOR: (f64, f64) = (10.0, 60.0);

/// The settings of a study.
#[derive(Clone, Debug)]
pub struct Study {
    /// The poses of the sensors.
    pub poses: Vec<Pose>,
    /// Names and sensors whose regions are queried, in addition to the paper's sector.
    pub sensors: Vec<(String, Sensor)>,
    /// Options of the predictor.
    pub options: Options,
    /// Repetitions of each query and prediction; the fastest counts.
    pub repeats: usize,
}

/// The results of one scheme and one query: medians over poses.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// The scheme.
    pub scheme: Scheme,
    /// Its parameters.
    pub params: Params,
    /// `sector` (the paper's), or a sensor's name.
    pub query: String,
    /// Time to build the index of the whole environment.
    pub build_ms: f64,
    /// Memory of the index, including its boxes.
    pub bytes: usize,
    /// Time of one query.
    pub access_us: f64,
    /// Polygons with a point in the region.
    pub needed: f64,
    /// Polygons that the index returned.
    pub returned: f64,
    /// The sum of needed over the sum of returned polygons of all poses.
    pub selectivity: f64,
    /// Time of a whole prediction with this index; `None` for the paper's query, which has no sensor.
    pub prediction_ms: Option<f64>,
}

/// The regions of one query at all poses, and the number of polygons that each needs.
struct Query<'a> {
    name: String,
    sensor: Option<&'a Sensor>,
    regions: Vec<Region>,
    needed: Vec<usize>,
}

impl Study {
    /// Measures all schemes with their parameters.
    ///
    /// # Errors
    /// Prediction errors.
    pub fn run(&self, world: &World, variants: &[(Scheme, Params)], progress: impl Fn(&str)) -> Result<Vec<Row>> {
        progress("counting the polygons that each query needs");
        let queries = self.queries(world)?;
        let mut predictor = Predictor::new(self.options.clone())?;
        let mut rows = Vec::new();
        for &(scheme, params) in variants {
            progress(scheme.name());
            let (kind, mut build, mut indexed) = (scheme.kind(params), Vec::new(), None);
            for _ in 0..self.repeats.clamp(1, 3) {
                let start = Instant::now();
                indexed = Some(world.reindexed(&kind));
                build.push(start.elapsed().as_secs_f64() * 1e3);
            }
            let Some(indexed) = indexed else { continue };
            let build_ms = build.into_iter().fold(f64::INFINITY, f64::min);
            for query in &queries {
                rows.push(self.measure(&indexed, (scheme, params), query, build_ms, &mut predictor)?);
            }
        }
        Ok(rows)
    }

    fn queries(&self, world: &World) -> Result<Vec<Query<'_>>> {
        let environment = world.environment();
        let polygons: Vec<(Aabb, Vec<DVec3>)> = (0..environment.slot_count())
            .filter_map(|slot| environment.polygon_in_world(slot))
            .map(|corners| (Aabb::of(corners.iter().copied()), corners))
            .collect();
        let needed = |region: &Region| {
            let met = |(b, corners): &&(Aabb, Vec<DVec3>)| region.meets(b) && polygon_meets(region, corners);
            polygons.iter().filter(met).count()
        };
        let mut queries = Vec::new();
        let mut add = |name: &str, sensor, regions: Vec<Region>| {
            let needed = regions.iter().map(needed).collect();
            queries.push(Query { name: name.to_owned(), sensor, regions, needed });
        };
        add("sector", None, self.poses.iter().map(paper_sector).collect::<Result<_>>()?);
        for (name, sensor) in &self.sensors {
            add(name, Some(sensor), self.poses.iter().map(|pose| region_of(sensor, pose)).collect::<Result<_>>()?);
        }
        Ok(queries)
    }

    fn measure(
        &self,
        world: &World,
        (scheme, params): (Scheme, Params),
        query: &Query<'_>,
        build_ms: f64,
        predictor: &mut Predictor,
    ) -> Result<Row> {
        let (index, environment) = (world.index(), world.environment());
        let mut found = QueryResult::default();
        let (mut access, mut returned, mut prediction) = (Vec::new(), Vec::new(), Vec::new());
        let mut images = Images::default();
        for (region, pose) in query.regions.iter().zip(&self.poses) {
            access.push(
                fastest(self.repeats, || {
                    found.clear();
                    index.query(environment, region, &mut found);
                    Ok(())
                })? * 1e6,
            );
            returned.push(found.count() as f64);
            if let Some(sensor) = query.sensor {
                let request = ImageRequest::default();
                prediction.push(
                    fastest(self.repeats, || {
                        predictor
                            .predict_images(world, sensor, &SensorPose::new(*pose), request, &mut images)
                            .map(|_| ())
                    })? * 1e3,
                );
            }
        }
        let needed: Vec<f64> = query.needed.iter().map(|n| *n as f64).collect();
        let all = returned.iter().sum::<f64>();
        Ok(Row {
            scheme,
            params,
            query: query.name.clone(),
            build_ms,
            bytes: index.bytes(),
            access_us: median(access),
            selectivity: if all > 0.0 { needed.iter().sum::<f64>() / all } else { 1.0 },
            needed: median(needed),
            returned: median(returned),
            prediction_ms: query.sensor.map(|_| median(prediction)),
        })
    }
}

/// The paper's query region at a pose: a sector of 10 m and 60 degrees along its heading.
///
/// # Errors
/// As [`Pose::check`].
pub fn paper_sector(pose: &Pose) -> Result<Region> {
    pose.check()?;
    let ahead = pose.rotation * DVec3::X;
    let (radius, opening_deg) = PAPER_SECTOR;
    Ok(Region::sector(pose.translation.truncate(), ahead.y.atan2(ahead.x), opening_deg.to_radians(), radius))
}

/// The indexes of a study with their parameters: the best ones, or every one of a sweep. Only some schemes if `only`
/// lists any; `filter` tests the polygons of cells that are partly in the region.
pub fn variants(only: &[Scheme], sweeps: bool, filter: bool) -> Vec<(Scheme, Params)> {
    let mut variants = if sweeps { sweep() } else { Scheme::ALL.map(|s| (s, s.params())).to_vec() };
    variants.retain(|(scheme, _)| only.is_empty() || only.contains(scheme));
    variants.iter_mut().for_each(|(_, params)| params.filter = filter);
    variants
}

/// The variants of a sweep: cell sizes of each scheme, and split axes of trees.
fn sweep() -> Vec<(Scheme, Params)> {
    let mut variants = Vec::new();
    for scheme in [Scheme::Grid, Scheme::Plop, Scheme::S2d, Scheme::S3d, Scheme::TwoLevel] {
        let tree = matches!(scheme, Scheme::S2d | Scheme::S3d | Scheme::TwoLevel);
        let axes: &[SplitAxis] =
            if tree { &[SplitAxis::Longest, SplitAxis::Alternating] } else { &[SplitAxis::Longest] };
        for &split_axis in axes {
            for cell_polygons in [4, 8, 16, 32, 64, 128] {
                for min_cell in [0.0, 1.0] {
                    let params = Params { min_cell, cell_polygons, split_axis, ..Params::default() };
                    variants.push((scheme, params));
                }
            }
        }
    }
    variants
}

/// Formats rows as CSV. The first columns, up to prediction_ms, are stable for scripts.
pub fn to_csv(rows: &[Row], poses: usize, seed: Option<u64>) -> String {
    let mut text = String::from(
        "scheme,query,poses,seed,build_ms,bytes,access_us,needed,returned,selectivity,prediction_ms,\
         cell_polygons,least_cell,split_axis,filter\n",
    );
    let seed = seed.map(|s| s.to_string()).unwrap_or_default();
    for r in rows {
        let prediction = r.prediction_ms.map(|ms| format!("{ms:.4}")).unwrap_or_default();
        let axis = format!("{:?}", r.params.split_axis).to_lowercase();
        text += &format!(
            "{},{},{poses},{seed},{:.3},{},{:.2},{},{},{:.4},{prediction},{},{},{axis},{}\n",
            r.scheme.name(),
            csv_field(&r.query),
            r.build_ms,
            r.bytes,
            r.access_us,
            r.needed,
            r.returned,
            r.selectivity,
            r.params.cell_polygons,
            r.params.min_cell,
            r.params.filter,
        );
    }
    text
}

/// The time of the fastest run, seconds.
fn fastest(repeats: usize, mut run: impl FnMut() -> Result<()>) -> Result<f64> {
    let mut best = f64::INFINITY;
    for _ in 0..repeats.max(1) {
        let start = Instant::now();
        run()?;
        best = best.min(start.elapsed().as_secs_f64());
    }
    Ok(best)
}

/// Checks that there is at least one pose.
///
/// # Errors
/// [`presight::ErrorKind::Invalid`] without poses.
pub fn check_poses(poses: &[Pose]) -> Result<()> {
    if poses.is_empty() {
        return Err(Error::invalid("there are no poses", "give at least one"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::error::ErrorKind;

    #[test]
    fn a_pose_that_is_none_has_no_sector() {
        let nowhere = Pose { translation: DVec3::new(f64::NAN, 0.0, 1.0), ..Pose::IDENTITY };
        let unturned = Pose { rotation: glam::DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), ..Pose::IDENTITY };
        for pose in [nowhere, unturned] {
            assert_eq!(paper_sector(&pose).unwrap_err().kind(), ErrorKind::Usage, "{pose:?}");
        }
        assert!(paper_sector(&Pose::IDENTITY).is_ok());
    }
}
