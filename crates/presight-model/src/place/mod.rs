//! Places features: finds their objects and polygons by geometry. Layers never name polygons by number, because another
//! export of the model numbers them differently.
//!
//! - A point lies on every polygon within the tolerance.
//! - A segment lies on every polygon that contains a stretch of it: both faces of a crease, each of several in line.
//! - A patch or fiducial lies on the coplanar polygons that it overlaps.
//! - A contour lies on the smooth surface under its anchor.
//!
//! A feature that lies on polygons within rounding lies on no others, however near; those others may hide it. A polygon
//! that a segment or patch only crosses or touches does not count. The whole feature must lie on its polygons. A
//! rejected feature is somewhere farther from them than the tolerance. An accepted one is not, except that the inside
//! of a patch may exceed the tolerance by a sixteenth (`cover`).
//!
//! All computations use the frame of the feature's object, relative to the feature's first point. This keeps full
//! precision 5,000,000 m from the origin.

mod coplanar;
mod cover;
mod local;
mod patch;
mod plane;
mod segment;
mod squares;
#[cfg(test)]
mod tests;

use crate::contour::ContourFinder;
use crate::environment::{Environment, Feature, FeatureLayer, FeatureShape, Object};
use crate::error::{Error, Result, short, short_point};
use crate::geometry::{Aabb, Pose, plane_of_polygon};
use crate::index::{QueryResult, Region};
use crate::limits;
use crate::placed::PlacedFeature;
use crate::threads::parallel;
use crate::world::World;
use glam::DVec3;
use local::Local;
pub use plane::clip;
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Sine of the largest angle between a polygon and a feature on it, about 5 degrees. Larger angles are accepted only if
/// both are so small that they stay within the tolerance.
const LYING: f64 = 0.087;

/// A feature this near to a polygon lies on it within the rounding of files, metres. Generated features do; other faces
/// are farther away, even on the other side of a thin sheet. The layer's tolerance applies only if this leaves a gap.
const ROUNDING: f64 = 1e-5;

/// Distance of a point in the world within which a feature lies on the polygons of an object that are there, metres:
/// the rounding of files and of f32 vertices.
pub fn rounding_at(object: &Object, p: DVec3) -> f64 {
    let in_object = object.world_from_object.inverse().transform_point(p);
    ROUNDING + rounding_of_vertices((in_object - object.object_from_mesh.translation).abs().max_element())
}

/// Rounding of f32 vertices, metres, by their largest coordinate in the mesh, in metres.
fn rounding_of_vertices(far: f64) -> f64 {
    4.0 * f64::from(f32::EPSILON) * far
}

/// The polygons that a feature lies on, or a point where it lies on none.
enum Support {
    /// Slots of the polygons, in any order.
    On(Vec<u32>),
    /// A point of the feature that is off all polygons, in the feature's frame, relative to its first point.
    Off(DVec3),
}

/// Finds the object and the polygons of each feature in a world. Returns them in the order of the layer.
///
/// ```
/// use presight::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
/// use presight::features::{Existence, Feature, FeatureLayer, FeatureShape, Properties, place};
/// use presight::{Pose, World};
/// use glam::{DMat3, DVec3, Vec3};
/// let mut environment = Environment::new();
/// environment.add_material(Material::named("paint"))?;
/// // Two squares side by side.
/// let corners = [[0., 0.], [1., 0.], [2., 0.], [2., 1.], [1., 1.], [0., 1.]].map(|[x, y]| Vec3::new(x, y, 0.0));
/// let squares = [[0, 1, 4, 5], [1, 2, 3, 4]].map(|corners| Polygon::new(corners.to_vec(), 0));
/// let mesh = Mesh::new("tiles", corners.to_vec(), squares.to_vec(), PolygonOrder::Given)?;
/// environment.insert(NewObject::new("floor", Pose::IDENTITY, mesh.into()))?;
/// let world = World::new(environment);
///
/// let ends = [DVec3::new(0.5, 0.5, 0.0), DVec3::new(1.5, 0.5, 0.0)];
/// let line = Feature {
///     id: 1,
///     name: None,
///     object: Some("floor".into()),
///     shape: FeatureShape::Segment { ends, covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO },
///     existence: Existence::default(),
///     properties: Properties::default(),
/// };
/// let (class, features) = ("video".into(), vec![line.into()]);
/// let layer = FeatureLayer { class, tolerance: 1e-3, features, ..Default::default() };
/// let placed = place(&world, &layer)?;
/// assert_eq!((placed[0].object, placed[0].slots.as_slice()), (Some(0), [0, 1].as_slice()));
/// # Ok::<(), presight::Error>(())
/// ```
///
/// # Errors
/// [`crate::ErrorKind::Invalid`], naming the feature: the errors of [`FeatureLayer::check`], an object that does not
/// exist, or a feature that is off its polygons by more than the layer's tolerance, with the distance.
pub fn place(world: &World, layer: &FeatureLayer) -> Result<Vec<PlacedFeature>> {
    let mut finder = SupportFinder::new(world, layer)?;
    let lying = finder.lie_all(layer)?;
    let both = layer.features.iter().zip(lying);
    both.map(|(feature, lying)| finder.place(feature, lying).map_err(|e| e.at(name_of(feature)))).collect()
}

