//! The report of an import: counts, and every kind of problem with its first places.

use super::SceneFrame;
use glam::Vec3;
use presight_model::environment::Environment;
use presight_model::error::Result;
use presight_model::limits;
use presight_model::placement::{lost, why_off};
use presight_model::world::World;
use serde::Serialize;
use std::fmt;
use std::path::PathBuf;

/// An imported scene.
#[derive(Clone, Debug)]
pub struct ImportedScene {
    /// Objects and materials.
    pub environment: Environment,
    /// Counts and problems.
    pub report: ImportReport,
    /// The file's placement in the world; `None` for a script, which is in the world's frame.
    pub frame: Option<SceneFrame>,
    /// The files that the scene consists of: the given one, and all that it names, also images, which are not read.
    pub files: Vec<PathBuf>,
}

/// Counts and problems of an import. "Stored" counts each mesh once, "scene" each of its instances.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ImportReport {
    /// Triangles of all instances, degenerate ones included: one past the highest `source` number.
    pub triangles_in_scene: u64,
    /// Triangles of all used meshes, degenerate ones included.
    pub triangles_stored: u64,
    /// Polygons of all used meshes, after merging.
    pub polygons_stored: u64,
    /// Polygons of all instances, after merging.
    pub polygons_in_scene: u64,
    /// Merges of two neighbours into one polygon, in all used meshes.
    pub merges: u64,
    /// Maximum distance of any source vertex from the plane of its merged polygon, metres in the world.
    pub largest_deviation_m: f64,
    /// Problems by kind; kinds that did not occur are left out.
    pub problems: Vec<Problem>,
    /// A line for each part of a file that shapes the scene and is not followed, is left out, or has lost digits.
    pub notices: Vec<String>,
}

impl ImportReport {
    /// Number of problems of a kind.
    pub fn total(&self, kind: ProblemKind) -> u64 {
        self.problems.iter().find(|p| p.kind == kind).map_or(0, |p| p.total)
    }
}

/// A kind of problem of a model. Only parts without area or triangles are left out; the import repairs no geometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ProblemKind {
    /// A triangle without area (within its own rounding): left out.
    DegenerateTriangle,
    /// A triangle over the same three vertices as an earlier one, in either winding.
    DuplicateFace,
    /// An edge of more than two triangles; merging never crosses it.
    NonManifoldEdge,
    /// An edge of one triangle only.
    OpenBorder,
    /// An edge that both of its triangles traverse in the same direction.
    InconsistentWinding,
    /// A triangle whose height is under a thousandth of its longest side.
    Sliver,
    /// A closed shell whose normals point inwards.
    InsideOut,
    /// Points, lines, or a primitive without positions: left out.
    IgnoredPrimitive,
    /// Indices left over at the end, too few for a triangle: left out.
    LeftoverIndices,
    /// An object whose mesh has no polygon or no data, or that a scale of zero flattens: left out.
    EmptyMesh,
    /// An unsupported glTF feature that may shape the scene: an unknown extension, morph targets.
    IgnoredFeature,
    /// A mesh that lies too far from its own origin for 32 bits to hold a millimetre.
    LostPrecision,
    /// A feature of the scene's own layers whose surface was moved or deleted: left out of predictions.
    LostFeature,
}

impl ProblemKind {
    /// All kinds, in the order of reports.
    pub const ALL: [Self; 13] = [
        Self::DegenerateTriangle,
        Self::DuplicateFace,
        Self::NonManifoldEdge,
        Self::OpenBorder,
        Self::InconsistentWinding,
        Self::Sliver,
        Self::InsideOut,
        Self::IgnoredPrimitive,
        Self::LeftoverIndices,
        Self::EmptyMesh,
        Self::IgnoredFeature,
        Self::LostPrecision,
        Self::LostFeature,
    ];

    /// The name of the kind, in the plural.
    pub fn title(self) -> &'static str {
        match self {
            Self::DegenerateTriangle => "degenerate triangles (left out)",
            Self::DuplicateFace => "duplicate faces",
            Self::NonManifoldEdge => "non-manifold edges",
            Self::OpenBorder => "open border edges",
            Self::InconsistentWinding => "edges with inconsistent winding",
            Self::Sliver => "slivers",
            Self::InsideOut => "inside-out shells",
            Self::IgnoredPrimitive => "primitives without triangles (left out)",
            Self::LeftoverIndices => "primitives with leftover indices (left out)",
            Self::EmptyMesh => "objects without area (left out)",
            Self::IgnoredFeature => "unsupported glTF features (ignored)",
            Self::LostPrecision => "meshes that 32 bits round",
            Self::LostFeature => "features that no longer lie on a polygon (left out of predictions)",
        }
    }
}

