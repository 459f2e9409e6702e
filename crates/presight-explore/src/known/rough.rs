//! A model that is known beforehand: corrected where rays say that it is off, opened where they go through.

use crate::evidence::{Fences, Margins, evidence};
use crate::geometry::{Cells, Flat, area, convex, simplified};
use crate::observe::{Views, oriented};
use crate::surface::{mesh, visit_world};
use glam::{DAffine3, DMat3, DVec2, DVec3};
use presight_model::environment::{Environment, Mesh, NewObject, Object};
use presight_model::error::Result;
use presight_model::matrix::{Matrix, eigen};
use presight_model::world::World;
use presight_predict::predict::Predictor;
use std::collections::BTreeMap;

/// How far surfaces may be off, metres: tolerances of the fits, in turn. A ray counts half at its tolerance.
const TOLERANCES: [f64; 4] = [0.15, 0.08, 0.03, 0.01];
/// Rays farther off than this many tolerances show something else.
const CAPTURE: f64 = 2.0;
/// Least cosine between the measured normal and the model's.
const ALIKE: f64 = 0.9;
/// Rays that must end on a plane before it moves.
const LEAST_RAYS: f64 = 30.0;
/// Corners and planes within this are the same, metres.
const SAME: f64 = 1e-4;
/// Rays end on a plane within the first, and went through it beyond the second, metres.
const MARGINS: Margins = Margins { hit: 0.02, pass: 0.05 };

/// A plane of an object, with what rays say about it.
struct Face {
    flat: Flat,
    a: DMat3,
    b: DVec3,
    rays: f64,
}

/// The planes of an object: polygons on one plane are one face.
struct Faces {
    faces: Vec<Face>,
    of_polygon: Vec<usize>,
}

impl Faces {
    fn of(object: &Object, base: DVec3) -> Self {
        let (mut faces, mut of_polygon) = (Vec::<Face>::new(), Vec::new());
        for polygon in 0..object.mesh.polygon_count() as u32 {
            let corners: Vec<DVec3> = object.polygon_in_world(polygon).into_iter().map(|p| p - base).collect();
            let normal = normal_of(&corners);
            let is_same = |f: &Face| {
                f.flat.normal.dot(normal) > 1.0 - 1e-6 && corners.iter().all(|p| f.flat.above(*p).abs() < SAME)
            };
            let known = faces.iter().position(is_same);
            of_polygon.push(known.unwrap_or_else(|| {
                let centre = corners.iter().sum::<DVec3>() / corners.len() as f64;
                let flat = Flat { centre, normal };
                faces.push(Face { flat, a: DMat3::ZERO, b: DVec3::ZERO, rays: 0.0 });
                faces.len() - 1
            }));
        }
        Self { faces, of_polygon }
    }
}

fn normal_of(corners: &[DVec3]) -> DVec3 {
    let sum: DVec3 = (1..corners.len() - 1).map(|k| (corners[k] - corners[0]).cross(corners[k + 1] - corners[0])).sum();
    sum.normalize_or(DVec3::Z)
}

/// The environment with its objects where the rays end, under their own paths. Features and poses stay.
///
/// # Errors
/// Those of predictions and of meshes.
pub(crate) fn corrected(environment: &Environment, views: &Views, predictor: &mut Predictor) -> Result<Environment> {
    let mut now = environment.clone();
    for tolerance in TOLERANCES {
        let world = World::new(now.clone());
        let mut faces: Vec<Faces> = now.objects().iter().map(|o| Faces::of(o, views.base())).collect();
        weigh(&world, views, predictor, tolerance, &mut faces)?;
        for (index, faces) in faces.iter().enumerate() {
            if let Some(mesh) = moved(&now.objects()[index], faces, views.base()) {
                replace(&mut now, index, mesh)?;
            }
        }
    }
    Ok(now)
}

