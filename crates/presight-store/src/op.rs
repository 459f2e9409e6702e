//! Changes as JSON: the lines of `presight env apply` and of the log.
//!
//! - `move`: `object`, `pose`; objects below the path move with it. The path may name a group; then its frame gets the
//!   pose
//! - `set_pose`: `object`, `pose`; moves this object alone; a group as by `move`
//! - `delete_object`: `object`; its features are deleted too. If the path names a group, all objects below it are
//!   deleted
//! - `set_group`: `group`, `pose`: sets its frame alone; null or absent removes the frame
//! - `insert_object`: `object`, `pose` (default: the origin), and one of: `from` (a scene file, relative to the file of
//!   changes; `from_object` selects one of several objects); `vertices` [[x, y, z], ..] with `polygons` [[0, 1, 2], ..]
//!   and `material` (a name; default `default`, which is added if missing); `like` (an object with the same mesh). Only
//!   in the log: `mesh` (number of the row), `object_from_mesh` (12 numbers, column by column), `first_source`
//! - `add_material`: `name`; optional: `reflection`, `one_sided`, `color` [r, g, b], `classes` {class: `opaque`,
//!   `transparent` or `invisible`}
//! - `insert_feature`, `set_feature`: `class`, `feature`: as in a layer file
//! - `restore_feature`: the same: restores a deleted feature under its old id
//! - `delete_feature`: `class`, `feature`: its number
//! - `set_tolerance`: `class`, `tolerance`
//! - `set_pose_covariance`: `class`, `object`, `covariance`: 36 numbers, or null for none
//! - `set_mark`: `mark` (its name), `object`, `kind` (`uncertain`, `absent`: not predicted, or `unseen`: never
//!   observed); optional `class` (of the sensors that it concerns) and `box` [[x, y, z], [x, y, z]] in the frame of
//!   the object
//! - `remove_mark`: `mark`
//! - `set_trust`: `object`, and `trust` (`existence`, `confirmed` UTC seconds, `rate` 1 / s), or null for none
//! - `group`: `changes`: all of them or none
//!
//! A line may have `was`: objects with the poses that they had when the change was found, as [{`object`, `pose`}, ..].
//! It is refused if one of them has moved since.
//!
//! A `pose` is x, y, z in metres and roll, pitch, yaw in degrees, or x, y, z, qx, qy, qz, qw.

use glam::{DAffine3, DVec3};
use presight_model::change::Change;
use presight_model::environment::{Appearance, Environment, Existence, Mark, MarkKind, Material, Mesh};
use presight_model::error::{Error, Result};
use presight_model::geometry::{Aabb, InObject, Pose, PoseCovariance};
use presight_read::layer::{FeatureFields, to_fields};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

#[derive(Deserialize, Serialize)]
#[serde(tag = "op", rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum Op {
    Move { object: String, pose: Vec<f64> },
    SetPose { object: String, pose: Vec<f64> },
    DeleteObject { object: String },
    SetGroup { group: String, pose: Option<Vec<f64>> },
    InsertObject(Box<InsertObject>),
    AddMaterial(MaterialFields),
    InsertFeature { class: String, feature: Box<FeatureFields> },
    SetFeature { class: String, feature: Box<FeatureFields> },
    RestoreFeature { class: String, feature: Box<FeatureFields> },
    DeleteFeature { class: String, feature: u32 },
    SetTolerance { class: String, tolerance: f64 },
    SetPoseCovariance { class: String, object: String, covariance: Option<Vec<f64>> },
    SetMark(MarkFields),
    RemoveMark { mark: String },
    SetTrust { object: String, trust: Option<TrustFields> },
    Group { changes: Vec<Op> },
}

#[derive(Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct InsertObject {
    pub object: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pose: Option<Vec<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub object_from_mesh: Option<Vec<f64>>,
    #[serde(default, skip_serializing_if = "is_zero")]
    pub first_source: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mesh: Option<i64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub from: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub from_object: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub like: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vertices: Option<Vec<[f64; 3]>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub polygons: Option<Vec<Vec<u32>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub material: Option<String>,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_zero(x: &u32) -> bool {
    *x == 0
}

/// The properties of a material. In the table `name` is empty here, because it has its own column.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MaterialFields {
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub name: String,
    #[serde(default = "one")]
    pub reflection: f64,
    #[serde(default)]
    pub one_sided: bool,
    #[serde(default = "grey")]
    pub color: [f64; 3],
    #[serde(default)]
    pub classes: BTreeMap<String, Appearance>,
}

fn one() -> f64 {
    1.0
}

fn grey() -> [f64; 3] {
    Material::named("").color.map(f64::from)
}

impl MaterialFields {
    pub fn of(m: &Material) -> Self {
        let color = m.color.map(f64::from);
        let (name, classes) = (m.name.clone(), m.appearance.clone());
        Self { name, reflection: m.reflection, one_sided: m.one_sided, color, classes }
    }

