//! The map of how well the layer determines the sensor's pose, place by place, and the plan of the scene below it.

use super::answer::{Answer, Body};
use super::session::Session;
use presight::features::PlacedFeatures;
use presight::sensor::SensorSpec;
use presight::tools;
use presight::{Error, Options, Predictor, Result, Sensor, World};
use presight_studies::worth::{Grid, View, WorthOptions, WorthPlace, views};
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::{BTreeSet, HashSet};
use std::time::{Duration, Instant};

/// Bytes of views between two checks of the memory.
const A_LOT: u64 = 64 << 20;
/// Maximum number of pieces of a plan.
const MAX_PIECES: usize = 1 << 22;

/// Asks for the next places of the map.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorthRequest {
    #[serde(rename = "version")]
    _version: u64,
    /// Metres between places.
    spacing: f64,
    /// Height of the floor, metres.
    floor: f64,
    /// Height of the sensor above the floor; `None`: that of its mount.
    height: Option<f64>,
    /// For a sensor that states none.
    pixel_sigma: Option<f64>,
    /// Places that changed after this stamp are returned.
    #[serde(default)]
    since: u64,
    /// Time to work, milliseconds, at most 1,000. At least one place is done.
    #[serde(default)]
    budget_ms: u64,
}

/// Asks for a cut through the scene.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanRequest {
    /// World, metres.
    height: f64,
}

/// A place with the information of its views, by id of the feature.
struct Place {
    rated: WorthPlace,
    views: Vec<View>,
    /// Features that its views do not know yet.
    missing: BTreeSet<u32>,
    /// When it changed last.
    stamp: u64,
}

/// The map in the making.
pub struct WorthMap {
    key: [Option<u64>; 4],
    sensor: Sensor,
    predictor: Predictor,
    grid: Grid,
    /// Every fourth column and row of the grid first, then every second.
    order: Vec<u32>,
    /// By the grid's order.
    places: Vec<Option<Place>>,
    done: usize,
    stamp: u64,
    held: u64,
    granted: u64,
}

impl WorthMap {
    fn new(world: &World, sensor: &Sensor, request: &WorthRequest, engine: &Options) -> Result<Self> {
        let mut spec: SensorSpec = sensor.spec().clone();
        spec.noise.pixel_sigma = request.pixel_sigma.unwrap_or(spec.noise.pixel_sigma);
        spec.mount.translation.z = request.height.unwrap_or(spec.mount.translation.z);
        let sensor = Sensor::new(spec)?;
        let mut options = WorthOptions::default();
        (options.spacing, options.floor) = (request.spacing, request.floor);
        let grid = Grid::new(world, &sensor, &options)?;
        let fineness = |i: &u32| {
            let [column, row] = grid.places[*i as usize].0;
            2 - (column | row | 4).trailing_zeros()
        };
        let mut order: Vec<u32> = (0..grid.places.len() as u32).collect();
        order.sort_by_key(fineness);
        let places = grid.places.iter().map(|_| None).collect();
        let predictor = Predictor::new(engine.clone())?;
        let key = request.key();
        Ok(Self { key, sensor, predictor, grid, order, places, done: 0, stamp: 0, held: 0, granted: 0 })
    }

    /// Drops features from all views.
    pub fn forget(&mut self, ids: &[u32]) {
        let ids: HashSet<u32> = ids.iter().copied().collect();
        if ids.is_empty() {
            return;
        }
        self.stamp += 1;
        for (place, at) in self.places.iter_mut().zip(&self.grid.places) {
            let Some(place) = place else { continue };
            place.missing.retain(|id| !ids.contains(id));
            let before: usize = place.views.iter().map(Vec::len).sum();
            place.views.iter_mut().for_each(|view| view.retain(|(id, _)| !ids.contains(id)));
            if place.views.iter().map(Vec::len).sum::<usize>() < before {
                place.rated = WorthPlace::of(*at, &place.views);
                place.stamp = self.stamp;
            }
        }
    }

    /// Features that are new or altered: places that are done look at them alone.
    pub fn miss(&mut self, ids: &[u32]) {
        self.forget(ids);
        self.places.iter_mut().flatten().for_each(|place| place.missing.extend(ids));
    }

    /// Places whose views are not complete.
    fn open(&self) -> usize {
        let missing = self.places.iter().flatten().filter(|place| !place.missing.is_empty()).count();
        self.places.len() - self.done + missing
    }

