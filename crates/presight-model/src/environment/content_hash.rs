//! The content hash: equal for environments with the same content, however they were built.
//!
//! BLAKE3 over this canonical encoding, version 3. An environment without marks and trust uses version 2, which omits
//! their lists. If furthermore no group has a frame, version 1 applies, which also omits the list of groups. Older
//! hashes thus stay valid. Integers and floats are little-endian; floats are encoded by their bits (so -0 is not 0).
//! `text` is its length in bytes as u32, then UTF-8. `list` is its length as u32, then the items. An optional value is
//! a byte 0, or 1 and the value. Matrices are written column by column.
//!
//! - environment: text `presight content 3`; list of objects by rising name; list of groups that were given a frame and
//!   have objects below, by rising path; list of layers with content, by rising class; list of marks by rising
//!   name; list of (text object; 3 f64 trust as of a feature) by rising object. Version 2: `presight content 2`;
//!   objects; groups; layers. Version 1: `presight content 1`; objects; layers
//! - mark: text name; text object; u8: 1 uncertain, 2 absent; optional text class; optional 6 f64: minimum and maximum
//!   corner of its box
//! - group: text path; `world_from_group` as f64 x y z qx qy qz qw
//! - object: text name; `world_from_object` as f64 x y z qx qy qz qw; `object_from_mesh` as 12 f64; u32 `first_source`;
//!   hash of its mesh
//! - mesh: text name; list of vertices, each 3 f32; list of polygons; list of hashes of its materials, in the order in
//!   which its polygons first use them
//! - polygon: list of corners, u32; u32 place of its material in the mesh's list; u32 `source`
//! - material: text name; f64 reflection; u8 one-sided; 3 f32 colour; list of (text class; u8: 1 transparent, 2
//!   invisible) by rising class
//! - layer: text class; f64 tolerance; list of (text object; 36 f64 pose covariance) by rising object; list of features
//! - feature: u32 id; optional text name; optional text object; u8 shape: 0 point, 1 segment, 2 patch, 3 reflector, 4
//!   fiducial, 5 contour; list of points, each 3 f64; list of covariances, each 9 f64 (a segment has three: both ends',
//!   then the cross-covariance); a fiducial's text family and u32 code; a contour's f64 crease angle in degrees; f64
//!   p0, confirmed, rate; optional f64 strength; optional f64 contrast; optional 3 f64 normal
//!
//! Not encoded, because they are not content: indices and slots of objects, deleted objects, the order of insertion,
//! materials that no polygon has, frames of groups without objects below, layers without features and
//! covariances, sharing of meshes, clusters and indexes.

use super::{Appearance, Environment, Feature, FeatureLayer, FeatureShape, MarkKind, Material, Mesh, Object};
use crate::geometry::Pose;
use glam::DVec3;
use std::collections::HashMap;
use std::fmt;

/// The hash of an environment's content; prints as hexadecimal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ContentHash(pub [u8; 32]);

impl fmt::Display for ContentHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl Environment {
    /// The hash of the whole content, equal on every machine. The source of this module defines the encoding.
    ///
    /// ```
    /// use presight::environment::{Environment, Material};
    /// let mut environment = Environment::new();
    /// let empty = environment.content_hash();
    /// environment.add_material(Material::named("paint"))?;
    /// assert_eq!(environment.content_hash(), empty, "no polygon has it");
    /// assert_eq!(empty.to_string().len(), 64);
    /// # Ok::<(), presight::Error>(())
    /// ```
    pub fn content_hash(&self) -> ContentHash {
        let mut meshes: HashMap<*const Mesh, ContentHash> = HashMap::new();
        let mut objects: Vec<&Object> = self.objects.iter().filter(|o| !o.is_deleted()).collect();
        objects.sort_unstable_by(|a, b| a.name.cmp(&b.name));
        let materials: Vec<ContentHash> = self.materials.iter().map(Material::content_hash).collect();
        let groups: Vec<(&str, &Pose)> = self.framed_groups().collect();
        let mut to = Encoder::default();
        let believed = self.marks().len() + self.trusts().len() > 0;
        to.text(match (believed, groups.is_empty()) {
            (true, _) => "presight content 3",
            (false, false) => "presight content 2",
            (false, true) => "presight content 1",
        });
        to.count(objects.len());
        for object in objects {
            let mesh = meshes
                .entry(std::sync::Arc::as_ptr(&object.mesh))
                .or_insert_with(|| object.mesh.content_hash(|material| materials[usize::from(material)]));
            to.object(object, *mesh);
        }
        if believed || !groups.is_empty() {
            to.count(groups.len());
        }
        for (path, pose) in groups {
            to.text(path);
            to.pose(pose);
        }
        let layers = || self.layers.iter().filter(|l| !(l.features.is_empty() && l.pose_covariances.is_empty()));
        to.count(layers().count());
        layers().for_each(|layer| to.layer(layer));
        if believed {
            to.beliefs(self);
        }
        to.hash()
    }
}

