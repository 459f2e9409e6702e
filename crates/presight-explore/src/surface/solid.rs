//! Comparison of pieces with the views: predictions from a world of the pieces alone.

use super::fit::PlaneFit;
use super::outline::Piece;
use crate::geometry::Flat;
use crate::observe::Views;
use glam::{DVec3, Vec3};
use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::union_find::UnionFind;
use presight_model::world::World;
use presight_predict::predict::Predictor;
use presight_render::plan::{Images, Output, Outputs};

/// Distance beyond which a point belongs to another surface, in units of the tolerance.
const SAME_SURFACE: f64 = 10.0;
/// Minimum weight of the rays that move a plane.
const MIN_WEIGHT: f64 = 5.0;

/// The mesh of convex polygons with these corners, metres, and for each polygon of the mesh the index of its source.
/// Polygons that f32 cannot represent are split into triangles, and triangles of that kind are dropped.
pub(crate) fn mesh<'a>(
    name: &str,
    polygons: impl Iterator<Item = &'a [DVec3]>,
    base: DVec3,
) -> Result<(Mesh, Vec<u32>)> {
    let (mut vertices, mut list, mut of) = (Vec::new(), Vec::new(), Vec::new());
    let is_sound = |corners: &[Vec3]| {
        let polygon = Polygon::new((0..corners.len() as u32).collect(), 0);
        Mesh::new(name, corners.to_vec(), vec![polygon], PolygonOrder::Given).is_ok()
    };
    for (number, polygon) in polygons.enumerate() {
        let corners: Vec<Vec3> = polygon.iter().map(|p| (*p - base).as_vec3()).collect();
        let parts = if is_sound(&corners) {
            vec![corners]
        } else {
            let fan = (1..corners.len().saturating_sub(1)).map(|k| vec![corners[0], corners[k], corners[k + 1]]);
            fan.filter(|triangle| is_sound(triangle)).collect()
        };
        for part in parts {
            let first = vertices.len() as u32;
            list.push(Polygon::new((first..first + part.len() as u32).collect(), 0));
            vertices.extend(part);
            of.push(number as u32);
        }
    }
    Ok((Mesh::new(name, vertices, list, PolygonOrder::Given)?, of))
}

/// A world that consists of pieces.
pub(crate) struct Solid {
    world: World,
    /// The piece of each slot.
    piece: Vec<u32>,
}

/// A pixel of a view with a predicted piece and a measurement.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PixelComparison {
    pub view: usize,
    pub pixel: usize,
    pub piece: u32,
    /// Predicted range, metres.
    pub predicted: f64,
    /// Measured range, metres; infinite without a return.
    pub measured: f64,
}

impl Solid {
    pub fn new(views: &Views, pieces: &[Piece]) -> Result<Self> {
        let mut environment = Environment::new();
        environment.add_material(Material::named("explored"))?;
        let (mesh, piece) = mesh("explored", pieces.iter().map(|p| &p.corners[..]), DVec3::ZERO)?;
        environment.insert(NewObject::new(
            "explored",
            Pose { translation: views.base(), ..Pose::IDENTITY },
            mesh.into(),
        ))?;
        Ok(Self { world: World::new(environment), piece })
    }

    /// Compares all pixels of the views that have a measurement, which may be the absence of a return, and a
    /// prediction.
    pub fn compare(&self, predictor: &mut Predictor, views: &Views, visit: impl FnMut(PixelComparison)) -> Result<()> {
        compare(predictor, &self.world, views, |slot| self.piece[slot as usize], visit)
    }
}

/// Compares all pixels of the views that have a measurement and a prediction. `number` maps the slot of a polygon to
/// [`PixelComparison::piece`].
pub(crate) fn compare(
    predictor: &mut Predictor,
    world: &World,
    views: &Views,
    number: impl Fn(u32) -> u32,
    mut visit: impl FnMut(PixelComparison),
) -> Result<()> {
    let outputs = Outputs::of(&[Output::Range, Output::PolygonId]);
    let mut images = Images::default();
    for (at, view) in views.all().iter().enumerate() {
        predictor.predict_images(world, view.sensor(), &view.pose, outputs, &mut images)?;
        for pixel in 0..view.ranges.len() {
            let (predicted, measured, id) = (images.range[pixel], view.ranges[pixel], images.polygon_id[pixel]);
            if id > 0 && predicted.is_finite() && !measured.is_nan() {
                let (predicted, measured) = (f64::from(predicted), f64::from(measured));
                visit(PixelComparison { view: at, pixel, piece: number(id - 1), predicted, measured });
            }
        }
    }
    Ok(())
}