    pub fn material(self) -> Result<Material> {
        let sound = self.color.iter().all(|c| c.is_finite() && (*c as f32).is_finite());
        if !sound {
            return Err(Error::invalid("the colour is not finite", "give [r, g, b] from 0 to 1"));
        }
        let color = self.color.map(|c| c as f32);
        let Self { name, reflection, one_sided, classes: appearance, .. } = self;
        Ok(Material { name, reflection, one_sided, color, appearance })
    }
}

/// Something that a change touches. Two changes that touch the same key do not commute.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Key {
    /// An object's pose, mesh and existence, or a group's frame.
    Object(String),
    /// True if an object of this name exists.
    Existence(String),
    Feature(String, u32),
    /// A layer's tolerance and pose covariances.
    Layer(String),
    Mark(String),
    /// The trust in an object.
    Trust(String),
}

impl std::fmt::Display for Key {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Object(name) | Self::Existence(name) => write!(f, "object {name:?}"),
            Self::Feature(class, id) => write!(f, "feature {id} for class {class:?}"),
            Self::Layer(class) => write!(f, "layer for class {class:?}"),
            Self::Mark(name) => write!(f, "mark {name:?}"),
            Self::Trust(object) => write!(f, "trust in object {object:?}"),
        }
    }
}

/// The keys that an operation changes, and the keys that it requires.
#[derive(Default)]
pub(super) struct KeySets {
    pub writes: BTreeSet<Key>,
    pub reads: BTreeSet<Key>,
}

impl Op {
    pub fn touched(&self, to: &mut KeySets) {
        match self {
            Self::Move { object, .. } | Self::SetPose { object, .. } => {
                to.writes.insert(Key::Object(object.clone()));
                to.reads.insert(Key::Existence(object.clone()));
            }
            Self::DeleteObject { object } => to.existence(object),
            Self::SetGroup { group, .. } => {
                to.writes.insert(Key::Object(group.clone()));
            }
            Self::InsertObject(new) => to.existence(&new.object),
            Self::AddMaterial(_) => {}
            Self::InsertFeature { class, feature }
            | Self::SetFeature { class, feature }
            | Self::RestoreFeature { class, feature } => {
                to.writes.insert(Key::Feature(class.clone(), feature.id));
                to.reads.insert(Key::Layer(class.clone()));
                to.reads.extend(feature.object.clone().map(Key::Existence));
            }
            Self::DeleteFeature { class, feature } => {
                to.writes.insert(Key::Feature(class.clone(), *feature));
            }
            Self::SetTolerance { class, .. } => {
                to.writes.insert(Key::Layer(class.clone()));
            }
            Self::SetPoseCovariance { class, object, .. } => {
                to.writes.insert(Key::Layer(class.clone()));
                to.reads.insert(Key::Existence(object.clone()));
            }
            Self::SetMark(fields) => {
                to.writes.insert(Key::Mark(fields.name.clone()));
                to.reads.insert(Key::Existence(fields.object.clone()));
            }
            Self::RemoveMark { mark } => {
                to.writes.insert(Key::Mark(mark.clone()));
            }
            Self::SetTrust { object, .. } => {
                to.writes.insert(Key::Trust(object.clone()));
                to.reads.insert(Key::Existence(object.clone()));
            }
            Self::Group { changes } => changes.iter().for_each(|op| op.touched(to)),
        }
    }

    /// Converts a change to the form kept in the log. `number_of` returns the number of a mesh's row.
    pub fn of(change: &Change, number_of: &mut impl FnMut(&Arc<Mesh>) -> Result<i64>) -> Result<Self> {
        let pose = pose_fields;
        let boxed = |feature| Box::new(to_fields(feature));
        Ok(match change {
            Change::AddMaterial(material) => Self::AddMaterial(MaterialFields::of(material)),
            Change::InsertObject(new) => Self::InsertObject(Box::new(InsertObject {
                object: new.name.clone(),
                pose: Some(pose(&new.world_from_object)),
                object_from_mesh: affine_fields(&new.object_from_mesh),
                first_source: new.first_source,
                mesh: Some(number_of(&new.mesh)?),
                ..InsertObject::default()
            })),
            Change::MoveObject { name, world_from_object } => {
                Self::Move { object: name.clone(), pose: pose(world_from_object) }
            }
            Change::SetPose { name, world_from_object } => {
                Self::SetPose { object: name.clone(), pose: pose(world_from_object) }
            }
            Change::DeleteObject { name } => Self::DeleteObject { object: name.clone() },
            Change::SetFrame { name, world_from_group } => {
                Self::SetGroup { group: name.clone(), pose: world_from_group.as_ref().map(pose) }
            }
            Change::InsertFeature { class, feature } => {
                Self::InsertFeature { class: class.clone(), feature: boxed(feature) }
            }
            Change::RestoreFeature { class, feature } => {
                Self::RestoreFeature { class: class.clone(), feature: boxed(feature) }
            }
            Change::SetFeature { class, feature } => Self::SetFeature { class: class.clone(), feature: boxed(feature) },
            Change::DeleteFeature { class, id } => Self::DeleteFeature { class: class.clone(), feature: *id },
            Change::SetTolerance { class, tolerance } => {
                Self::SetTolerance { class: class.clone(), tolerance: *tolerance }
            }
            Change::SetPoseCovariance { class, object, covariance } => Self::SetPoseCovariance {
                class: class.clone(),
                object: object.clone(),
                covariance: covariance.map(|c| c.as_rows().as_flattened().to_vec()),
            },
            Change::SetMark { name, mark } => Self::SetMark(MarkFields { name: name.clone(), ..MarkFields::of(mark) }),
            Change::RemoveMark { name } => Self::RemoveMark { mark: name.clone() },
            Change::SetTrust { object, trust } => {
                Self::SetTrust { object: object.clone(), trust: trust.as_ref().map(TrustFields::of) }
            }
            Change::Group(changes) => {
                Self::Group { changes: changes.iter().map(|c| Self::of(c, number_of)).collect::<Result<_>>()? }
            }
        })
    }
}

