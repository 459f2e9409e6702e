//! The result of an exploration, and its change of a store.

use super::object::{ExploredObject, first_free};
use crate::known::{corrected, explained, opened};
use crate::observe::Views;
use crate::surface::{Areas, ExploreOptions, detail, explain};
use crate::surfels::MIN_SIZE;
use crate::walls::{Wall, walls};
use glam::DVec3;
use presight_model::change::Change;
use presight_model::environment::{
    Environment, Existence, Mark, MarkKind, Material, Mesh, NewObject, Polygon, PolygonOrder,
};
use presight_model::error::{Error, Result};
use presight_model::geometry::{Aabb, Pose, PoseCovariance};
use presight_predict::predict::{Backend, Options, Predictor};
use presight_store::{Existing, Store};
use std::collections::BTreeSet;

/// Maximum number of marks in a store. Marks of unobserved borders beyond it are dropped, the smallest first.
pub const MAX_MARKS: usize = 10_000;
/// Half the height of the stretch of a wall that planar scans confirm, metres.
const CONFIRMED: f64 = 0.05;

/// Maximum distance of a point from the known surface that explains it, in units of the detail.
const EXPLAINED: f64 = 2.0;

/// Maximum distance of a point from the corrected surface that explains it, metres.
const ROUGH: f64 = 0.1;
/// Minimum number of points that a rough model explains; fewer do not move a face.
const MIN_EXPLAINED: usize = 30;

/// The kind of model that an exploration starts from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Known {
    /// A rough model: its surfaces move to the ends of the rays, and open where rays pass through them.
    Rough,
    /// The model of an earlier exploration: its surfaces open where rays pass through them.
    Explored,
}

/// An environment after an exploration.
pub struct Exploration {
    /// All objects, including the new ones.
    environment: Environment,
    /// The new objects.
    pub objects: Vec<ExploredObject>,
    /// Paths of the objects that have no remaining part.
    pub gone: Vec<String>,
    /// Areas of the new surfaces, and of the adjacent openings and unobserved cells, square metres.
    pub areas: Areas,
    /// Area of the known surfaces that rays passed through, square metres.
    pub opened: f64,
    /// Areas of the parts that no chain of views connects, square metres, the largest first.
    pub parts: Vec<f64>,
    /// Number of omitted points in mirrors.
    pub mirrored: usize,
    /// Share of the measured points that the known model does not explain.
    pub unexplained: f64,
    /// Sensor class of the pose covariances.
    class: String,
    stamp: f64,
}