/// Planes fitted to the rays that end on their pieces, robust against other surfaces. `tolerance` is the distance at
/// which the weight of a ray is halved, metres, by plane.
pub(crate) fn refitted(
    predictor: &mut Predictor,
    views: &Views,
    solid: &Solid,
    pieces: &[Piece],
    planes: &[Flat],
    tolerance: &[f64],
) -> Result<Vec<Flat>> {
    let mut fits = vec![PlaneFit::ZERO; planes.len()];
    solid.compare(predictor, views, |at| {
        let k = pieces[at.piece as usize].plane as usize;
        if (at.predicted - at.measured).abs() <= SAME_SURFACE * tolerance[k] {
            let view = &views.all()[at.view];
            let ray = view.ray(at.pixel);
            let cosine = ray.dot(planes[k].normal).abs();
            fits[k].add(&planes[k], view.origin() + ray * at.measured, cosine, tolerance[k]);
        }
    })?;
    let moved = |(plane, fit): (&Flat, &PlaneFit)| {
        if fit.weight < MIN_WEIGHT {
            return *plane;
        }
        let ([x, y], change) = (plane.axes(), fit.correction());
        let normal = (plane.normal - x * change.y - y * change.z).normalize();
        Flat { centre: plane.centre + plane.normal * change.x, normal }
    };
    Ok(planes.iter().zip(&fits).map(moved).collect())
}

/// Numbers of pixels for and against a piece.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PixelCounts {
    /// Pixels that it explains.
    pub explained: u32,
    /// Pixels with a measurement behind it.
    pub blocked: u32,
}

impl PixelCounts {
    /// Explained minus blocked pixels.
    pub fn gain(&self) -> i64 {
        i64::from(self.explained) - i64::from(self.blocked)
    }
}

/// Comparison of pieces and their planes with all views.
pub(crate) struct Verdicts {
    /// Pixels by piece.
    pub pixels: Vec<PixelCounts>,
    /// By plane: the standard deviation along its normal, metres.
    pub sigmas: Vec<f64>,
    /// By plane: the lowest index of the planes that a chain of views connects with it.
    pub parts: Vec<u32>,
}

/// Compares pieces with all views. `tolerance` is that of [`refitted`].
pub(crate) fn verdicts(
    predictor: &mut Predictor,
    views: &Views,
    solid: &Solid,
    pieces: &[Piece],
    tolerance: &[f64],
) -> Result<Verdicts> {
    let mut counts = vec![PixelCounts::default(); pieces.len()];
    // By plane: sum of squares, number of pixels, number of views, and the last view.
    let mut sums = vec![(0.0, 0.0, 0.0, usize::MAX); tolerance.len()];
    let (mut connected, mut first) = (UnionFind::new(tolerance.len()), (usize::MAX, 0));
    solid.compare(predictor, views, |seen| {
        let plane = pieces[seen.piece as usize].plane as usize;
        let (near, behind) = (4.0 * tolerance[plane], seen.measured - seen.predicted);
        let piece = &mut counts[seen.piece as usize];
        piece.explained += u32::from(behind.abs() < near);
        piece.blocked += u32::from(behind > 2.0 * near);
        if behind.abs() < near {
            let (squares, pixels, views, last) = &mut sums[plane];
            *squares += behind * behind;
            *pixels += 1.0;
            *views += if *last == seen.view { 0.0 } else { 1.0 };
            *last = seen.view;
            if first.0 != seen.view {
                first = (seen.view, plane as u32);
            }
            connected.join(first.1, plane as u32);
        }
    })?;
    // The pixels of one view share their errors, so the variance falls with the number of views, not of pixels.
    let sigma = |((squares, pixels, views, _), tolerance): (&(f64, f64, f64, usize), &f64)| {
        if *views > 0.0 { (squares / pixels / views).sqrt().max(1e-4) } else { *tolerance }
    };
    let sigmas = sums.iter().zip(tolerance).map(sigma).collect();
    Ok(Verdicts { pixels: counts, sigmas, parts: connected.into_roots() })
}