/// One kind of problem with its count and first places.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// The kind of problem.
    pub kind: ProblemKind,
    /// Number of cases; each mesh counts once, however many instances it has.
    pub total: u64,
    /// The first places, at most [`limits::LISTED_PROBLEMS`].
    pub places: Vec<String>,
}

impl Problem {
    /// One line for the total, and one for each place, indented by `indent`.
    pub fn lines(&self, indent: &str) -> Vec<String> {
        let mut lines = vec![format!("{} {}", self.total, self.kind.title())];
        lines.extend(self.places.iter().map(|place| format!("{indent}{place}")));
        let more = self.total - self.places.len() as u64;
        lines.extend((more > 0).then(|| format!("{indent}and {more} more")));
        lines
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.lines("  ").join("\n"))
    }
}

/// The features of the environment's own layers that no longer lie on a polygon, as a problem; `None` if all do.
///
/// # Errors
/// As [`presight_model::placement::find`].
pub fn lost_features(environment: &Environment) -> Result<Option<Problem>> {
    let lost = lost(environment)?;
    if lost.is_empty() {
        return Ok(None);
    }
    let world = World::new(environment.clone());
    let why = |(class, id): &(String, u32)| {
        let layer = environment.layer(class)?;
        why_off(&world, class, layer.tolerance, environment.feature(class, *id)?)
    };
    let places = lost.iter().filter_map(why).take(limits::LISTED_PROBLEMS).map(|why| why.to_string()).collect();
    Ok(Some(Problem { kind: ProblemKind::LostFeature, total: lost.len() as u64, places }))
}

/// The place of a problem in a mesh. Only listed problems are described in words.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Site {
    /// Source number within the mesh.
    pub triangle: u32,
    /// The edge, if the problem concerns an edge.
    pub edge: Option<[Vec3; 2]>,
}

/// Problems of one mesh, counted and listed up to the limit.
#[derive(Clone, Debug, Default)]
pub(crate) struct ProblemList {
    totals: [u64; ProblemKind::ALL.len()],
    first: Vec<(ProblemKind, Site)>,
}

impl ProblemList {
    /// Counts a problem and keeps its place while there is room.
    pub fn add(&mut self, kind: ProblemKind, site: Site) {
        let total = &mut self.totals[kind as usize];
        if *total < limits::LISTED_PROBLEMS as u64 {
            self.first.push((kind, site));
        }
        *total += 1;
    }
}

/// The problems of all meshes.
#[derive(Debug, Default)]
pub(crate) struct ProblemBook {
    totals: [u64; ProblemKind::ALL.len()],
    places: [Vec<String>; ProblemKind::ALL.len()],
}

impl ProblemBook {
    /// Notes a problem with its own description.
    pub fn note(&mut self, kind: ProblemKind, place: impl FnOnce() -> String) {
        self.totals[kind as usize] += 1;
        let places = &mut self.places[kind as usize];
        if places.len() < limits::LISTED_PROBLEMS {
            places.push(place());
        }
    }

    /// The place of the first problem of a kind.
    pub fn first(&self, kind: ProblemKind) -> Option<&str> {
        self.places[kind as usize].first().map(String::as_str)
    }

    /// Adds the problems of a mesh; `words` describes a source triangle.
    pub fn extend(&mut self, list: &ProblemList, words: impl Fn(u32) -> String) {
        for (sum, n) in self.totals.iter_mut().zip(list.totals) {
            *sum += n;
        }
        for &(kind, site) in &list.first {
            let places = &mut self.places[kind as usize];
            if places.len() < limits::LISTED_PROBLEMS {
                let triangle = words(site.triangle);
                places.push(match site.edge {
                    None => triangle,
                    Some([a, b]) => format!("{triangle}, edge from {a} to {b}"),
                });
            }
        }
    }

    /// The kinds of problems that occurred.
    pub fn into_problems(self) -> Vec<Problem> {
        let each = ProblemKind::ALL.into_iter().zip(self.totals).zip(self.places);
        each.filter(|((_, total), _)| *total > 0)
            .map(|((kind, total), places)| Problem { kind, total, places })
            .collect()
    }
}
