//! Operations become changes of an environment.

use super::merge;
use super::op::{InsertObject, Op, TrustFields, affine_of, covariance_of};
use glam::{DVec3, Vec3};
use presight_model::change::Change;
use presight_model::environment::{DEFAULT_TOLERANCE, Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::index::IndexKind;
use presight_model::limits;
use presight_model::printable::did_you_mean;
use presight_model::world::World;
use presight_read::layer::from_fields;
use presight_read::text::check_name;
use std::path::Path;
use std::sync::Arc;

/// Resolves names, files and numbers in operations.
pub(super) struct Context<'a> {
    environment: &'a Arc<Environment>,
    /// Folder of the files that lines name; `None` while reading the log.
    folder: Option<&'a Path>,
    /// Returns a mesh by its number in the log.
    mesh: &'a mut dyn FnMut(i64) -> Result<Arc<Mesh>>,
    /// Materials added by the operation so far.
    added: Vec<Material>,
    /// Notices of the scene files that the operation names.
    pub notices: Vec<String>,
    /// Allowed distance of features from their polygons, metres; `None`: the tolerance of their layer.
    pub tolerance: Option<f64>,
    /// The environment after the earlier changes of a group, if later ones depend on them.
    now: Option<World>,
}

impl<'a> Context<'a> {
    /// Makes a context for operations read from a file in `folder`, or from the log if `folder` is `None`.
    pub fn new(
        environment: &'a Arc<Environment>,
        folder: Option<&'a Path>,
        mesh: &'a mut dyn FnMut(i64) -> Result<Arc<Mesh>>,
    ) -> Self {
        Self { environment, folder, mesh, added: Vec::new(), notices: Vec::new(), tolerance: None, now: None }
    }

    fn environment(&self) -> &Arc<Environment> {
        self.now.as_ref().map_or(self.environment, World::environment)
    }

    /// Converts an operation to a change.
    pub fn change(&mut self, op: Op) -> Result<Change> {
        let tolerance = |class: &str| {
            let of_layer = || self.environment().layer(class).map_or(DEFAULT_TOLERANCE, |l| l.tolerance);
            self.tolerance.unwrap_or_else(of_layer)
        };
        Ok(match op {
            Op::Move { object, pose } => {
                Change::MoveObject { name: object, world_from_object: Pose::of_numbers(&pose)? }
            }
            Op::SetPose { object, pose } => {
                Change::SetPose { name: object, world_from_object: Pose::of_numbers(&pose)? }
            }
            Op::DeleteObject { object } => Change::DeleteObject { name: object },
            Op::SetGroup { group, pose } => {
                Change::SetFrame { name: group, world_from_group: pose.as_deref().map(Pose::of_numbers).transpose()? }
            }
            Op::InsertObject(new) => {
                let place = format!("object {:?}", new.object);
                self.insert(*new).map_err(|e| e.at(place))?
            }
            Op::AddMaterial(fields) => {
                if fields.name.is_empty() {
                    return Err(Error::invalid("the material has no name", "give a \"name\""));
                }
                let material = fields.material()?;
                material.check()?;
                self.added.push(material.clone());
                Change::AddMaterial(material)
            }
            Op::InsertFeature { class, feature } => {
                let feature = from_fields(*feature, tolerance(&class))?;
                Change::InsertFeature { class, feature }
            }
            Op::SetFeature { class, feature } => {
                let feature = from_fields(*feature, tolerance(&class))?;
                Change::SetFeature { class, feature }
            }
            Op::RestoreFeature { class, feature } => {
                // The tolerance may have changed since; it is checked when the change is applied.
                let feature = from_fields(*feature, limits::MAX_COORDINATE)?;
                Change::RestoreFeature { class, feature }
            }
            Op::DeleteFeature { class, feature } => Change::DeleteFeature { class, id: feature },
            Op::SetTolerance { class, tolerance } => Change::SetTolerance { class, tolerance },
            Op::SetPoseCovariance { class, object, covariance } => {
                Change::SetPoseCovariance { class, object, covariance: covariance_of(covariance)? }
            }
            Op::SetMark(fields) => {
                let name = fields.name.clone();
                let mark = fields.mark().map_err(|e| e.at(format!("mark {name:?}")))?;
                Change::SetMark { name, mark }
            }
            Op::RemoveMark { mark: name } => Change::RemoveMark { name },
            Op::SetTrust { object, trust } => {
                Change::SetTrust { object, trust: trust.as_ref().map(TrustFields::existence) }
            }
            Op::Group { changes } => {
                if self.now.is_none() && self.looks_back(&changes) {
                    self.now = Some(World::with_index(Environment::clone(self.environment), &IndexKind::None));
                }
                let one = |(i, op)| self.step(op).map_err(|e: Error| e.at(format!("change {} of the group", i + 1)));
                Change::Group(changes.into_iter().enumerate().map(one).collect::<Result<_>>()?)
            }
        })
    }