impl Material {
    /// The hash of all its properties.
    pub fn content_hash(&self) -> ContentHash {
        let mut to = Encoder::default();
        to.text(&self.name);
        to.f64s(&[self.reflection]);
        to.bytes(&[u8::from(self.one_sided)]);
        self.color.iter().for_each(|c| to.bytes(&c.to_le_bytes()));
        // A class that sees the material opaque may be listed or not.
        let special = || self.appearance.iter().filter(|(_, a)| **a != Appearance::Opaque);
        to.count(special().count());
        for (class, appearance) in special() {
            to.text(class);
            to.bytes(&[if *appearance == Appearance::Transparent { 1 } else { 2 }]);
        }
        to.hash()
    }
}

impl Mesh {
    /// The hash of vertices, polygons and materials; `material` returns the hash of the material at an index.
    pub fn content_hash(&self, material: impl Fn(u16) -> ContentHash) -> ContentHash {
        let mut to = Encoder::default();
        to.text(self.name());
        to.count(self.vertices().len());
        for v in self.vertices() {
            v.to_array().iter().for_each(|x| to.bytes(&x.to_le_bytes()));
        }
        to.count(self.polygon_count());
        let mut used: Vec<u16> = Vec::new();
        let mut place_of: HashMap<u16, u32> = HashMap::new();
        for record in self.polygons() {
            let corners = record.corners(self.all_corners());
            to.count(corners.len());
            corners.iter().for_each(|c| to.u32(*c));
            let place = *place_of.entry(record.material).or_insert_with(|| {
                used.push(record.material);
                used.len() as u32 - 1
            });
            to.u32(place);
            to.u32(record.source);
        }
        to.count(used.len());
        used.into_iter().for_each(|m| to.bytes(&material(m).0));
        to.hash()
    }
}

/// Writes the encoding into a hash.
#[derive(Default)]
struct Encoder {
    hasher: blake3::Hasher,
    /// BLAKE3 is fast only on long inputs.
    buffer: Vec<u8>,
}

impl Encoder {
    fn bytes(&mut self, bytes: &[u8]) {
        const FLUSH: usize = 1 << 16;
        self.buffer.extend_from_slice(bytes);
        if self.buffer.len() >= FLUSH {
            self.hasher.update(&self.buffer);
            self.buffer.clear();
        }
    }

    fn u32(&mut self, value: u32) {
        self.bytes(&value.to_le_bytes());
    }

    /// Lengths fit: the limits on all lists are below u32::MAX.
    fn count(&mut self, length: usize) {
        self.u32(length as u32);
    }

    fn text(&mut self, text: &str) {
        self.count(text.len());
        self.bytes(text.as_bytes());
    }

    fn f64s(&mut self, values: &[f64]) {
        values.iter().for_each(|x| self.bytes(&x.to_le_bytes()));
    }

    fn optional<T>(&mut self, value: Option<T>, write: impl FnOnce(&mut Self, T)) {
        self.bytes(&[u8::from(value.is_some())]);
        if let Some(value) = value {
            write(self, value);
        }
    }

    fn object(&mut self, object: &Object, mesh: ContentHash) {
        self.text(&object.name);
        self.pose(&object.world_from_object);
        self.f64s(&object.object_from_mesh.to_cols_array());
        self.u32(object.first_source);
        self.bytes(&mesh.0);
    }

    fn beliefs(&mut self, environment: &Environment) {
        self.count(environment.marks().len());
        for (name, mark) in environment.marks() {
            self.text(name);
            self.text(&mark.object);
            let kind = match mark.kind {
                MarkKind::Uncertain => 1,
                MarkKind::Absent => 2,
                MarkKind::Unseen => 3,
            };
            self.bytes(&[kind]);
            self.optional(mark.class.as_deref(), Self::text);
            self.optional(mark.bounds, |to, b| {
                to.f64s(&b.min.to_array());
                to.f64s(&b.max.to_array());
            });
        }
        self.count(environment.trusts().len());
        for (object, trust) in environment.trusts() {
            self.text(object);
            self.f64s(&[trust.p0, trust.confirmed, trust.rate]);
        }
    }

