//! Shapes, which scripts make, rotate, join and place: polygons with materials and landmarks, in the frame of the
//! shape.

use super::budget::{Budget, BudgetShare, corners_worth};
use crate::gltf::ImportOptions;
use crate::preparation::Welder;
use crate::preparation::primitives::Solid;
use glam::{DMat3, DVec3};
use presight_model::environment::{Existence, FeatureShape, Mesh, Polygon, PolygonOrder, Properties};
use presight_model::error::{Error, Result};
use presight_model::geometry::Aabb;
use std::cell::OnceCell;
use std::rc::Rc;
use std::sync::Arc;

/// A shape in a script: immutable and cheap to copy.
#[derive(Clone, Debug)]
pub(super) struct Shape(Rc<Data>);

#[derive(Debug)]
struct Data {
    solid: Solid,
    /// The material of each polygon; `None` is the default material.
    materials: Vec<Option<u16>>,
    marks: Vec<Mark>,
    /// Made when the shape is first placed; all its objects share it.
    mesh: OnceCell<Arc<Mesh>>,
    _held: BudgetShare,
}

/// A feature on a shape.
#[derive(Clone, Debug)]
pub(super) struct Mark {
    pub classes: Vec<String>,
    pub id: Option<u32>,
    pub name: Option<String>,
    pub shape: FeatureShape,
    pub existence: Existence,
    pub properties: Properties,
}

impl Shape {
    /// A shape with the default material.
    pub fn new(solid: Solid, budget: &Rc<Budget>) -> Result<Self> {
        let materials = vec![None; solid.polygon_count()];
        Self::of(solid, materials, Vec::new(), budget)
    }

    fn of(solid: Solid, materials: Vec<Option<u16>>, marks: Vec<Mark>, budget: &Rc<Budget>) -> Result<Self> {
        let held = budget.take(solid.corner_count() as u64 + marks.iter().map(Mark::corners).sum::<u64>())?;
        Ok(Self(Rc::new(Data { solid, materials, marks, mesh: OnceCell::new(), _held: held })))
    }

    /// All polygons and landmarks of several shapes.
    pub fn joined(shapes: &[Self], budget: &Rc<Budget>) -> Result<Self> {
        // Checks the limit before anything is copied.
        budget.work(shapes.iter().map(|s| s.0.solid.corner_count() as u64).sum())?;
        let (mut solid, mut materials, mut marks) = (Solid::default(), Vec::new(), Vec::new());
        for Self(data) in shapes {
            solid.append(&data.solid);
            materials.extend_from_slice(&data.materials);
            marks.extend_from_slice(&data.marks);
        }
        Self::of(solid, materials, marks, budget)
    }

    /// The shape with one material.
    pub fn made_of(&self, material: u16, budget: &Rc<Budget>) -> Result<Self> {
        let materials = vec![Some(material); self.polygons()];
        Self::of(self.0.solid.clone(), materials, self.0.marks.clone(), budget)
    }

    /// The shape with one more landmark.
    pub fn marked(&self, mark: Mark, budget: &Rc<Budget>) -> Result<Self> {
        let mut marks = self.0.marks.clone();
        marks.push(mark);
        Self::of(self.0.solid.clone(), self.0.materials.clone(), marks, budget)
    }

    /// The shape, first rotated, then translated.
    pub fn moved(&self, rotation: DMat3, translation: DVec3, budget: &Rc<Budget>) -> Result<Self> {
        let mut solid = self.0.solid.clone();
        solid.map(false, |p| rotation * p + translation);
        let marks = self.0.marks.iter().map(|m| m.moved(rotation, translation)).collect();
        Self::of(solid, self.0.materials.clone(), marks, budget)
    }

    /// The shape scaled along the axes. A negative factor mirrors it.
    pub fn scaled(&self, factors: DVec3, budget: &Rc<Budget>) -> Result<Self> {
        let mut solid = self.0.solid.clone();
        solid.map(factors.to_array().iter().product::<f64>() < 0.0, |p| p * factors);
        let marks = self.0.marks.iter().map(|m| m.scaled(factors)).collect::<Result<_>>()?;
        Self::of(solid, self.0.materials.clone(), marks, budget)
    }

    /// Number of corners of its polygons.
    pub fn corners(&self) -> u64 {
        self.0.solid.corner_count() as u64
    }

    /// True if it has been placed.
    pub fn has_mesh(&self) -> bool {
        self.0.mesh.get().is_some()
    }

    /// Number of polygons.
    pub fn polygons(&self) -> usize {
        self.0.solid.polygon_count()
    }

    /// Its landmarks.
    pub fn marks(&self) -> &[Mark] {
        &self.0.marks
    }