    /// True if a change of a group may depend on earlier ones. In the log only tolerances can.
    fn looks_back(&self, changes: &[Op]) -> bool {
        changes.iter().any(|op| match op {
            Op::InsertObject(_) => self.folder.is_some(),
            Op::SetTolerance { .. } => self.tolerance.is_none(),
            Op::Group { changes } => self.looks_back(changes),
            _ => false,
        })
    }

    /// Converts one operation of a group; later ones see its effect.
    fn step(&mut self, op: Op) -> Result<Change> {
        let is_group = matches!(op, Op::Group { .. });
        let change = self.change(op)?;
        // The steps of a nested group have already been applied.
        if let Some(now) = self.now.as_mut().filter(|_| !is_group) {
            now.apply_unchecked(change.clone())?;
            self.added.clear();
        }
        Ok(change)
    }

    fn insert(&mut self, fields: InsertObject) -> Result<Change> {
        let name = fields.object.clone();
        if name.is_empty() || name.len() > limits::MAX_NAME_BYTES {
            let what = format!("the path has {} bytes", name.len());
            return Err(Error::invalid(what, format!("give 1 to {}", limits::MAX_NAME_BYTES)));
        }
        // Imported models may have names that fail this check, and the log contains them.
        if self.folder.is_some() {
            check_name(&name)?;
        }
        let pose = fields.pose.as_deref().map_or(Ok(Pose::IDENTITY), Pose::of_numbers)?;
        let logged = self.folder.is_none();
        if !logged && self.environment().object(&name).is_some() {
            return Err(Error::invalid("it already exists", "delete it first, or choose another path"));
        }
        let sources = [
            fields.mesh.is_some() && logged,
            fields.from.is_some(),
            fields.like.is_some(),
            fields.vertices.is_some() && fields.polygons.is_some(),
        ];
        if sources.iter().filter(|s| **s).count() != 1 || (fields.mesh.is_some() && !logged) {
            return Err(Error::invalid(
                "it has no shape, or more than one",
                "give one of \"from\", \"like\", and \"vertices\" with \"polygons\"",
            ));
        }
        let mut before = Vec::new();
        let mut new = NewObject {
            object_from_mesh: affine_of(fields.object_from_mesh.as_deref())?,
            first_source: fields.first_source,
            ..NewObject::new(name, pose, self.shape(&fields, &mut before)?)
        };
        if let Some(like) = &fields.like
            && fields.object_from_mesh.is_none()
            && let Some(object) = self.environment().object(like)
        {
            new.object_from_mesh = object.object_from_mesh;
        }
        before.push(Change::InsertObject(new));
        Ok(Change::of(before))
    }

    fn shape(&mut self, fields: &InsertObject, before: &mut Vec<Change>) -> Result<Arc<Mesh>> {
        if let Some(number) = fields.mesh {
            return (self.mesh)(number);
        }
        if let Some(like) = &fields.like {
            let found = self.environment().object(like);
            return found.map(|o| o.mesh.clone()).ok_or_else(|| {
                Error::invalid(format!("there is no object {like:?} to copy"), "presight inspect lists the objects")
            });
        }
        let environment = self.now.as_ref().map_or(self.environment, World::environment);
        let mut materials = merge::Materials::new(environment, &mut self.added);
        if let (Some(file), Some(folder)) = (&fields.from, self.folder) {
            let of_file =
                merge::mesh_of_file(&folder.join(file), fields.from_object.as_deref(), &mut materials, before);
            let (mesh, notices) = of_file.map_err(Error::in_place)?;
            self.notices.extend(notices.iter().map(|notice| format!("{file}: {notice}")));
            return Ok(mesh);
        }
        let name = fields.material.as_deref().unwrap_or("default");
        let material = match materials.named(name) {
            Some(number) => number,
            None if fields.material.is_none() => materials.number_of(&Material::named(name), before)?,
            None => {
                let what = format!("there is no material {name:?}");
                let alike = did_you_mean(name, materials.names());
                let remedy = format!("{alike}add it with {{\"op\":\"add_material\",\"name\":..}} first");
                return Err(Error::invalid(what, remedy));
            }
        };
        let vertices: Vec<Vec3> = fields.vertices.iter().flatten().map(|v| DVec3::from_array(*v).as_vec3()).collect();
        let polygons: Vec<Polygon> =
            fields.polygons.iter().flatten().map(|corners| Polygon::new(corners.clone(), material)).collect();
        if polygons.is_empty() {
            return Err(Error::invalid("it has no polygons", "give lists of corners, such as [[0, 1, 2]]"));
        }
        Mesh::new(&fields.object, vertices, polygons, PolygonOrder::Spatial).map(Arc::new)
    }
}
