//! The objects and groups of a scene: meshes at the places of their nodes.

use super::exact::RootPlacement;
use super::nodes::{SceneNode, Shape};
use super::notices::{LeftOut, kilometres};
use super::{BuiltMesh, paths, place_of};
use crate::preparation::{ImportReport, ProblemBook, ProblemKind, SceneFrame};
use glam::{DAffine3, DMat3, DVec3, Vec3};
use presight_model::environment::{Environment, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::limits;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

/// From this distance of neighbouring 32-bit numbers on, metres, vertices no longer hold a millimetre.
const COARSE: f64 = 1.0 / 1024.0;

/// An environment that objects are placed in, with its report.
pub(super) struct Placement {
    pub environment: Environment,
    pub report: ImportReport,
    pub book: ProblemBook,
    frame: SceneFrame,
    /// Objects that a scale of zero leaves without area.
    flat: LeftOut,
    /// Meshes whose vertices are too far from the mesh's origin: the distance of neighbouring numbers, and the reach,
    /// metres.
    coarse: BTreeMap<usize, (f64, f64)>,
}

impl Placement {
    pub fn new(environment: Environment, book: ProblemBook, frame: SceneFrame) -> Self {
        let report = ImportReport::default();
        Self { environment, report, book, frame, flat: LeftOut::default(), coarse: BTreeMap::new() }
    }

    /// Counts a mesh and its problems. `words` name it.
    pub fn count(&mut self, built: &BuiltMesh, words: &str) {
        self.report.triangles_stored += u64::from(built.source_count);
        self.report.merges += built.merges;
        self.report.polygons_stored += built.mesh.polygon_count() as u64;
        built.notes.iter().for_each(|(kind, words)| self.book.note(*kind, || words.clone()));
        self.book.extend(&built.problems, |triangle| {
            let (primitive, number) = built.place_of(triangle);
            format!("{words}: primitive {primitive}, triangle {number}")
        });
    }

    /// Inserts the objects of the nodes and the frames of their groups.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] for an object that is too far or too large, and if there is no polygon.
    pub fn insert_all(&mut self, nodes: &[SceneNode], by_shape: &HashMap<Shape, BuiltMesh>) -> Result<()> {
        let world_from_gltf = self.frame.world_from_file();
        // Our own writer writes files without a sidecar.
        let exact = self.frame == SceneFrame::default();
        let built_of = |node: &SceneNode| by_shape.get(&node.shape()?);
        let is_flat = |node: &SceneNode| flattens(&node.scene_from_node.matrix3);
        let address = |node: &SceneNode| std::ptr::from_ref(node).addr();
        let flat = nodes.iter().filter(|node| is_flat(node));
        let plates: HashMap<usize, Arc<Mesh>> = flat
            .filter_map(|node| Some((address(node), plate(built_of(node)?, &node.scene_from_node.matrix3)?)))
            .collect();
        let plate_of = |node: &SceneNode| plates.get(&address(node));
        let is_object = |node: &SceneNode| {
            built_of(node).is_some_and(|b| b.mesh.polygon_count() > 0) && (!is_flat(node) || plate_of(node).is_some())
        };
        let paths = paths::paths(nodes, is_object);
        let mut first_source = 0u32;
        for (node, path) in nodes.iter().zip(&paths) {
            let place = || place_of(node);
            let Some(built) = built_of(node) else { continue };
            self.report.triangles_in_scene += u64::from(built.source_count);
            match path.as_deref().filter(|_| is_object(node)) {
                None if is_flat(node) => {
                    self.book.note(ProblemKind::EmptyMesh, || format!("{}: a scale of zero", place()));
                    self.flat.add(place);
                }
                None => self.book.note(ProblemKind::EmptyMesh, place),
                Some(path) => {
                    self.report.polygons_in_scene += built.mesh.polygon_count() as u64;
                    let world_from_mesh = world_from_gltf * node.scene_from_node;
                    let new = match plate_of(node) {
                        Some(mesh) => {
                            let placed = DAffine3::from_translation(node.scene_from_node.translation);
                            NewObject::from_affine(path, world_from_gltf * placed, mesh.clone())
                                .map(|new| NewObject { first_source, ..new })
                        }
                        None => object(node, path, built, first_source, (&world_from_mesh, exact)),
                    };
                    let new = new.map_err(|e| e.at(place()))?;
                    self.note_digits(node, built, &world_from_mesh.matrix3);
                    insert(&mut self.environment, new).map_err(|e| e.at(place()))?;
                }
            }
            // Cannot overflow, because the sum over all nodes is below the limit on polygons.
            first_source += built.source_count;
        }
        let groups = nodes.iter().zip(paths).filter(|(node, _)| !is_object(node));
        self.set_frames(groups.filter_map(|(node, path)| Some((node, path?))), &world_from_gltf, exact);
        self.settle(nodes, &world_from_gltf, exact);
        self.check_not_empty()
    }

    fn set_frames<'a>(
        &mut self,
        groups: impl Iterator<Item = (&'a SceneNode, String)>,
        world_from_gltf: &DAffine3,
        exact: bool,
    ) {
        for (node, path) in groups {
            // A matrix without a rigid part is refused; the group then has the frame of its parent.
            let _ = self.environment.set_frame(&path, Some(frame_of_group(node, world_from_gltf, exact)));
        }
    }

    fn settle(&mut self, nodes: &[SceneNode], world_from_gltf: &DAffine3, exact: bool) {
        let environment = &mut self.environment;
        environment.settle_groups();
        for node in nodes.iter().filter(|node| matches!(node.placed, Some(RootPlacement::Group(_)))) {
            // Our own writer names the node by the group's path; the group's objects are not its children.
            let free = environment.object(&node.name).is_none() && environment.group(&node.name).is_none();
            if free && environment.has_below(&node.name) {
                let _ = environment.set_frame(&node.name, Some(frame_of_group(node, world_from_gltf, exact)));
            }
        }
    }

    fn check_not_empty(&self) -> Result<()> {
        if self.environment.slot_count() > 0 {
            return Ok(());
        }
        let why = self.book.first(ProblemKind::EmptyMesh).map(|place| format!("; left out: {place}"));
        let why = why.unwrap_or_default();
        let remedy = "export meshes of triangles into the default scene of a .glb, which holds its buffers";
        Err(Error::invalid(format!("the scene has no polygons{why}"), remedy))
    }

    /// Notes an object whose vertices lose a millimetre because they hold map coordinates.
    fn note_digits(&mut self, node: &SceneNode, built: &BuiltMesh, world_from_mesh: &DMat3) {
        let deviation = built.deviation * largest_stretch(world_from_mesh);
        self.report.largest_deviation_m = self.report.largest_deviation_m.max(deviation);
        let bounds = built.mesh.bounds();
        let reach = bounds.min.abs().max(bounds.max.abs()).max_element();
        // A wide mesh around its own origin would not gain digits from another origin.
        let is_wide = (bounds.max - bounds.min).max_element() > reach;
        let (Some(mesh), false) = (node.mesh, is_wide) else { return };
        let stretch = largest_stretch(world_from_mesh);
        let apart = stretch * spacing(reach);
        if apart >= COARSE {
            let coarsest = self.coarse.entry(mesh).or_default();
            coarsest.0 = coarsest.0.max(apart);
            coarsest.1 = coarsest.1.max(stretch * reach);
        }
    }

    /// Adds notices about objects to the report. `words` name a mesh.
    pub fn notices(&mut self, words: impl Fn(usize) -> String) -> Vec<String> {
        let mut lines: Vec<String> = self.flat.notice("a scale of zero leaves no area").into_iter().collect();
        let said = |(mesh, (apart, reach)): (&usize, &(f64, f64))| {
            // Rounded up, so that a loss is never shown as 0.
            let apart = (apart * 1e3).ceil() / 1e3;
            let away = kilometres(*reach);
            format!(
                "{}: its vertices are {apart} m apart at best, because they lie {away} from the mesh's origin",
                words(*mesh)
            )
        };
        let all: Vec<String> = self.coarse.iter().map(said).collect();
        all.iter().for_each(|line| self.book.note(ProblemKind::LostPrecision, || line.clone()));
        if let [first, others @ ..] = &all[..] {
            let more = if others.is_empty() { String::new() } else { format!(" (and {} more meshes)", others.len()) };
            lines.push(format!("{first}{more}; export them around a local origin and move the node"));
        }
        lines
    }
}

/// The distance from a 32-bit number to the next.
fn spacing(x: f64) -> f64 {
    let x = x as f32;
    f64::from(x.next_up()) - f64::from(x)
}

/// True for a matrix that leaves no volume because a scale in it is zero.
fn flattens(m: &DMat3) -> bool {
    let lengths = [m.x_axis.length(), m.y_axis.length(), m.z_axis.length()];
    let product: f64 = lengths.iter().product();
    m.is_finite() && (lengths.contains(&0.0) || m.determinant().abs() <= 1e-12 * product)
}

/// What a scale of zero along one axis leaves of a mesh: the polygons that keep an area, all in one plane. `None` if it
/// leaves no area.
fn plate(built: &BuiltMesh, m: &DMat3) -> Option<Arc<Mesh>> {
    /// Doubled area by the square of the longest side: beyond the rounding of f32.
    const LEAST: f64 = 1e-5;
    let mesh = &built.mesh;
    let vertices: Vec<Vec3> = mesh.vertices().iter().map(|v| (*m * v.as_dvec3()).as_vec3()).collect();
    let at = |corner: u32| vertices[corner as usize].as_dvec3();
    let has_area = |corners: &[u32]| {
        let sides = || corners.iter().zip(corners.iter().cycle().skip(1)).map(|(a, b)| (at(*a), at(*b)));
        let doubled: DVec3 = sides().map(|(a, b)| (a - at(corners[0])).cross(b - at(corners[0]))).sum();
        let longest = sides().map(|(a, b)| a.distance_squared(b)).fold(0.0, f64::max);
        doubled.length() > LEAST * longest
    };
    let polygon = |k: u32| {
        let corners = mesh.corner_indices(k).to_vec();
        has_area(&corners).then(|| Polygon { corners, material: mesh.material(k), source: mesh.source(k) })
    };
    let polygons: Vec<Polygon> = (0..mesh.polygon_count() as u32).filter_map(polygon).collect();
    let flat = Mesh::new(mesh.name(), vertices, polygons, PolygonOrder::Spatial).ok()?;
    (flat.polygon_count() > 0).then(|| Arc::new(flat))
}

/// The greatest factor by which a transform stretches a length: exact for scales along the axes, a bound for shears.
fn largest_stretch(m: &DMat3) -> f64 {
    let [x, y, z] = [m.x_axis, m.y_axis, m.z_axis];
    let longest = x.length().max(y.length()).max(z.length());
    let skew = x.dot(y).abs().max(y.dot(z).abs()).max(z.dot(x).abs());
    // M^T M = D + S with |S| <= 2 max |s|.
    (longest * longest + 2.0 * skew).sqrt()
}

/// Makes the object of a node.
fn object(
    node: &SceneNode,
    path: &str,
    built: &BuiltMesh,
    first_source: u32,
    (world_from_mesh, exact): (&DAffine3, bool),
) -> Result<NewObject> {
    let written = match &node.placed {
        Some(RootPlacement::Object(placed)) if exact => placed.object(&node.scene_from_node, path, built.mesh.clone()),
        _ => None,
    };
    Ok(match written {
        Some(new) if built.exact => new,
        // A mesh read from triangles gets new source numbers.
        Some(new) => NewObject { first_source, ..new },
        None => NewObject { first_source, ..NewObject::from_affine(path, *world_from_mesh, built.mesh.clone())? },
    })
}

fn insert(environment: &mut Environment, new: NewObject) -> Result<()> {
    let object = environment.insert(new)?;
    let bounds = environment.objects()[object as usize].world_bounds();
    let reach = bounds.min.abs().max(bounds.max.abs());
    if reach.is_finite() && reach.max_element() <= limits::MAX_COORDINATE {
        return Ok(());
    }
    let what = format!("it reaches beyond {} m", limits::MAX_COORDINATE);
    Err(Error::invalid(what, "check the scale: glTF is in metres"))
}

/// The frame of a node's group.
fn frame_of_group(node: &SceneNode, world_from_gltf: &DAffine3, exact: bool) -> Pose {
    let written = match &node.placed {
        Some(RootPlacement::Group(group)) if exact => group.frame(&node.scene_from_node),
        _ => None,
    };
    written.unwrap_or_else(|| Pose::rigid_part(&(*world_from_gltf * node.scene_from_node)))
}