    /// Number of triangles of its polygons.
    pub fn triangles(&self) -> u32 {
        (self.0.solid.corner_count() - 2 * self.polygons()) as u32
    }

    /// Its bounding box.
    pub fn bounds(&self) -> Aabb {
        Aabb::of(self.0.solid.vertices.iter().copied())
    }

    /// True if a polygon has the default material.
    pub fn needs_default(&self) -> bool {
        self.0.materials.iter().any(Option::is_none)
    }

    /// The mesh that all its objects share. The first call makes it, and returns true.
    pub fn mesh(&self, name: &str, default_material: u16, options: &ImportOptions) -> Result<(Arc<Mesh>, bool)> {
        if let Some(mesh) = self.0.mesh.get() {
            return Ok((mesh.clone(), false));
        }
        let mesh = Arc::new(self.build(name, default_material, options)?);
        Ok((self.0.mesh.get_or_init(|| mesh).clone(), true))
    }

    fn build(&self, name: &str, default_material: u16, options: &ImportOptions) -> Result<Mesh> {
        let Data { solid, materials, .. } = &*self.0;
        let (mut welder, mut vertices) = (Welder::default(), Vec::with_capacity(solid.vertices.len()));
        let welded: Vec<u32> = solid.vertices.iter().map(|v| welder.weld(v.as_vec3(), &mut vertices)).collect();
        let mut source = 0;
        let polygon = |(corners, material): (&[u32], &Option<u16>)| {
            let first = source;
            source += corners.len() as u32 - 2;
            Polygon {
                corners: corners.iter().map(|&c| welded[c as usize]).collect(),
                material: material.unwrap_or(default_material),
                source: first,
            }
        };
        let polygons = solid.polygons().zip(materials).map(polygon).collect();
        let order = if options.merge { PolygonOrder::Spatial } else { PolygonOrder::Given };
        Mesh::new(name, vertices, polygons, order)
    }
}

impl Mark {
    /// Its memory, expressed in polygon corners.
    fn corners(&self) -> u64 {
        let texts = self.classes.iter().map(|class| size_of::<String>() + class.len()).sum::<usize>();
        let name = self.name.as_ref().map_or(0, String::len);
        corners_worth(size_of::<Self>() + texts + name + size_of_val(self.shape.points()))
    }

    fn moved(&self, rotation: DMat3, translation: DVec3) -> Self {
        let mut moved = self.clone();
        let turned = |c: DMat3| {
            let m = rotation * c * rotation.transpose();
            // Restores exact symmetry.
            0.5 * (m + m.transpose())
        };
        map_shape(&mut moved.shape, |p| rotation * p + translation, turned);
        moved.properties.normal = self.properties.normal.map(|n| (rotation * n).normalize());
        moved
    }

    fn scaled(&self, factors: DVec3) -> Result<Self> {
        let mirrors = factors.to_array().iter().product::<f64>() < 0.0;
        let fiducial = matches!(self.shape, FeatureShape::Fiducial { .. });
        if fiducial && (mirrors || factors.x != factors.y || factors.y != factors.z) {
            let what = "a fiducial cannot be mirrored or stretched";
            return Err(Error::invalid(what, "scale the shape first, then put the fiducial on it"));
        }
        let mut scaled = self.clone();
        // Scaling changes the position, but not its uncertainty in metres.
        map_shape(&mut scaled.shape, |p| p * factors, |c| c);
        if let (FeatureShape::Patch { corners, .. }, true) = (&mut scaled.shape, mirrors) {
            corners.reverse();
        }
        scaled.properties.normal = self.properties.normal.map(|n| (n / factors).normalize());
        Ok(scaled)
    }
}

/// Maps the points and covariances of a shape.
fn map_shape(shape: &mut FeatureShape, point: impl Fn(DVec3) -> DVec3, spread: impl Fn(DMat3) -> DMat3) {
    match shape {
        FeatureShape::Point { at, covariance } | FeatureShape::Reflector { at, covariance } => {
            (*at, *covariance) = (point(*at), spread(*covariance));
        }
        FeatureShape::Segment { ends, covariances, cross } => {
            *ends = ends.map(point);
            *covariances = covariances.map(&spread);
            *cross = spread(*cross);
        }
        FeatureShape::Patch { corners, covariance } => {
            corners.iter_mut().for_each(|p| *p = point(*p));
            *covariance = spread(*covariance);
        }
        FeatureShape::Fiducial { corners, covariance, .. } => {
            *corners = corners.map(point);
            *covariance = spread(*covariance);
        }
        FeatureShape::Contour { anchor, covariance, .. } => {
            (*anchor, *covariance) = (point(*anchor), spread(*covariance))
        }
    }
}
