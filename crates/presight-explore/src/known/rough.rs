//! Correction of a given model: its faces move to the ends of the rays, and open where rays pass through them.

use crate::evidence::{Fences, Margins, evidence};
use crate::geometry::{Cells, Flat, area, bounds, convex, doubled_area, is_inside, simplified};
use crate::observe::{Views, oriented};
use crate::surface::{PlaneFit, compare, mesh};
use glam::{DAffine3, DVec2, DVec3};
use presight_model::environment::{Environment, Mesh, NewObject, Object};
use presight_model::error::Result;
use presight_model::matrix::{Matrix, eigen};
use presight_model::world::World;
use presight_predict::predict::Predictor;
use std::collections::BTreeMap;

/// Tolerances of the successive fits, metres: the distance at which the weight of a ray is halved.
const TOLERANCES: [f64; 4] = [0.15, 0.08, 0.03, 0.01];
/// Distance beyond which a ray belongs to another surface, in tolerances.
const CAPTURE: f64 = 2.0;
/// Minimum cosine between the measured normal and the normal of the model: 26 degrees.
const SIMILAR: f64 = 0.9;
/// Minimum weight of the rays that move a face.
const MIN_RAYS: f64 = 30.0;
/// Maximum distance between identical corners or planes, metres.
const SAME: f64 = 1e-4;
/// Margins of hits and passes for a model without noise, metres.
const MARGINS: Margins = Margins { hit: 0.02, pass: 0.05 };

/// A plane of an object with the fit of its correction.
struct Face {
    flat: Flat,
    fit: PlaneFit,
}

/// The faces of an object. Polygons on one plane form one face.
struct Faces {
    faces: Vec<Face>,
    of_polygon: Vec<usize>,
}

impl Faces {
    fn of(object: &Object, base: DVec3) -> Self {
        let (mut faces, mut of_polygon) = (Vec::<Face>::new(), Vec::new());
        for polygon in 0..object.mesh.polygon_count() as u32 {
            let corners = corners_of(object, polygon, base);
            let normal = normal_of(&corners);
            let is_same = |f: &Face| {
                f.flat.normal.dot(normal) > 1.0 - 1e-6 && corners.iter().all(|p| f.flat.above(*p).abs() < SAME)
            };
            let known = faces.iter().position(is_same);
            of_polygon.push(known.unwrap_or_else(|| {
                let centre = corners.iter().sum::<DVec3>() / corners.len() as f64;
                let flat = Flat { centre, normal };
                faces.push(Face { flat, fit: PlaneFit::ZERO });
                faces.len() - 1
            }));
        }
        Self { faces, of_polygon }
    }
}

fn normal_of(corners: &[DVec3]) -> DVec3 {
    doubled_area(corners).normalize_or(DVec3::Z)
}

/// Corners of a polygon of an object, relative to the base of the views.
fn corners_of(object: &Object, polygon: u32, base: DVec3) -> Vec<DVec3> {
    object.polygon_in_world(polygon).into_iter().map(|p| p - base).collect()
}

/// The environment after its faces moved to the ends of the rays. Paths, features and poses stay.
///
/// # Errors
/// Those of predictions and of meshes.
pub(crate) fn corrected(environment: &Environment, views: &Views, predictor: &mut Predictor) -> Result<Environment> {
    let mut now = environment.clone();
    for tolerance in TOLERANCES {
        let world = World::new(now.clone());
        let mut faces: Vec<Faces> = now.objects().iter().map(|o| Faces::of(o, views.base())).collect();
        fit(&world, views, predictor, tolerance, &mut faces)?;
        for (index, faces) in faces.iter().enumerate() {
            if let Some(mesh) = moved(&now.objects()[index], faces, views.base()) {
                replace(&mut now, index, mesh)?;
            }
        }
    }
    Ok(now)
}