    /// Does the next piece of work; false if there is none.
    fn work(&mut self, world: &World, placed: &PlacedFeatures) -> Result<bool> {
        let late = self.places.iter().position(|p| p.as_ref().is_some_and(|p| !p.missing.is_empty()));
        let (at, subset) = match (late, self.order.get(self.done)) {
            (Some(at), _) => {
                let missing = self.places[at].as_mut().map(|p| std::mem::take(&mut p.missing)).unwrap_or_default();
                let found = placed.features.iter().filter(|p| missing.contains(&p.feature.id)).cloned();
                (at, PlacedFeatures::from(found.collect::<Vec<_>>()))
            }
            (None, Some(next)) => (*next as usize, placed.clone()),
            (None, None) => return Ok(false),
        };
        let place = self.grid.places[at];
        let Self { sensor, predictor, held, granted, .. } = self;
        let mut seen = views(world, sensor, &subset, place.1, predictor, |told| {
            *held += size_of_val(&told[..]) as u64;
            if *held > *granted {
                *granted = 2 * (*held).max(A_LOT);
                tools::require_memory(*granted)?;
            }
            Ok(())
        })?;
        for (id, _) in seen.iter_mut().flatten() {
            *id = subset.features[*id as usize].feature.id;
        }
        self.stamp += 1;
        match &mut self.places[at] {
            Some(known) => {
                for (view, new) in known.views.iter_mut().zip(seen) {
                    view.extend(new);
                    // The order of a whole map, so that sums have its bits; curves of a contour stay in theirs.
                    view.sort_by_key(|(id, _)| *id);
                }
                (known.rated, known.stamp) = (WorthPlace::of(place, &known.views), self.stamp);
            }
            empty => {
                let rated = WorthPlace::of(place, &seen);
                *empty = Some(Place { rated, views: seen, missing: BTreeSet::new(), stamp: self.stamp });
                self.done += 1;
            }
        }
        Ok(true)
    }

    fn told(&self, since: u64) -> Value {
        let changed = self.places.iter().flatten().filter(|place| place.stamp > since);
        let places: Vec<Value> = changed
            .map(|Place { rated, .. }| {
                let [x, y, z] = rated.at.to_array();
                json!([
                    rated.cell[0],
                    rated.cell[1],
                    x,
                    y,
                    z,
                    rated.features,
                    rated.position_sigma,
                    rated.heading_sigma.to_degrees(),
                ])
            })
            .collect();
        json!({
            "size": self.grid.size, "places": places, "stamp": self.stamp, "done": self.places.len() - self.open(),
            "of": self.places.len(),
        })
    }
}

impl WorthRequest {
    fn key(&self) -> [Option<u64>; 4] {
        let bits = |x: Option<f64>| x.map(f64::to_bits);
        [bits(Some(self.spacing)), bits(Some(self.floor)), bits(self.height), bits(self.pixel_sigma)]
    }
}

impl Session {
    /// Works on the map for a while, and returns the places that changed.
    pub(crate) fn worth(&mut self, request: &WorthRequest) -> Result<Answer> {
        let start = Instant::now();
        for (name, value) in [("height", request.height), ("pixel_sigma", request.pixel_sigma)] {
            if value.is_some_and(|v| !v.is_finite()) {
                return Err(Error::usage(format!("{name} is not finite"), "give a number"));
            }
        }
        if self.map.as_ref().is_none_or(|map| map.key != request.key()) {
            self.sensor.check_projection()?;
            self.map = Some(WorthMap::new(&self.world, &self.sensor, request, &self.options.engine)?);
        }
        let Some(map) = &mut self.map else { return Ok(Answer::Unknown) };
        let budget = Duration::from_millis(request.budget_ms.min(1000));
        while map.work(&self.world, &self.placed)? && start.elapsed() < budget {}
        let mut told = map.told(request.since);
        told["version"] = self.version.into();
        Ok(Answer::Json(told.to_string()))
    }

    /// The lines in which polygons cross a horizontal plane, as x, y of both ends.
    pub(crate) fn plan(&mut self, request: &PlanRequest) -> Result<Answer> {
        let height = request.height;
        if !height.is_finite() {
            return Err(Error::usage("the height is not finite", "give metres"));
        }
        let mut pieces: Vec<[f32; 4]> = Vec::new();
        for object in self.world.environment().objects().iter().filter(|object| !object.is_deleted()) {
            let bounds = object.world_bounds();
            if !(bounds.min.z <= height && height <= bounds.max.z) {
                continue;
            }
            for polygon in 0..object.mesh.polygon_count() as u32 {
                let corners = object.polygon_in_world(polygon);
                let mut cut = Vec::new();
                for (i, a) in corners.iter().enumerate() {
                    let b = corners[(i + 1) % corners.len()];
                    if (a.z > height) != (b.z > height) {
                        cut.push(a.lerp(b, (height - a.z) / (b.z - a.z)));
                    }
                }
                let ends = cut.chunks_exact(2).map(|ends| [ends[0].x, ends[0].y, ends[1].x, ends[1].y]);
                pieces.extend(ends.map(|ends| ends.map(|c| c as f32)));
                if pieces.len() > MAX_PIECES {
                    let what = format!("the cut at {height} m has over {MAX_PIECES} pieces");
                    return Err(Error::usage(what, "give another height"));
                }
            }
        }
        let mut body = Body::new(json!({ "version": self.version, "height": height }));
        body.array("pieces", "f32", pieces.as_flattened(), f32::to_le_bytes);
        Ok(body.answer())
    }
}
