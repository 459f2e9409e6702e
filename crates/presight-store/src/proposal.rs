//! Changes that a program proposes with their evidence: the typed form of the lines of `presight env apply`.

use super::line::Line;
use super::op::{InsertObject, Op, Was, pose_fields};
use glam::DVec3;
use presight_model::change::Change;
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use serde::Serialize;
use serde_json::{Value, json};
use std::path::PathBuf;

/// A change that a program proposes, with its reason.
///
/// ```
/// use presight::Change;
/// use presight::store::{Edit, ProposedChange};
/// let edit = Edit::from(Change::DeleteObject { name: "crate".to_owned() });
/// let change = ProposedChange::new(edit, "crate is gone", None, Vec::new(), "v1")?;
/// assert_eq!(change.object(), Some("crate"));
/// assert!(change.line()?.starts_with(r#"{"cause":"crate is gone","id":"v1-"#));
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct ProposedChange {
    /// Unique id. A store applies each id once.
    pub id: String,
    /// The reason in words.
    pub cause: String,
    /// The evidence for it, if there is a measure.
    pub evidence: Option<ChangeEvidence>,
    /// Objects with the poses that they had when the change was found. The change is refused if one of them was moved
    /// since.
    pub was: Vec<(String, Pose)>,
    /// The change.
    pub edit: Edit,
}

/// The evidence for a change.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ChangeEvidence {
    /// Natural logarithm of the odds that support it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub log_odds: Option<f64>,
    /// Number of views that support it.
    pub views: u32,
}

/// A change of a model whose inserted shapes are named by their source.
#[derive(Clone, Debug)]
pub enum Edit {
    /// A change that inserts no object.
    Change(Box<Change>),
    /// Inserts an object.
    Insert {
        /// Full path of the new object.
        object: String,
        /// Its pose.
        pose: EditPose,
        /// The source of its shape.
        shape: ShapeSource,
    },
    /// All of these edits, or none.
    Group(Vec<Edit>),
}

/// The pose of an inserted object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EditPose {
    /// Any pose; lines state its quaternion.
    Free(Pose),
    /// An upright pose; lines state its yaw in degrees.
    Upright {
        /// World, metres.
        translation: DVec3,
        /// Radians.
        yaw: f64,
    },
}

/// The source of the shape of an inserted object.
#[derive(Clone, Debug, PartialEq)]
pub enum ShapeSource {
    /// An object of a scene file.
    File {
        /// The scene file.
        path: PathBuf,
        /// The object in it.
        object: String,
    },
    /// The shape of another object of the model.
    Like(String),
    /// Polygons with the default material.
    Polygons {
        /// In the frame of the object, metres.
        vertices: Vec<[f32; 3]>,
        /// Indexes of vertices.
        polygons: Vec<Vec<u32>>,
    },
}

impl From<Change> for Edit {
    fn from(change: Change) -> Self {
        Self::Change(change.into())
    }
}

impl Edit {
    fn op(&self) -> Result<Op> {
        Ok(match self {
            Self::Change(change) => {
                let inserts = || Error::invalid("the change inserts an object without a source", "use Edit::Insert");
                Op::of(change, &mut |_| Err(inserts()))?
            }
            Self::Group(edits) => Op::Group { changes: edits.iter().map(Self::op).collect::<Result<_>>()? },
            Self::Insert { object, pose, shape } => {
                let mut op = InsertObject { object: object.clone(), pose: Some(pose.numbers()), ..Default::default() };
                match shape {
                    ShapeSource::File { path, object } => {
                        op.from = Some(path.to_string_lossy().into_owned());
                        op.from_object = Some(object.clone());
                    }
                    ShapeSource::Like(object) => op.like = Some(object.clone()),
                    ShapeSource::Polygons { vertices, polygons } => {
                        op.vertices = Some(vertices.iter().map(|v| v.map(f64::from)).collect());
                        op.polygons = Some(polygons.clone());
                    }
                }
                Op::InsertObject(Box::new(op))
            }
        })
    }
}

impl EditPose {
    fn numbers(&self) -> Vec<f64> {
        match self {
            Self::Free(pose) => pose_fields(pose),
            Self::Upright { translation: p, yaw } => vec![p.x, p.y, p.z, 0.0, 0.0, yaw.to_degrees()],
        }
    }
}

fn unwritable(e: serde_json::Error) -> Error {
    Error::invalid("the change cannot be written as JSON", "").caused_by(e)
}

impl ProposedChange {
    /// Makes a change whose id consists of the version of the model, `base`, and a hash of the content.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if an [`Edit::Change`] inserts an object.
    pub fn new(
        edit: Edit,
        cause: impl Into<String>,
        evidence: Option<ChangeEvidence>,
        was: Vec<(String, Pose)>,
        base: &str,
    ) -> Result<Self> {
        let change = Self { id: String::new(), cause: cause.into(), evidence, was, edit };
        let hash = blake3::hash(change.value()?.to_string().as_bytes()).to_hex();
        Ok(Self { id: format!("{base}-{}", &hash[..12]), ..change })
    }

    /// The object or the new object that it changes; `None` for a group, and for a change of another kind.
    pub fn object(&self) -> Option<&str> {
        match &self.edit {
            Edit::Insert { object, .. } => Some(object),
            Edit::Group(_) => None,
            Edit::Change(change) => match &**change {
                Change::DeleteObject { name } | Change::SetPose { name, .. } => Some(name),
                Change::SetMark { mark, .. } => Some(&mark.object),
                _ => None,
            },
        }
    }

    /// The change as a line of `presight env apply`, without a line break.
    ///
    /// # Errors
    /// As [`ProposedChange::new`].
    pub fn line(&self) -> Result<String> {
        let mut value = self.value()?;
        value["id"] = self.id.as_str().into();
        Ok(value.to_string())
    }

    /// The line without the id.
    fn value(&self) -> Result<Value> {
        let mut value = serde_json::to_value(self.edit.op()?).map_err(unwritable)?;
        value["cause"] = self.cause.as_str().into();
        if let Some(evidence) = &self.evidence {
            value["evidence"] = serde_json::to_value(evidence).map_err(unwritable)?;
        }
        if !self.was.is_empty() {
            let row = |(object, pose): &(String, Pose)| json!({"object": object, "pose": pose_fields(pose)});
            value["was"] = self.was.iter().map(row).collect();
        }
        Ok(value)
    }

    /// The change in the form that lines are parsed to.
    pub(super) fn parsed(&self) -> Result<Line> {
        let evidence = self.evidence.as_ref().map(serde_json::to_string).transpose().map_err(unwritable)?;
        let was = self.was.iter().map(|(object, pose)| Was { object: object.clone(), pose: pose_fields(pose) });
        Ok(Line {
            cause: Some(self.cause.clone()),
            id: Some(self.id.clone()),
            evidence,
            was: was.collect(),
            op: self.edit.op()?,
        })
    }
}