/// Pose of an object at the time when a change was found.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Was {
    pub object: String,
    pub pose: Vec<f64>,
}

impl Was {
    /// Returns an error unless the object still has this pose.
    pub fn check(&self, environment: &Environment) -> Result<()> {
        let index = environment.index_of(&self.object)?;
        if environment.objects()[index as usize].world_from_object == Pose::of_numbers(&self.pose)? {
            return Ok(());
        }
        let what = format!("object {:?} is not where it was when the change was found", self.object);
        Err(Error::invalid(what, "leave this line out, or find the changes again"))
    }
}

/// A mark. In the table `name` is empty here, because it has its own column.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MarkFields {
    #[serde(rename = "mark", default, skip_serializing_if = "String::is_empty")]
    pub name: String,
    pub object: String,
    kind: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    class: Option<String>,
    #[serde(rename = "box", skip_serializing_if = "Option::is_none")]
    bounds: Option<[[f64; 3]; 2]>,
}

impl MarkFields {
    pub fn of(mark: &Mark) -> Self {
        let bounds = mark.bounds.map(|b| [b.min.to_array(), b.max.to_array()]);
        let (object, kind) = (mark.object.clone(), mark.kind.name().to_owned());
        Self { name: String::new(), object, kind, class: mark.class.clone(), bounds }
    }

    pub fn mark(self) -> Result<Mark> {
        let kind = MarkKind::ALL.into_iter().find(|kind| kind.name() == self.kind);
        let unknown =
            || Error::invalid(format!("there is no kind of mark {:?}", self.kind), "give uncertain, absent or unseen");
        let bounds = self.bounds.map(|[min, max]| Aabb { min: DVec3::from_array(min), max: DVec3::from_array(max) });
        Ok(Mark { kind: kind.ok_or_else(unknown)?, object: self.object, class: self.class, bounds })
    }
}

/// The trust in an object.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TrustFields {
    existence: f64,
    #[serde(default)]
    confirmed: f64,
    #[serde(default)]
    rate: f64,
}

impl TrustFields {
    pub fn of(trust: &Existence) -> Self {
        Self { existence: trust.p0, confirmed: trust.confirmed, rate: trust.rate }
    }

    pub fn existence(&self) -> Existence {
        Existence { p0: self.existence, confirmed: self.confirmed, rate: self.rate }
    }
}

impl KeySets {
    fn existence(&mut self, object: &str) {
        self.writes.insert(Key::Object(object.to_owned()));
        self.writes.insert(Key::Existence(object.to_owned()));
    }

    pub fn of(ops: &[&Op]) -> Self {
        let mut touched = Self::default();
        ops.iter().for_each(|op| op.touched(&mut touched));
        touched
    }
}

/// Twelve numbers, column by column; `None` for the identity.
pub(super) fn affine_fields(m: &DAffine3) -> Option<Vec<f64>> {
    let plain = m.to_cols_array().map(f64::to_bits) == DAffine3::IDENTITY.to_cols_array().map(f64::to_bits);
    (!plain).then(|| m.to_cols_array().to_vec())
}

pub(super) fn affine_of(fields: Option<&[f64]>) -> Result<DAffine3> {
    let Some(fields) = fields else { return Ok(DAffine3::IDENTITY) };
    let columns: [f64; 12] =
        fields.try_into().map_err(|_| Error::invalid("object_from_mesh has 12 numbers", "give 12 numbers"))?;
    let m = DAffine3::from_cols_array(&columns);
    if !m.is_finite() || m.matrix3.determinant() == 0.0 {
        return Err(Error::invalid("object_from_mesh is not finite or flattens the mesh", "give a scale"));
    }
    Ok(m)
}

/// A pose as seven numbers.
pub(super) fn pose_fields(pose: &Pose) -> Vec<f64> {
    pose.to_array().to_vec()
}

pub(super) fn covariance_of(fields: Option<Vec<f64>>) -> Result<Option<PoseCovariance<InObject>>> {
    fields.map(|fields| PoseCovariance::unchecked_row_major(&fields)).transpose()
}