/// Collects the normal equations of each face.
fn weigh(world: &World, views: &Views, predictor: &mut Predictor, tolerance: f64, faces: &mut [Faces]) -> Result<()> {
    let environment = world.environment().clone();
    visit_world(
        predictor,
        world,
        views,
        1,
        |slot| slot,
        |seen| {
            if (seen.measured - seen.predicted).abs() > CAPTURE * tolerance {
                return;
            }
            let view = &views.all()[seen.view];
            let (width, height) = (view.width(), view.height());
            let (column, row) = (seen.pixel % width, seen.pixel / width);
            if column == 0 || row == 0 || column + 1 == width || row + 1 == height {
                return;
            }
            let Some((p, normal, _)) = oriented(view, seen.pixel) else { return };
            let Some((object, polygon)) = environment.locate(seen.piece) else { return };
            let faces = &mut faces[object as usize];
            let face = &mut faces.faces[faces.of_polygon[polygon as usize]];
            if view.turned(normal).dot(face.flat.normal).abs() < ALIKE {
                return;
            }
            let p = view.origin() + view.turned(p);
            let off = face.flat.above(p);
            let [x, y] = face.flat.axes();
            let weight = 1.0 / (1.0 + (off / tolerance).powi(2));
            let j = DVec3::new(1.0, (p - face.flat.centre).dot(x), (p - face.flat.centre).dot(y));
            face.a += DMat3::from_cols(j * (weight * j.x), j * (weight * j.y), j * (weight * j.z));
            face.b += j * (weight * off);
            face.rays += weight;
        },
    )
}

