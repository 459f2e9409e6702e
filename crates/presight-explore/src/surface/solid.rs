//! Pieces as a world that predicts, and what the prediction says about them.

use super::outline::Piece;
use crate::geometry::Flat;
use crate::observe::Views;
use glam::{DMat3, DVec3, Vec3};
use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::union_find::UnionFind;
use presight_model::world::World;
use presight_predict::predict::Predictor;
use presight_render::plan::{Images, Output, Outputs};

/// Distances beyond this are of another surface, in units of the tolerance.
const SAME_SURFACE: f64 = 10.0;

/// The mesh of convex polygons with these corners, metres. Polygons that f32 cannot hold become triangles, or go.
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

/// A world of pieces alone.
pub(crate) struct Solid {
    world: World,
    /// The piece of each slot.
    piece: Vec<u32>,
}

/// What a view says about the piece that it should show at a pixel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    pub view: usize,
    pub pixel: usize,
    pub piece: u32,
    /// Metres along the ray.
    pub predicted: f64,
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

    /// Visits all pixels, of each `step`-th view, where something is measured, if only that nothing is within reach, and
    /// something predicted.
    pub fn visit(&self, predictor: &mut Predictor, views: &Views, step: usize, visit: impl FnMut(Seen)) -> Result<()> {
        visit_world(predictor, &self.world, views, step, |slot| self.piece[slot as usize], visit)
    }
}

/// Visits all pixels, of each `step`-th view, where something is measured and something predicted. `number` turns the
/// slots of polygons into the numbers that are visited.
pub(crate) fn visit_world(
    predictor: &mut Predictor,
    world: &World,
    views: &Views,
    step: usize,
    number: impl Fn(u32) -> u32,
    mut visit: impl FnMut(Seen),
) -> Result<()> {
    let outputs = Outputs::of(&[Output::Range, Output::PolygonId]);
    let mut images = Images::default();
    for (at, view) in views.all().iter().enumerate().step_by(step) {
        predictor.predict_images(world, view.sensor(), &view.world_from_sensor, outputs, &mut images)?;
        for pixel in 0..view.ranges.len() {
            let (predicted, measured, id) = (images.range[pixel], view.ranges[pixel], images.polygon_id[pixel]);
            if id > 0 && predicted.is_finite() && !measured.is_nan() {
                let (predicted, measured) = (f64::from(predicted), f64::from(measured));
                visit(Seen { view: at, pixel, piece: number(id - 1), predicted, measured });
            }
        }
    }
    Ok(())
}

/// Normal equations of a plane: its height over the centre and its two slopes.
#[derive(Clone, Copy)]
struct Normals {
    a: DMat3,
    b: DVec3,
    weight: f64,
}

/// Moves planes so that the rays which end on their pieces end on them: height and slopes, robust against other
/// surfaces. `tolerance` is the distance at which a ray counts half, metres, by plane.
pub(crate) fn refitted(
    predictor: &mut Predictor,
    views: &Views,
    solid: &Solid,
    pieces: &[Piece],
    planes: &[Flat],
    tolerance: &[f64],
) -> Result<Vec<Flat>> {
    let mut sums = vec![Normals { a: DMat3::ZERO, b: DVec3::ZERO, weight: 0.0 }; planes.len()];
    let axes: Vec<[DVec3; 2]> = planes.iter().map(Flat::axes).collect();
    solid.visit(predictor, views, 1, |seen| {
        let k = pieces[seen.piece as usize].plane as usize;
        if (seen.predicted - seen.measured).abs() > SAME_SURFACE * tolerance[k] {
            return;
        }
        let view = &views.all()[seen.view];
        let ray = view.ray(seen.pixel);
        let p = view.origin() + ray * seen.measured - planes[k].centre;
        let off = p.dot(planes[k].normal);
        let weight = ray.dot(planes[k].normal).abs() / (1.0 + (off / tolerance[k]).powi(2));
        let j = DVec3::new(1.0, p.dot(axes[k][0]), p.dot(axes[k][1]));
        sums[k].a += DMat3::from_cols(j * (weight * j.x), j * (weight * j.y), j * (weight * j.z));
        sums[k].b += j * (weight * off);
        sums[k].weight += weight;
    })?;
    let moved = |((plane, sum), [x, y]): ((&Flat, &Normals), &[DVec3; 2])| {
        if sum.weight < 5.0 {
            return *plane;
        }
        // Slopes of narrow planes are held.
        let held = 0.02 * (sum.a.y_axis.y + sum.a.z_axis.z) + 1e-4;
        let change = (sum.a + DMat3::from_diagonal(DVec3::new(1e-6, held, held))).inverse() * sum.b;
        let normal = (plane.normal - *x * change.y - *y * change.z).normalize();
        Flat { centre: plane.centre + plane.normal * change.x, normal }
    };
    Ok(planes.iter().zip(&sums).zip(&axes).map(moved).collect())
}

/// What rays say about a piece.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Shown {
    /// Pixels that it explains.
    pub explains: u32,
    /// Pixels that saw something behind it.
    pub blocks: u32,
}

/// What all views say about pieces and their planes.
pub(crate) struct Verdicts {
    /// By piece.
    pub shown: Vec<Shown>,
    /// By plane: its standard deviation along its normal, metres.
    pub sigmas: Vec<f64>,
    /// By plane: the lowest plane that a chain of views joins it with.
    pub parts: Vec<u32>,
}

/// What rays say about each piece, and about its plane.
pub(crate) fn shown(
    predictor: &mut Predictor,
    views: &Views,
    solid: &Solid,
    pieces: &[Piece],
    tolerance: &[f64],
) -> Result<Verdicts> {
    let mut shown = vec![Shown::default(); pieces.len()];
    // Squares, pixels, views and the last view of each plane.
    let mut sums = vec![(0.0, 0.0, 0.0, usize::MAX); tolerance.len()];
    let (mut parts, mut first) = (UnionFind::new(tolerance.len()), (usize::MAX, 0));
    solid.visit(predictor, views, 1, |seen| {
        let plane = pieces[seen.piece as usize].plane as usize;
        let (near, behind) = (4.0 * tolerance[plane], seen.measured - seen.predicted);
        let piece = &mut shown[seen.piece as usize];
        piece.explains += u32::from(behind.abs() < near);
        piece.blocks += u32::from(behind > 2.0 * near);
        if behind.abs() < near {
            let (squares, pixels, views, last) = &mut sums[plane];
            *squares += behind * behind;
            *pixels += 1.0;
            *views += if *last == seen.view { 0.0 } else { 1.0 };
            *last = seen.view;
            if first.0 != seen.view {
                first = (seen.view, plane as u32);
            }
            parts.join(first.1, plane as u32);
        }
    })?;
    // Errors of the pixels of one view are common to them, so that views count and pixels do not.
    let sigma = |((squares, pixels, views, _), tolerance): (&(f64, f64, f64, usize), &f64)| {
        if *views > 0.0 { (squares / pixels / views).sqrt().max(1e-4) } else { *tolerance }
    };
    let sigmas = sums.iter().zip(tolerance).map(sigma).collect();
    Ok(Verdicts { shown, sigmas, parts: parts.into_roots() })
}