/// Like [`place`], but leaves out features that cannot be placed, and returns their ids as the second value.
pub fn place_lying(world: &World, layer: &FeatureLayer) -> Result<(Vec<PlacedFeature>, Vec<u32>)> {
    let mut finder = SupportFinder::new(world, layer)?;
    let (mut placed, mut off) = (Vec::with_capacity(layer.features.len()), Vec::new());
    for (feature, lying) in layer.features.iter().zip(finder.lie_all(layer)?) {
        match lying.and_then(|lying| finder.with_surface(feature, lying)) {
            Ok((frame, Support::On(slots))) => placed.push(frame.placed(feature, slots)),
            Err(e) if finder.contours.is_full() => return Err(e.at(name_of(feature))),
            // The distance is not needed here, and would take a search of its own.
            _ => off.push(feature.id),
        }
    }
    Ok((placed, off))
}

fn name_of(feature: &Feature) -> String {
    match &feature.name {
        Some(name) => format!("feature {} {name:?}", feature.id),
        None => format!("feature {}", feature.id),
    }
}

/// A feature's frame and support.
type Lying<'a> = (FeatureFrame<'a>, Support);

struct SupportFinder<'a> {
    world: &'a World,
    environment: &'a Environment,
    tolerance: f64,
    found: QueryResult,
    contours: ContourFinder<'a>,
    /// [`limits::MAX_PLACING_PAIRS`].
    max_pairs: u64,
    /// The object found last, and its path: neighbours in a layer often share their object.
    last_object: Option<(&'a str, u32)>,
    /// Memory for the corners of a polygon.
    corners: Vec<DVec3>,
}

/// The frame in which a feature is given.
struct FeatureFrame<'a> {
    /// Its object and the object's index; `None` for the world.
    object: Option<(&'a Object, u32)>,
    /// First point of the feature; computations are relative to it.
    anchor: DVec3,
}

impl FeatureFrame<'_> {
    fn placed(&self, feature: &Arc<Feature>, mut slots: Vec<u32>) -> PlacedFeature {
        slots.sort_unstable();
        PlacedFeature { feature: feature.clone(), object: self.object.map(|(_, index)| index), slots }
    }

    /// Gets a polygon's corners in this frame, relative to the anchor. Returns their rounding error bound, metres.
    fn corners(&self, other: &Object, index: u32, polygon: u32, corners: &mut Vec<DVec3>) -> f64 {
        corners.clear();
        let in_other = other.mesh.corners_of(polygon).map(|p| other.object_from_mesh.transform_point3(p));
        let Pose { rotation: _, translation } = other.world_from_object;
        // Subtract the origins first: they may be far from the world's origin and near each other.
        let apart = match self.object {
            Some((_, own)) if own == index => {
                corners.extend(in_other.map(|p| p - self.anchor));
                0.0
            }
            Some((own, _)) => {
                let turn = other.world_from_object.rotation_matrix();
                let own = own.world_from_object;
                let (back, apart) = (own.rotation_matrix().transpose(), translation - own.translation);
                corners.extend(in_other.map(|p| back * (turn * p + apart) - self.anchor));
                apart.length()
            }
            None => {
                let turn = other.world_from_object.rotation_matrix();
                let apart = translation - self.anchor;
                corners.extend(in_other.map(|p| turn * p + apart));
                apart.length()
            }
        };
        let reach = corners.iter().map(|c| c.length_squared()).fold(apart * apart, f64::max).sqrt();
        64.0 * f64::EPSILON * (reach + self.anchor.length())
    }

    fn to_world(&self, p: DVec3) -> DVec3 {
        self.object.map_or(p, |(o, _)| o.world_from_object.transform_point(p))
    }
}