    fn pose(&mut self, pose: &Pose) {
        self.f64s(&pose.translation.to_array());
        self.f64s(&pose.rotation.to_array());
    }

    fn layer(&mut self, layer: &FeatureLayer) {
        self.text(&layer.class);
        self.f64s(&[layer.tolerance]);
        let mut covariances: Vec<_> = layer.pose_covariances.iter().collect();
        covariances.sort_unstable_by(|a, b| a.0.cmp(&b.0));
        self.count(covariances.len());
        for (object, covariance) in covariances {
            self.text(object);
            self.f64s(covariance.as_rows().as_flattened());
        }
        self.count(layer.features.len());
        layer.features.iter().for_each(|feature| self.feature(feature));
    }

    fn feature(&mut self, feature: &Feature) {
        self.u32(feature.id);
        self.optional(feature.name.as_deref(), Self::text);
        self.optional(feature.object.as_deref(), Self::text);
        self.shape(&feature.shape);
        let e = &feature.existence;
        self.f64s(&[e.p0, e.confirmed, e.rate]);
        self.optional(feature.properties.strength, |to, x| to.f64s(&[x]));
        self.optional(feature.properties.contrast, |to, x| to.f64s(&[x]));
        self.optional(feature.properties.normal, |to, n: DVec3| to.f64s(&n.to_array()));
    }

    fn shape(&mut self, shape: &FeatureShape) {
        let (kind, covariances) = match shape {
            FeatureShape::Point { covariance, .. } => (0, vec![covariance]),
            FeatureShape::Segment { covariances, cross, .. } => (1, vec![&covariances[0], &covariances[1], cross]),
            FeatureShape::Patch { covariance, .. } => (2, vec![covariance]),
            FeatureShape::Reflector { covariance, .. } => (3, vec![covariance]),
            FeatureShape::Fiducial { covariance, .. } => (4, vec![covariance]),
            FeatureShape::Contour { covariance, .. } => (5, vec![covariance]),
        };
        self.bytes(&[kind]);
        self.count(shape.points().len());
        shape.points().iter().for_each(|p| self.f64s(&p.to_array()));
        self.count(covariances.len());
        covariances.into_iter().for_each(|c| self.f64s(&c.to_cols_array()));
        match shape {
            FeatureShape::Fiducial { family, code, .. } => {
                self.text(family);
                self.u32(*code);
            }
            FeatureShape::Contour { crease_deg, .. } => self.f64s(&[*crease_deg]),
            _ => {}
        }
    }