/// The object's mesh in its frame, without scale, after its faces moved; `None` if none did, or if polygons would bend.
fn moved(object: &Object, faces: &Faces, base: DVec3) -> Option<Mesh> {
    let heights: Vec<Option<DVec3>> = faces.faces.iter().map(height).collect();
    let shift = shift(faces, &heights);
    if heights.iter().all(Option::is_none) {
        return None;
    }
    // Corners at one place move together.
    let mut at: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
    let key = |p: DVec3| (p / SAME).round().to_array().map(|c| c as i64);
    let polygons: Vec<Vec<DVec3>> = (0..object.mesh.polygon_count() as u32)
        .map(|polygon| object.polygon_in_world(polygon).into_iter().map(|p| p - base).collect())
        .collect();
    for (polygon, face) in polygons.iter().zip(&faces.of_polygon) {
        polygon.iter().for_each(|p| at.entry(key(*p)).or_default().push(*face));
    }
    let object_from_world = object.world_from_object.inverse();
    let place = |p: DVec3| {
        let rest = |face: usize| match heights[face] {
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
        let to = p + shift + least(own.into_iter().map(rest));
        object_from_world.transform_point(to + base)
    };
    let placed: Vec<Vec<DVec3>> = polygons.iter().map(|polygon| polygon.iter().map(|p| place(*p)).collect()).collect();
    let (mesh, of) = mesh(object.mesh.name(), placed.iter().map(|p| &p[..]), DVec3::ZERO).ok()?;
    (of.len() == placed.len()).then_some(mesh)
}

/// Height over the centre and slopes that a face has to change by; `None` if too few rays say so.
fn height(face: &Face) -> Option<DVec3> {
    if face.rays < LEAST_RAYS {
        return None;
    }
    let held = 0.02 * (face.a.y_axis.y + face.a.z_axis.z) + 1e-4;
    let change = (face.a + DMat3::from_diagonal(DVec3::new(1e-6, held, held))).inverse() * face.b;
    change.is_finite().then_some(change)
}

/// The way of the whole object that explains most of what its faces say, by least squares; 0 along what none says.
fn shift(faces: &Faces, heights: &[Option<DVec3>]) -> DVec3 {
    least(faces.faces.iter().zip(heights).filter_map(|(face, height)| Some((face.flat.normal, height.as_ref()?.x))))
}

/// The shortest way that goes this far along each of the directions, by least squares.
fn least(ways: impl Iterator<Item = (DVec3, f64)>) -> DVec3 {
    let (mut m, mut b): (Matrix, DVec3) = ([[0.0; 6]; 6], DVec3::ZERO);
    for (n, far) in ways {
        let n = n.to_array();
        (0..3).for_each(|i| (0..3).for_each(|j| m[i][j] += n[i] * n[j]));
        b += DVec3::from(n) * far;
    }
    let (values, vectors) = eigen(m, 3);
    let axis = |k: usize| DVec3::new(vectors[0][k], vectors[1][k], vectors[2][k]);
    (0..3).filter(|k| values[*k] > 1e-3).map(|k| axis(k) * (axis(k).dot(b) / values[k])).sum()
}

/// Gives an object another mesh in its own frame. Its index changes, its path does not.
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

/// The environment without what rays went through; objects without any part left are gone. Also returns the area
/// that was opened, square metres. `cell` is the side of the cells that are distinguished, metres.
pub(crate) fn opened(environment: &Environment, views: &Views, cell: f64) -> Result<(Environment, f64)> {
    let (mut now, mut open) = (environment.clone(), 0.0);
    for index in 0..environment.objects().len() {
        let object = &environment.objects()[index];
        let (mut polygons, mut lost) = (Vec::new(), 0.0);
        let object_from_world = object.world_from_object.inverse();
        for polygon in 0..object.mesh.polygon_count() as u32 {
            let corners: Vec<DVec3> = object.polygon_in_world(polygon).into_iter().map(|p| p - views.base()).collect();
            let (parts, gone) = left_over(&corners, views, cell);
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

/// The parts of a polygon that rays did not go through, and the area of the rest.
fn left_over(corners: &[DVec3], views: &Views, cell: f64) -> (Vec<Vec<DVec3>>, f64) {
    let flat = Flat { centre: corners[0], normal: normal_of(corners) };
    let outline: Vec<DVec2> = corners.iter().map(|p| flat.place(*p)).collect();
    let (least, most) = outline.iter().fold((outline[0], outline[0]), |(a, b), q| (a.min(*q), b.max(*q)));
    let cells = Cells::covering(least, most, cell);
    let is_inside = |q: DVec2| {
        (0..outline.len()).all(|k| (outline[(k + 1) % outline.len()] - outline[k]).perp_dot(q - outline[k]) >= 0.0)
    };
    let inside: Vec<usize> = (0..cells.len()).filter(|c| is_inside(cells.middle(*c))).collect();
    let middles: Vec<DVec2> = inside.iter().map(|c| cells.middle(*c)).collect();
    let seen = evidence(views, &flat, &middles, &Fences::default(), MARGINS);
    let mut field = vec![-1.0; cells.len()];
    let mut passed = 0;
    for (cell, seen) in inside.iter().zip(&seen) {
        let through = seen.pass > seen.hit && seen.passes >= 2;
        passed += usize::from(through);
        field[*cell] = if through { -1.0 } else { 1.0 };
    }
    // A few cells are noise at edges.
    if passed < 10 {
        return (vec![corners.to_vec()], 0.0);
    }
    let lines = cells.contours(&cells.smoothed(&field)).into_iter().map(|line| simplified(&line, cells.side));
    let lines: Vec<_> = lines.filter(|line| line.len() > 2 && area(line).abs() > 4.0 * cell * cell).collect();
    let parts = convex(&lines).into_iter().map(|part| part.into_iter().map(|q| flat.point(q)).collect()).collect();
    (parts, passed as f64 * cells.side * cells.side)
}

/// For each view, the pixels that the environment explains within a tolerance, metres.
pub(crate) fn explained(
    environment: &Environment,
    views: &Views,
    predictor: &mut Predictor,
    tolerance: f64,
) -> Result<Vec<Vec<bool>>> {
    let mut explained: Vec<Vec<bool>> = views.all().iter().map(|v| vec![false; v.ranges.len()]).collect();
    let world = World::new(environment.clone());
    visit_world(
        predictor,
        &world,
        views,
        1,
        |slot| slot,
        |seen| {
            explained[seen.view][seen.pixel] = (seen.measured - seen.predicted).abs() < tolerance;
        },
    )?;
    Ok(explained)
}