impl<'a> SupportFinder<'a> {
    fn new(world: &'a World, layer: &'a FeatureLayer) -> Result<Self> {
        layer.check()?;
        let environment = world.environment();
        for (object, _) in &layer.pose_covariances {
            environment.index_of(object).map_err(|e| e.at(format!("pose covariance of object {object:?}")))?;
        }
        let contours = ContourFinder::new(environment, &layer.class);
        let (tolerance, max_pairs) = (layer.tolerance, limits::MAX_PLACING_PAIRS);
        let (found, last_object, corners) = (QueryResult::default(), None, Vec::new());
        Ok(Self { world, environment, tolerance, found, contours, max_pairs, last_object, corners })
    }

    fn place(&mut self, feature: &Arc<Feature>, lying: Result<Lying<'a>>) -> Result<PlacedFeature> {
        match self.with_surface(feature, lying?)? {
            (frame, Support::On(slots)) => Ok(frame.placed(feature, slots)),
            (frame, Support::Off(at)) => Err(self.off(&frame, at, feature)),
        }
    }

    /// The support of each feature in the layer's order; for contours, of their anchors.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if [`limits::MAX_PLACING_PAIRS`] is exceeded.
    fn lie_all(&self, layer: &'a FeatureLayer) -> Result<Vec<Result<Lying<'a>>>> {
        /// Minimum number of features per parallel task.
        const BATCH: usize = 256;
        let features = layer.features.par_iter().with_min_len(BATCH);
        let pairs = AtomicU64::new(0);
        let lying = parallel(|| features.map_init(|| self.another(), |finder, f| finder.lie(f, &pairs)).collect())?;
        if pairs.into_inner() > self.max_pairs { Err(self.too_many()) } else { Ok(lying) }
    }

    fn too_many(&self) -> Error {
        let (most, tolerance) = (self.max_pairs, short(self.tolerance));
        let what = format!("over {most} polygons lie within the layer's tolerance of {tolerance} m of its features");
        Error::invalid(what, "give a smaller tolerance, or fewer features")
    }

    /// A copy with empty caches, for another thread.
    fn another(&self) -> Self {
        let contours = ContourFinder::new(self.environment, "");
        let (found, corners) = (QueryResult::default(), Vec::new());
        Self { found, contours, last_object: None, corners, ..*self }
    }

    /// Replaces the support of a contour's anchor by the contour's surface.
    fn with_surface(&mut self, feature: &Feature, (frame, lying): Lying<'a>) -> Result<Lying<'a>> {
        match (&feature.shape, lying) {
            (FeatureShape::Contour { crease_deg, .. }, Support::On(slots)) => {
                let surface = self.surface(frame.object.map(|(_, index)| index), slots, *crease_deg)?;
                Ok((frame, surface))
            }
            (_, lying) => Ok((frame, lying)),
        }
    }

    /// Finds the frame and support of a feature, or of a contour's anchor. Adds the number of near polygons to `pairs`.
    fn lie(&mut self, feature: &'a Feature, pairs: &AtomicU64) -> Result<Lying<'a>> {
        let environment = self.environment;
        let object = feature.object.as_deref().map(|path| self.object_of(path)).transpose()?;
        let points = feature.shape.points();
        let frame = FeatureFrame { object: object.map(|i| (&environment.objects()[i as usize], i)), anchor: points[0] };
        let boxes = boxes_around(&frame, &feature.shape);
        let about: Vec<DVec3> = points.iter().map(|p| *p - frame.anchor).collect();
        let tolerance = self.tolerance;
        if pairs.load(Ordering::Relaxed) > self.max_pairs {
            return Err(self.too_many());
        }
        let slots = self.slots_near(&boxes);
        pairs.fetch_add(slots.len() as u64, Ordering::Relaxed);
        let bounds = Aabb::of(about.iter().copied());
        let mut within = |tolerance: f64, bounds: Option<&Aabb>| {
            lie(&self.locals(&frame, &slots, tolerance, bounds), &about, &|_| Ok(()))
        };
        let mut found = within(tolerance.min(ROUNDING), Some(&bounds))?;
        if tolerance > ROUNDING && matches!(found, Support::Off(_)) {
            found = within(tolerance, Some(&bounds))?;
        }
        // Finding the point farthest off requires all near polygons.
        if matches!(found, Support::Off(_)) {
            found = within(tolerance, None)?;
        }
        Ok((frame, found))
    }

    fn object_of(&mut self, path: &'a str) -> Result<u32> {
        match self.last_object {
            Some((last, index)) if last == path => Ok(index),
            _ => {
                let index = self.environment.index_of(path)?;
                self.last_object = Some((path, index));
                Ok(index)
            }
        }
    }

    /// The surface of a contour at its anchor's polygons, in the contour's object or, in the world, the first object.
    fn surface(&mut self, object: Option<u32>, mut slots: Vec<u32>, crease_deg: f64) -> Result<Support> {
        slots.sort_unstable();
        let object_of = |slot: &u32| self.environment.locate(*slot).map(|(object, _)| object);
        let Some(object) = object.or_else(|| slots.first().and_then(object_of)) else {
            return Ok(Support::Off(DVec3::ZERO));
        };
        slots.retain(|slot| object_of(slot) == Some(object));
        let surface = self.contours.find(object, &slots, crease_deg)?;
        Ok(if surface.is_empty() { Support::Off(DVec3::ZERO) } else { Support::On(surface) })
    }

    /// The slots of polygons that may be within the layer's tolerance of boxes in the world.
    fn slots_near(&mut self, boxes: &[Aabb]) -> Vec<u32> {
        self.found.clear();
        for b in boxes {
            let reach = b.min.abs().max(b.max.abs()).max_element();
            let margin = self.tolerance + 64.0 * f64::EPSILON * reach;
            let grown = Aabb { min: b.min - margin, max: b.max + margin };
            self.world.index().query(self.environment, &Region::cuboid(&grown), &mut self.found);
        }
        let mut slots: Vec<u32> = self.found.all().collect();
        slots.sort_unstable();
        slots.dedup();
        slots
    }

    /// The polygons in some slots, without polygons surely too far from a box in the feature's frame.
    fn locals(&mut self, frame: &FeatureFrame<'_>, slots: &[u32], tolerance: f64, bounds: Option<&Aabb>) -> Vec<Local> {
        let mut all = Vec::with_capacity(slots.len().min(16));
        for slot in slots {
            all.extend(self.local(frame, *slot, tolerance, bounds));
        }
        all
    }

    fn local(&mut self, frame: &FeatureFrame<'_>, slot: u32, tolerance: f64, near: Option<&Aabb>) -> Option<Local> {
        let (index, polygon) = self.environment.locate(slot)?;
        let object = &self.environment.objects()[index as usize];
        let rounding = frame.corners(object, index, polygon, &mut self.corners);
        // More than the tolerance and rounding.
        let far = 2.0 * (self.tolerance + rounding);
        let own = Aabb::of(self.corners.iter().copied());
        let is_beside = |b: &Aabb| (own.min.cmpgt(b.max + far) | own.max.cmplt(b.min - far)).any();
        if near.is_some_and(is_beside) {
            return None;
        }
        // Vertices are f32, so a polygon is planar only within their rounding.
        let metres = object.object_from_mesh.matrix3;
        let far = object.mesh.corners_of(polygon).map(|p| (metres * p).abs().max_element()).fold(0.0, f64::max);
        let reach = (tolerance + rounding_of_vertices(far)).min(self.tolerance);
        Some(Local::new(slot, self.corners.clone(), reach + rounding))
    }

    fn off(&mut self, frame: &FeatureFrame<'_>, at: DVec3, feature: &Feature) -> Error {
        let p = at + frame.anchor;
        let whose = match &feature.object {
            Some(path) => format!("in the frame of object {path:?}"),
            None => "in the world".to_owned(),
        };
        let remedy = "move it onto the model, or raise the layer's tolerance";
        let kind = feature.shape.kind();
        match self.distance(frame, at) {
            Some(distance) if distance <= self.tolerance => Error::invalid(
                format!(
                    "the {kind} lies on no polygon at {} {whose}: the polygons within {} m only touch or cross it",
                    short_point(p),
                    short(self.tolerance)
                ),
                "move it onto the model",
            ),
            Some(distance) => Error::invalid(
                format!(
                    "the {} is {} m off its polygons at {} {whose}; {} m is allowed",
                    kind,
                    if distance < 1e-3 { format!("{distance:.3e}") } else { format!("{distance:.6}") },
                    short_point(p),
                    short(self.tolerance)
                ),
                remedy,
            ),
            None => Error::invalid("the world has no polygons for the feature to lie on", "check the scene"),
        }
    }

    /// Distance from a point, relative to the anchor, to the nearest polygon, metres; `None` if there are no polygons.
    fn distance(&mut self, frame: &FeatureFrame<'_>, at: DVec3) -> Option<f64> {
        let p_in_world = frame.to_world(at + frame.anchor);
        let everything = self.environment.bounds();
        if everything.is_empty() {
            return None;
        }
        let enough = everything.with(p_in_world).size();
        let mut half = 4.0 * self.tolerance;
        loop {
            let b = Aabb { min: p_in_world - half, max: p_in_world + half };
            let slots = self.slots_near(&[b]);
            let nearest =
                self.locals(frame, &slots, self.tolerance, None).iter().map(|l| l.distance(at)).reduce(f64::min);
            match nearest {
                // Nothing outside the box can be nearer.
                Some(d) if d <= half || half > enough => return Some(d),
                None if half > enough => return None,
                _ => half *= 4.0,
            }
        }
    }
}

/// Boxes in the world that together contain the feature. A slanted segment has several, because one would be large.
fn boxes_around(frame: &FeatureFrame<'_>, shape: &FeatureShape) -> Vec<Aabb> {
    /// Maximum number of boxes along a segment.
    const MAX_BOXES: f64 = 16.0;
    /// Minimum length of a box, metres: each box is a query.
    const MIN_LENGTH: f64 = 0.5;
    let points: Vec<DVec3> = shape.points().iter().map(|p| frame.to_world(*p)).collect();
    let FeatureShape::Segment { .. } = shape else { return vec![Aabb::of(points)] };
    let mut sides = (points[1] - points[0]).abs().to_array();
    sides.sort_by(f64::total_cmp);
    let count = (MAX_BOXES * sides[1] / sides[2]).min(sides[2] / MIN_LENGTH).clamp(1.0, MAX_BOXES) as usize;
    let at = |k: usize| points[0].lerp(points[1], k as f64 / count as f64);
    (0..count).map(|k| Aabb::of([at(k), at(k + 1)])).collect()
}

/// Finds the support of a point, a segment (its ends) or a patch (its corners); the first point is the origin.
fn lie(near: &[Local], points: &[DVec3], compare: &dyn Fn(usize) -> Result<()>) -> Result<Support> {
    match points {
        [_] => Ok(on_point(near)),
        [_, end] => Ok(segment::lie(near, *end)),
        corners => patch::lie(near, corners, compare),
    }
}

fn on_point(near: &[Local]) -> Support {
    let on: Vec<u32> = near.iter().filter(|l| l.holds(DVec3::ZERO)).map(|l| l.slot).collect();
    if on.is_empty() { Support::Off(DVec3::ZERO) } else { Support::On(on) }
}

/// Returns true if a point, a segment (its ends) or a patch (its corners) lies on polygons completely, within a
/// tolerance. All positions are in one frame, metres. Extra polygons never make the result false. `compare` is called
/// with the number of pairs before polygons are compared with each other.
///
/// # Errors
/// The errors of `compare`.
pub fn lies_on<C: AsRef<[DVec3]>>(
    points: &[DVec3],
    polygons: impl Iterator<Item = C>,
    tolerance: f64,
    compare: &dyn Fn(usize) -> Result<()>,
) -> Result<bool> {
    let anchor = points[0];
    let local = |corners: C| {
        let corners: Vec<DVec3> = corners.as_ref().iter().map(|c| *c - anchor).collect();
        let reach = corners.iter().map(|c| c.length()).fold(anchor.length(), f64::max);
        Local::new(0, corners, tolerance + 64.0 * f64::EPSILON * reach)
    };
    let near: Vec<Local> = polygons.map(local).collect();
    let about: Vec<DVec3> = points.iter().map(|p| *p - anchor).collect();
    if about.len() > 2 && plane_of_polygon(&about).is_none() {
        return Ok(false);
    }
    lie(&near, &about, compare).map(|lie| matches!(lie, Support::On(_)))
}