/// Adds the rays to the fits of the faces.
fn fit(world: &World, views: &Views, predictor: &mut Predictor, tolerance: f64, faces: &mut [Faces]) -> Result<()> {
    let environment = world.environment().clone();
    compare(
        predictor,
        world,
        views,
        |slot| slot,
        |seen| {
            if (seen.measured - seen.predicted).abs() > CAPTURE * tolerance {
                return;
            }
            let view = &views.all()[seen.view];
            let (column, row) = (seen.pixel % view.width(), seen.pixel / view.width());
            if column == 0 || row == 0 || column + 1 == view.width() || row + 1 == view.height() {
                return;
            }
            let Some((p, normal, _)) = oriented(view, seen.pixel) else { return };
            let Some((object, polygon)) = environment.locate(seen.piece) else { return };
            let faces = &mut faces[object as usize];
            let Face { flat, fit } = &mut faces.faces[faces.of_polygon[polygon as usize]];
            if view.direction_to_world(normal).dot(flat.normal).abs() >= SIMILAR {
                fit.add(flat, view.origin() + view.direction_to_world(p), 1.0, tolerance);
            }
        },
    )
}

/// The object's mesh after its faces moved, in its frame without scale; `None` if no face moved, or if a polygon would
/// bend.
fn moved(object: &Object, faces: &Faces, base: DVec3) -> Option<Mesh> {
    let changes: Vec<Option<DVec3>> = faces.faces.iter().map(correction).collect();
    let shift = shift(faces, &changes);
    if changes.iter().all(Option::is_none) {
        return None;
    }
    // Corners at one position move together.
    let mut at: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
    let key = |p: DVec3| (p / SAME).round().to_array().map(|c| c as i64);
    let polygons: Vec<Vec<DVec3>> =
        (0..object.mesh.polygon_count() as u32).map(|polygon| corners_of(object, polygon, base)).collect();
    for (polygon, face) in polygons.iter().zip(&faces.of_polygon) {
        polygon.iter().for_each(|p| at.entry(key(*p)).or_default().push(*face));
    }
    let object_from_world = object.world_from_object.inverse();
    let place = |p: DVec3| {
        let rest = |face: usize| match changes[face] {
            Some(change) => {
                let face = &faces.faces[face].flat;
                let q = face.place(p);
                (face.normal, change.x + change.y * q.x + change.z * q.y - shift.dot(face.normal))
            }
            None => (faces.faces[face].flat.normal, 0.0),
        };
        let mut own = at[&key(p)].clone();
        own.sort_unstable();
        own.dedup();
        let to = p + shift + shortest(own.into_iter().map(rest));
        object_from_world.transform_point(to + base)
    };
    let placed: Vec<Vec<DVec3>> = polygons.iter().map(|polygon| polygon.iter().map(|p| place(*p)).collect()).collect();
    let (mesh, of) = mesh(object.mesh.name(), placed.iter().map(|p| &p[..]), DVec3::ZERO).ok()?;
    (of.len() == placed.len()).then_some(mesh)
}

/// The correction of a face; `None` with too few rays.
fn correction(face: &Face) -> Option<DVec3> {
    let change = face.fit.correction();
    (face.fit.weight >= MIN_RAYS && change.is_finite()).then_some(change)
}

/// The least-squares translation of the whole object for the corrections of its faces; 0 along directions without a
/// face.
fn shift(faces: &Faces, changes: &[Option<DVec3>]) -> DVec3 {
    shortest(faces.faces.iter().zip(changes).filter_map(|(face, change)| Some((face.flat.normal, change.as_ref()?.x))))
}

/// The shortest translation with the given components along directions, by least squares.
fn shortest(components: impl Iterator<Item = (DVec3, f64)>) -> DVec3 {
    let (mut m, mut b): (Matrix, DVec3) = ([[0.0; 6]; 6], DVec3::ZERO);
    for (n, component) in components {
        let n = n.to_array();
        (0..3).for_each(|i| (0..3).for_each(|j| m[i][j] += n[i] * n[j]));
        b += DVec3::from(n) * component;
    }
    let (values, vectors) = eigen(m, 3);
    let axis = |k: usize| DVec3::new(vectors[0][k], vectors[1][k], vectors[2][k]);
    (0..3).filter(|k| values[*k] > 1e-3).map(|k| axis(k) * (axis(k).dot(b) / values[k])).sum()
}