    fn hash(mut self) -> ContentHash {
        self.hasher.update(&self.buffer);
        ContentHash(*self.hasher.finalize().as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::{NewObject, Polygon, PolygonOrder};
    use glam::Vec3;
    use std::sync::Arc;

    fn triangle(material: u16) -> Arc<Mesh> {
        let corners = vec![Vec3::ZERO, Vec3::X, Vec3::Y];
        let polygons = vec![Polygon::new(vec![0, 1, 2], material)];
        Arc::new(Mesh::new("t", corners, polygons, PolygonOrder::Spatial).unwrap())
    }

    fn of(build: impl FnOnce(&mut Environment)) -> ContentHash {
        let mut environment = Environment::new();
        build(&mut environment);
        environment.content_hash()
    }

    fn at(x: f64) -> Pose {
        Pose { translation: DVec3::new(x, 0.0, 0.0), ..Pose::IDENTITY }
    }

    #[test]
    fn the_way_to_a_content_does_not_count() {
        let plain = of(|e| {
            let paint = e.add_material(Material::named("paint")).unwrap();
            let mesh = triangle(paint);
            e.insert(NewObject::new("a", at(1.0), mesh.clone())).unwrap();
            e.insert(NewObject::new("b", at(2.0), mesh)).unwrap();
        });
        let detour = of(|e| {
            e.add_material(Material::named("unused")).unwrap();
            let paint = e.add_material(Material::named("paint")).unwrap();
            e.insert(NewObject::new("c", at(3.0), triangle(0))).unwrap();
            e.insert(NewObject::new("b", at(1.0), triangle(paint))).unwrap();
            e.insert(NewObject::new("a", at(1.0), triangle(paint))).unwrap();
            e.delete("c").unwrap();
            e.set_pose("b", at(2.0)).unwrap();
        });
        assert_eq!(plain, detour);
    }

    #[test]
    fn everything_else_counts() {
        let with = |name: &str, x: f64, material: Material, mesh: Arc<Mesh>| {
            of(|e| {
                e.add_material(material).unwrap();
                e.insert(NewObject::new(name, at(x), mesh)).unwrap();
            })
        };
        let paint = || Material::named("paint");
        let plain = with("a", 0.0, paint(), triangle(0));
        assert_eq!(plain, with("a", 0.0, paint(), triangle(0)));
        let glass = Material { appearance: [("radar".into(), Appearance::Transparent)].into(), ..paint() };
        let opaque = Material { appearance: [("radar".into(), Appearance::Opaque)].into(), ..paint() };
        assert_eq!(plain, with("a", 0.0, opaque, triangle(0)));
        let turned = Mesh::new(
            "t",
            vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            vec![Polygon::new(vec![1, 2, 0], 0)],
            PolygonOrder::Spatial,
        );
        let others = [
            with("b", 0.0, paint(), triangle(0)),
            with("a", -0.0, paint(), triangle(0)),
            with("a", f64::MIN_POSITIVE, paint(), triangle(0)),
            with("a", 0.0, Material { reflection: 0.5, ..paint() }, triangle(0)),
            with("a", 0.0, glass, triangle(0)),
            with("a", 0.0, paint(), Arc::new(turned.unwrap())),
        ];
        for (i, other) in others.iter().enumerate() {
            assert_ne!(plain, *other, "{i}");
            assert!(!others[..i].contains(other), "{i}");
        }
    }

    #[test]
    fn frames_of_groups_count_where_something_is_below() {
        let with = |frames: &[(&str, f64)]| {
            of(|e| {
                e.add_material(Material::named("paint")).unwrap();
                e.insert(NewObject::new("a/b/c", at(0.0), triangle(0))).unwrap();
                for (path, x) in frames {
                    e.set_frame(path, Some(at(*x))).unwrap();
                }
            })
        };
        let all = [with(&[]), with(&[("a", 0.0)]), with(&[("a", -0.0)]), with(&[("a/b", 0.0)])];
        for (i, hash) in all.iter().enumerate() {
            assert!(!all[..i].contains(hash), "{i}");
        }
        assert_eq!(with(&[("d", 1.0), ("a/b/c/d", 1.0)]), all[0], "the group is empty");
        assert_eq!(with(&[("a/b", 2.0), ("a", 1.0)]), with(&[("a", 1.0), ("a/b", 2.0)]));
    }

    /// A change of the encoding changes every stored hash and needs a new version in the first text.
    #[test]
    fn the_encoding_stays() {
        let empty = Environment::new().content_hash().to_string();
        let by_hand: Vec<u8> = [&18u32.to_le_bytes()[..], b"presight content 1", &[0; 8]].concat();
        assert_eq!(empty, blake3::hash(&by_hand).to_hex().to_string());
        let one = |e: &mut Environment| {
            e.add_material(Material::named("paint")).unwrap();
            e.insert(NewObject::new("g/a", at(0.0), triangle(0))).unwrap();
        };
        let text = |s: &str| [&(s.len() as u32).to_le_bytes()[..], s.as_bytes()].concat();
        let numbers = |all: &[f64]| all.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
        let pose = numbers(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        let affine = numbers(&glam::DAffine3::IDENTITY.to_cols_array());
        let mesh = triangle(0).content_hash(|_| Material::named("paint").content_hash()).0;
        let object = [text("g/a"), pose.clone(), affine, vec![0; 4], mesh.to_vec()].concat();
        let (count, none) = (1u32.to_le_bytes().to_vec(), vec![0; 4]);
        let first = [text("presight content 1"), count.clone(), object.clone(), none.clone()].concat();
        assert_eq!(of(one).0, *blake3::hash(&first).as_bytes());
        let second = [text("presight content 2"), count.clone(), object, count, text("g"), pose, none].concat();
        let framed = of(|e| {
            one(e);
            e.set_frame("g", Some(at(0.0))).unwrap();
        });
        assert_eq!(framed.0, *blake3::hash(&second).as_bytes());
    }
}