impl Exploration {
    /// Explores with views, starting from a known environment, which may be empty.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] without views, and for an empty environment
    /// without a flat surface in the views.
    pub fn of(environment: &Environment, known: Known, views: &Views, options: &ExploreOptions) -> Result<Self> {
        let Some(last) = views.all().last() else {
            return Err(Error::invalid("there is no frame with a pose", "give a log with poses"));
        };
        let (class, stamp) = (last.sensor().spec().class.clone(), last.stamp);
        let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(options.threads.clone()))?;
        let (mut environment, mut opened_area) = (environment.clone(), 0.0);
        let before: BTreeSet<String> = paths(&environment);
        let is_planar = views.all().iter().all(|v| v.sensor().height() == 1);
        let is_empty = before.is_empty();
        let measured = (!is_planar).then(|| detail(options, views));
        let detail = measured.as_ref().map_or(MIN_SIZE, |measured| measured.min_size);
        if !is_empty && !is_planar {
            if known == Known::Rough {
                environment = corrected(&environment, views, &mut predictor)?;
                check_rough(&environment, views, &mut predictor)?;
            }
            (environment, opened_area) = options.threads.run(|| opened(&environment, views, detail))??;
        }
        let after = paths(&environment);
        let tolerance = if is_planar { options.wall_tolerance } else { EXPLAINED * detail };
        let known_pixels = match is_empty {
            true => None,
            false => Some(explained(&environment, views, &mut predictor, tolerance)?),
        };
        let is_used = |view: usize, pixel: usize| known_pixels.as_ref().is_none_or(|known| !known[view][pixel]);
        let pixels: usize = known_pixels.iter().flatten().flatten().filter(|e| **e).count();
        let mut exploration = Self {
            environment,
            objects: Vec::new(),
            gone: before.difference(&after).cloned().collect(),
            areas: Areas::default(),
            opened: opened_area,
            parts: Vec::new(),
            mirrored: 0,
            unexplained: 1.0 - pixels as f64 / views.hits().max(1) as f64,
            class,
            stamp,
        };
        let Some(measured) = measured else {
            let found = options.threads.run(|| walls(views, options.polygons, is_used))?;
            exploration.add_walls(&known_or(found, is_empty)?, views, options)?;
            return Ok(exploration);
        };
        match explain(views, (options, &measured), &mut predictor, is_used)? {
            Some(found) => {
                exploration.areas = found.areas;
                (exploration.parts, exploration.mirrored) = (found.parts(), found.mirrored);
                exploration.objects = found.objects(&exploration.environment)?;
            }
            None if is_empty => {
                let remedy = "give frames in which neighbouring pixels lie on one surface";
                return Err(Error::invalid("nothing flat is in sight", remedy));
            }
            None => {}
        }
        exploration.insert()?;
        Ok(exploration)
    }

    /// Number of new polygons.
    pub fn polygons(&self) -> usize {
        self.objects.iter().map(|o| o.mesh.polygon_count()).sum()
    }

    /// The environment with the new objects.
    pub fn environment(&self) -> &Environment {
        &self.environment
    }

    /// The stamp of the last frame, seconds.
    pub fn stamp(&self) -> f64 {
        self.stamp
    }

    fn add_walls(&mut self, walls: &[Wall], views: &Views, options: &ExploreOptions) -> Result<()> {
        let height = views.base().z + views.all().iter().map(|v| v.origin().z).sum::<f64>() / views.all().len() as f64;
        let first = first_free(&self.environment, "wall");
        for (wall, number) in walls.iter().zip(first..) {
            let [a, b] = wall.ends;
            let (low, high) = (options.floor, options.floor + options.wall_height);
            let middle = ((0.5 * (a + b)).extend(low) * 1e3).round() / 1e3;
            let corners = [a.extend(low), b.extend(low), b.extend(high), a.extend(high)];
            let vertices = corners.iter().map(|p| (*p - middle).as_vec3()).collect();
            let path = format!("wall/{number:04}");
            let polygon = Polygon::new(vec![0, 1, 2, 3], 0);
            let mesh = Mesh::new(&path, vertices, vec![polygon], PolygonOrder::Given)?;
            self.areas.surface += (b - a).length() * options.wall_height;
            self.objects.push(ExploredObject {
                path,
                world_from_object: Pose { translation: middle, ..Pose::IDENTITY },
                mesh,
                covariance: PoseCovariance::from_sigmas([0.02, 0.02, 0.02, 1e-3, 1e-3, 0.02 / (b - a).length()]),
                existence: 0.99,
                unseen: Vec::new(),
            });
        }
        self.insert()?;
        self.assume(height)
    }

    /// Marks the parts of walls above and below the height of the scans, metres, as uncertain.
    fn assume(&mut self, height: f64) -> Result<()> {
        for object in &self.objects {
            let b = object.mesh.bounds();
            let at = height - object.world_from_object.translation.z;
            let slack = DVec3::splat(1e-3);
            let below = Aabb { min: b.min - slack, max: DVec3::new(b.max.x, b.max.y, at - CONFIRMED) + slack };
            let above = Aabb { min: DVec3::new(b.min.x, b.min.y, at + CONFIRMED) - slack, max: b.max + slack };
            for (name, bounds) in [("below", below), ("above", above)] {
                if bounds.is_empty() {
                    continue;
                }
                let mark =
                    Mark { object: object.path.clone(), kind: MarkKind::Uncertain, class: None, bounds: Some(bounds) };
                self.environment.set_mark(&format!("assumed/{}/{name}", object.path), mark)?;
            }
        }
        Ok(())
    }

    /// Inserts the new objects, with their trust and the marks of their unobserved borders.
    fn insert(&mut self) -> Result<()> {
        let name = "explored";
        let known = self.environment.materials().iter().position(|m| m.name == name);
        let material = match known {
            Some(index) => index as u16,
            None => self.environment.add_material(Material::named(name))?,
        };
        let room = MAX_MARKS.saturating_sub(self.environment.marks().len());
        let mut unseen: Vec<(usize, Aabb)> = Vec::new();
        for (k, object) in self.objects.iter().enumerate() {
            let mesh = object.mesh.with_materials(|_| material);
            self.environment.insert(NewObject { mesh: mesh.into(), ..object.new_object() })?;
            let trust = Existence { p0: object.existence, confirmed: self.stamp, rate: 0.0 };
            self.environment.set_trust(&object.path, Some(trust))?;
            unseen.extend(object.unseen.iter().map(|b| (k, *b)));
        }
        // The largest are the most informative.
        unseen.sort_by(|a, b| b.1.size().total_cmp(&a.1.size()).then(a.0.cmp(&b.0)));
        unseen.truncate(room);
        for (number, (k, bounds)) in unseen.into_iter().enumerate() {
            let object = self.objects[k].path.clone();
            let name = format!("unseen/{object}/{number}");
            let mark = Mark { object, kind: MarkKind::Unseen, class: None, bounds: Some(bounds) };
            self.environment.set_mark(&name, mark)?;
        }
        Ok(())
    }

    /// The change of a store that holds the known environment.
    ///
    /// # Errors
    /// Those of [`Store::merging_scene`].
    pub fn change(&self, store: &Store) -> Result<Change> {
        let mut changes: Vec<Change> =
            self.gone.iter().map(|name| Change::DeleteObject { name: name.clone() }).collect();
        let merge = store.merging_scene(&self.environment, Existing::Replace)?;
        changes.push(merge.change);
        let before = store.world().environment();
        for (name, mark) in self.environment.marks().filter(|(name, mark)| before.mark(name) != Some(*mark)) {
            changes.push(Change::SetMark { name: name.to_owned(), mark: mark.clone() });
        }
        for (object, trust) in self.environment.trusts().filter(|(object, _)| before.trust(object).is_none()) {
            changes.push(Change::SetTrust { object: object.to_owned(), trust: Some(*trust) });
        }
        for object in &self.objects {
            changes.push(Change::SetPoseCovariance {
                class: self.class.clone(),
                object: object.path.clone(),
                covariance: Some(object.covariance),
            });
        }
        Ok(Change::Group(changes))
    }
}

/// Refuses a rough model that explains no points. One in millimetres, for example, has a million times too many cells.
fn check_rough(environment: &Environment, views: &Views, predictor: &mut Predictor) -> Result<()> {
    let points = explained(environment, views, predictor, ROUGH)?.iter().flatten().filter(|e| **e).count();
    if points >= MIN_EXPLAINED {
        return Ok(());
    }
    let of = |bounds: Aabb| {
        let size = 2.0 * bounds.half_extent();
        format!("{:.1} x {:.1} x {:.1} m", size.x, size.y, size.z)
    };
    let (model, seen) = (of(environment.bounds()), of(views.bounds()));
    let what = format!("the rough model, {model}, explains none of the points, which fill {seen}");
    Err(Error::invalid(what, "give a model of this place, in metres and in the frame of the poses, or none"))
}

fn known_or(found: Result<Vec<Wall>>, is_empty: bool) -> Result<Vec<Wall>> {
    match found {
        Err(e) if is_empty => Err(e),
        found => Ok(found.unwrap_or_default()),
    }
}

fn paths(environment: &Environment) -> BTreeSet<String> {
    environment.objects().iter().filter(|o| !o.is_deleted()).map(|o| o.name.clone()).collect()
}