/// Replaces the mesh of an object, in the object's frame. The object keeps its path, but not its index.
fn replace(environment: &mut Environment, index: usize, mesh: Mesh) -> Result<()> {
    let object = &environment.objects()[index];
    let material = object.mesh.materials().first().copied().unwrap_or(0);
    let new = NewObject {
        object_from_mesh: DAffine3::IDENTITY,
        ..NewObject::new(object.name.clone(), object.world_from_object, mesh.with_materials(|_| material).into())
    };
    let name = object.name.clone();
    environment.delete(&name)?;
    environment.insert(new).map(drop)
}

/// The environment with openings where rays passed, and the area of the openings, square metres. Objects without a
/// remaining part are deleted. `cell` is the size of the cells, metres.
pub(crate) fn opened(environment: &Environment, views: &Views, cell: f64) -> Result<(Environment, f64)> {
    let (mut now, mut open) = (environment.clone(), 0.0);
    for index in 0..environment.objects().len() {
        let object = &environment.objects()[index];
        let (mut polygons, mut lost) = (Vec::new(), 0.0);
        let object_from_world = object.world_from_object.inverse();
        for polygon in 0..object.mesh.polygon_count() as u32 {
            let corners = corners_of(object, polygon, views.base());
            let (parts, gone) = remainder(&corners, views, cell);
            lost += gone;
            let in_object = |p: DVec3| object_from_world.transform_point(p + views.base());
            polygons.extend(parts.into_iter().map(|part| part.into_iter().map(in_object).collect::<Vec<_>>()));
        }
        if lost == 0.0 {
            continue;
        }
        open += lost;
        if polygons.is_empty() {
            let name = object.name.clone();
            now.delete(&name)?;
        } else {
            let (mesh, _) = mesh(object.mesh.name(), polygons.iter().map(|p| &p[..]), DVec3::ZERO)?;
            let index = now.index_of(&object.name)? as usize;
            replace(&mut now, index, mesh)?;
        }
    }
    Ok((now, open))
}

/// The parts of a polygon that rays did not pass through, and the area of the rest, square metres.
fn remainder(corners: &[DVec3], views: &Views, cell: f64) -> (Vec<Vec<DVec3>>, f64) {
    let flat = Flat { centre: corners[0], normal: normal_of(corners) };
    let outline: Vec<DVec2> = corners.iter().map(|p| flat.place(*p)).collect();
    let cells = Cells::covering(bounds(outline.iter().copied()), cell);
    let inside: Vec<usize> = (0..cells.len()).filter(|c| is_inside(cells.middle(*c), &outline, 0.0)).collect();
    let middles: Vec<DVec2> = inside.iter().map(|c| cells.middle(*c)).collect();
    let seen = evidence(views, &flat, &middles, &Fences::default(), MARGINS);
    let mut field = vec![-1.0; cells.len()];
    let mut passed = 0;
    for (cell, seen) in inside.iter().zip(&seen) {
        let through = seen.pass > seen.hit && seen.passes >= 2;
        passed += usize::from(through);
        field[*cell] = if through { -1.0 } else { 1.0 };
    }
    // Fewer cells are noise at edges.
    if passed < 10 {
        return (vec![corners.to_vec()], 0.0);
    }
    let lines = cells.contours(&cells.smoothed(&field)).into_iter().map(|line| simplified(&line, cells.side));
    let lines: Vec<_> = lines.filter(|line| line.len() > 2 && area(line).abs() > 4.0 * cell * cell).collect();
    let parts = convex(&lines).into_iter().map(|part| part.into_iter().map(|q| flat.point(q)).collect()).collect();
    (parts, passed as f64 * cells.side * cells.side)
}

/// By view and pixel: true if the environment explains the range within a tolerance, metres.
pub(crate) fn explained(
    environment: &Environment,
    views: &Views,
    predictor: &mut Predictor,
    tolerance: f64,
) -> Result<Vec<Vec<bool>>> {
    let mut explained: Vec<Vec<bool>> = views.all().iter().map(|v| vec![false; v.ranges.len()]).collect();
    let world = World::new(environment.clone());
    compare(
        predictor,
        &world,
        views,
        |slot| slot,
        |seen| {
            explained[seen.view][seen.pixel] = (seen.measured - seen.predicted).abs() < tolerance;
        },
    )?;
    Ok(explained)
}
