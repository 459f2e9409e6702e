//! The session: a scene, a sensor, the layer that is edited, and the steps of its editing.

use super::answer::{Answer, parse, six_of};
use super::map::WorthMap;
use super::save::{Journal, Target, behind, merging};
use presight::environment::DEFAULT_TOLERANCE;
use presight::features::{self, Feature, FeatureLayer, PlacedFeature, PlacedFeatures};
use presight::files::{self, LayerFile, layer_fields};
use presight::measured::Frame;
use presight::predict::free_poses;
use presight::{Backend, Change, Error, Options, Output, Pose, Predictor, Result, Scene, Sensor, SensorPose, World};
use presight_pictures::preview_needs;
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What a session edits.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct SessionOptions {
    /// The start of the command that repeats a prediction, word by word; the page adds the pose and the layer.
    pub command: Vec<String>,
    /// The first pose of the sensor; `None`: a free one.
    pub pose: Option<SensorPose>,
    /// The layer file; `None`: the store's own layer, or a new file.
    pub layer: Option<PathBuf>,
    /// The folder in which a new layer is written; empty: the current one.
    pub folder: PathBuf,
    /// A measurement of the sensor, shown next to the predicted image.
    pub measured: Option<Frame>,
    /// The engine.
    pub engine: Options,
}

impl Default for SessionOptions {
    fn default() -> Self {
        Self {
            command: Vec::new(),
            pose: None,
            layer: None,
            folder: PathBuf::new(),
            measured: None,
            engine: Options::default(),
        }
    }
}

/// A step, and what takes it back.
pub(crate) struct Step {
    pub change: Change,
    pub label: String,
}

/// A scene, a sensor and a layer under the editor.
pub struct Session {
    pub(crate) options: SessionOptions,
    pub(crate) scene: PathBuf,
    pub(crate) world: World,
    pub(crate) sensor: Sensor,
    /// The sensor's class, whose layer is edited.
    pub(crate) class: String,
    /// The scene's own layer.
    pub(crate) own: HashMap<u32, Arc<Feature>>,
    /// The layer as it was read or saved last.
    pub(crate) saved: HashMap<u32, Arc<Feature>>,
    pub(crate) target: Target,
    pub(crate) journal: Journal,
    pub(crate) placed: PlacedFeatures,
    /// Predicts frames.
    pub(crate) predictor: Predictor,
    /// Predicts other features than the layer's, so that the layer's stay prepared.
    pub(crate) aside: Predictor,
    pub(crate) undo: Vec<Step>,
    pub(crate) redo: Vec<Step>,
    /// Rises with every change.
    pub(crate) version: u64,
    /// The first id that was never used.
    pub(crate) next_id: u32,
    pub(crate) map: Option<WorthMap>,
    /// True if another program has changed the store since it was read.
    pub(crate) stale: bool,
    first_pose: [f64; 6],
    notices: Vec<String>,
}

/// Asks for one feature.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct EntryRequest {
    id: u32,
}

/// A request that carries nothing but the version that the page knows.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Versioned {
    #[serde(rename = "version")]
    _version: u64,
}

impl Session {
    /// Opens the layer of a scene for editing.
    ///
    /// # Errors
    /// Errors of reading the layer; [`presight::ErrorKind::Usage`] for a layer of another class;
    /// [`presight::ErrorKind::System`] if another editor has it open, or threads cannot be started.
    pub fn open(scene: Scene, sensor: Sensor, options: SessionOptions) -> Result<Self> {
        let class = sensor.spec().class.clone();
        let mut world = scene.world;
        let own = by_id(&world, &class);
        let file = options.layer.as_deref().map(|path| read_layer(path, &class)).transpose()?;
        if let Some(file) = &file {
            world.apply_unchecked(merging(world.environment(), file))?;
        }
        let removed = file.iter().flat_map(|f| f.removed.iter().copied());
        let known = own.keys().copied().chain(world.environment().retired(&class)).chain(removed);
        let layer = world.environment().layer(&class);
        let used = known.chain(layer.into_iter().flat_map(|l| &l.features).map(|f| f.id)).max().unwrap_or(0);
        let target = Target::of(&scene.path, &options, &class)?;
        let journal = Journal::open(&target)?;
        let placed = layer.map_or(Ok(PlacedFeatures::default()), |layer| features::place_layer(&world, layer))?;
        let mut notices = Vec::new();
        if !placed.lost.is_empty() {
            let some: Vec<String> = placed.lost.iter().take(5).map(u32::to_string).collect();
            notices.push(format!("{} features lie on no polygon, such as {}", placed.lost.len(), some.join(", ")));
        }
        let first = options.pose.unwrap_or_else(|| first_pose(&world));
        let session = Self {
            predictor: Predictor::new(options.engine.clone())?,
            aside: Predictor::new(options.engine.clone().with_backend(Backend::Cpu))?,
            saved: by_id(&world, &class),
            scene: scene.path,
            next_id: used.saturating_add(1),
            undo: Vec::new(),
            redo: Vec::new(),
            version: 1,
            map: None,
            stale: false,
            // A turn there and back leaves 12.000000000000002 of 12 degrees.
            first_pose: six_of(&first).map(|x| (x * 1e9).round() / 1e9),
            world,
            sensor,
            class,
            own,
            target,
            journal,
            placed,
            options,
            notices,
        };
        Ok(session)
    }

    /// Answers a message: its name, and its JSON.
    pub fn answer(&mut self, name: &str, body: &[u8]) -> Answer {
        let done = match name {
            "state" => Ok(Answer::Json(self.state().to_string())),
            "features" => self.features(),
            "entry" => parse(body).and_then(|request| self.entry(&request)),
            "frame" => parse(body).and_then(|request| self.frame(&request)),
            "regions" => parse(body).and_then(|request| self.regions(&request)),
            "why" => parse(body).and_then(|request| self.why(&request)),
            "pick" => parse(body).and_then(|request| self.pick(&request)),
            "measured" => Ok(self.measured()),
            "plan" => parse(body).and_then(|request| self.plan(&request)),
            "change" | "generate" | "undo" | "redo" | "restore" | "worth" | "save" => {
                /// The version of any of these requests.
                #[derive(Deserialize)]
                struct Any {
                    version: u64,
                }
                match parse::<Any>(body) {
                    Ok(any) if any.version != self.version => Ok(Answer::Behind(self.state().to_string())),
                    Ok(_) => self.change_something(name, body).or_else(|e| behind(self, e)),
                    Err(e) => Err(e),
                }
            }
            _ => Ok(Answer::Unknown),
        };
        done.map_err(|e| e.at(name)).into()
    }

    fn change_something(&mut self, name: &str, body: &[u8]) -> Result<Answer> {
        match name {
            "worth" => return self.worth(&parse(body)?),
            "save" => return self.save(&parse(body)?).map(|said| self.changed(&said)),
            "restore" => self.restore(&parse(body)?)?,
            _ if self.journal.offers() => {
                let remedy = "restore or drop them first";
                return Err(Error::usage("steps of an earlier session are offered", remedy));
            }
            "change" => self.change(&parse(body)?)?,
            "generate" => {
                let made = self.generate(&parse(body)?)?;
                return Ok(self.changed(&format!("{made} features made")));
            }
            _ => {
                parse::<Versioned>(body)?;
                self.take_back(name == "undo")?;
            }
        }
        Ok(self.changed(""))
    }

    /// The state after a change, with a word on it.
    fn changed(&self, said: &str) -> Answer {
        let mut state = self.state();
        state["said"] = said.into();
        Answer::Json(state.to_string())
    }

    /// The layer's features, by rising id.
    pub(crate) fn listed(&self) -> &[Arc<Feature>] {
        self.world.environment().layer(&self.class).map_or(&[], |layer| &layer.features)
    }

    /// The tolerance of the layer, metres.
    pub(crate) fn tolerance(&self) -> f64 {
        self.world.environment().layer(&self.class).map_or(DEFAULT_TOLERANCE, |layer| layer.tolerance)
    }

    /// One feature, as in a layer file.
    fn entry(&self, request: &EntryRequest) -> Result<Answer> {
        let feature = self.world.environment().feature(&self.class, request.id);
        let feature = feature
            .ok_or_else(|| Error::usage(format!("there is no feature {}", request.id), "choose one from the list"))?;
        Ok(Answer::Json(json!({ "version": self.version, "feature": layer_fields(feature) }).to_string()))
    }

    /// What the page shows of the session.
    pub(crate) fn state(&self) -> Value {
        let spec = self.sensor.spec();
        let outputs: Vec<Value> = Output::WITH_FEATURES
            .into_iter()
            .filter(|output| output.is_made_for(&self.sensor))
            .map(|output| {
                let needs: Vec<&str> = preview_needs(&self.sensor, output).iter().map(Output::name).collect();
                json!({ "name": output.name(), "unit": output.unit(), "needs": needs })
            })
            .collect();
        json!({
            "version": self.version,
            "scene": self.scene.display().to_string(),
            "sensor": {
                "name": spec.name, "class": self.class, "size": [self.sensor.width(), self.sensor.height()],
                "camera": self.sensor.is_camera(), "pixel_sigma": spec.noise.pixel_sigma,
                "mount_height": spec.mount.translation.z, "range_max": finite(spec.range_max),
                "projects": self.sensor.check_projection().is_ok(), "field_of_view": field_of_view(&self.sensor),
            },
            "measured": self.options.measured.is_some(),
            "outputs": outputs,
            "pose": self.first_pose,
            "command": self.options.command.iter().map(|word| quoted(word)).collect::<Vec<_>>().join(" "),
            "layer": self.target.in_words(),
            "layer_word": quoted(&self.target.in_words()),
            "tolerance": self.tolerance(),
            "named": self.target.is_named(),
            "stored": self.target.is_store(),
            "features": self.listed().len(),
            "lost": self.placed.lost.len(),
            "next_id": self.next_id,
            "unsaved": self.unsaved(),
            "undo": self.undo.last().map(|step| &step.label),
            "redo": self.redo.last().map(|step| &step.label),
            "steps": self.undo.len(),
            "offered": self.journal.offered(),
            "notices": self.notices,
            "bounds": bounds(&self.world),
        })
    }

    /// Number of features that differ from the saved ones.
    fn unsaved(&self) -> usize {
        if self.target.is_store() {
            return 0;
        }
        let now = self.listed();
        let same = now.iter().filter(|f| self.saved.get(&f.id).is_some_and(|s| s == *f)).count();
        let changed = now.iter().filter(|f| self.saved.contains_key(&f.id)).count();
        (now.len() - same) + (self.saved.len() - changed)
    }

    /// The layer in columns; names and objects are numbers of tables.
    fn features(&self) -> Result<Answer> {
        let (mut names, mut objects) = (Table::default(), Table::default());
        let round = |x: f64| (x * 1e3).round() / 1e3;
        let (mut ids, mut kinds, mut name, mut object, mut length) = (vec![], vec![], vec![], vec![], vec![]);
        for f in self.listed() {
            ids.push(f.id);
            kinds.push(f.shape.kind());
            name.push(names.number(f.name.as_deref().unwrap_or_default()));
            object.push(objects.number(f.object.as_deref().unwrap_or_default()));
            length.push(round(length_of(f)));
        }
        let (names, objects) = (names.words, objects.words);
        let all: Vec<&str> = self.world.environment().objects().iter().map(|o| o.name.as_str()).collect();
        Ok(Answer::Json(
            json!({
                "version": self.version, "ids": ids, "kinds": kinds, "name": name, "object": object, "length": length,
                "names": names, "objects": objects, "all_objects": all, "lost": &self.placed.lost[..],
            })
            .to_string(),
        ))
    }

    /// Applies a change to world and journal or store, and to all that depends on the features. Returns its inverse.
    /// New and altered features must lie on polygons, unless the change `restores` earlier ones.
    pub(crate) fn apply(&mut self, change: &Change, label: &str, restores: bool) -> Result<Change> {
        let mut touched = BTreeSet::new();
        named(change, &mut touched);
        let inverse = self.world.apply_unchecked(change.clone())?;
        let placed = self.place(&touched, restores).and_then(|placed| {
            self.keep(change, label)?;
            Ok(placed)
        });
        match placed {
            Ok(placed) => self.placed = placed,
            Err(e) => {
                self.world.apply_unchecked(inverse)?;
                return Err(e);
            }
        }
        let most = touched.last().copied().unwrap_or(0);
        self.next_id = self.next_id.max(most.saturating_add(1));
        let there = |id: &u32| self.placed.features.binary_search_by_key(id, |p| p.feature.id).is_ok();
        let (set, gone): (Vec<u32>, Vec<u32>) = touched.into_iter().partition(there);
        if let Some(map) = &mut self.map {
            map.forget(&gone);
            map.miss(&set);
        }
        self.version += 1;
        Ok(inverse)
    }

    /// The placed features after a change of some.
    fn place(&self, touched: &BTreeSet<u32>, restores: bool) -> Result<PlacedFeatures> {
        let features: Vec<Arc<Feature>> = self.listed().iter().filter(|f| touched.contains(&f.id)).cloned().collect();
        let tolerance = self.tolerance();
        let layer = FeatureLayer { class: self.class.clone(), tolerance, features, pose_covariances: Vec::new() };
        let found = features::place_layer(&self.world, &layer)?;
        if let Some(id) = found.lost.first().filter(|_| !restores) {
            let feature = layer.features.iter().find(|f| f.id == *id);
            let why = feature.and_then(|f| features::why_off(&self.world, &self.class, tolerance, f));
            return Err(why.unwrap_or_else(|| Error::invalid(format!("feature {id} lies on no polygon"), "move it")));
        }
        let untouched = self.placed.features.iter().filter(|p| !touched.contains(&p.feature.id)).cloned();
        let mut all: Vec<PlacedFeature> = untouched.chain(found.features.iter().cloned()).collect();
        all.sort_by_key(|p| p.feature.id);
        let mut lost: Vec<u32> = self.placed.lost.iter().copied().filter(|id| !touched.contains(id)).collect();
        lost.extend(&*found.lost);
        lost.sort_unstable();
        Ok(PlacedFeatures { features: all.into(), lost: lost.into(), objects: self.placed.objects.clone() })
    }

    /// Starts over from another version of the world: that of a store which another program has changed.
    pub(crate) fn reload(&mut self, world: World) -> Result<()> {
        let layer = world.environment().layer(&self.class);
        self.placed = layer.map_or(Ok(PlacedFeatures::default()), |layer| features::place_layer(&world, layer))?;
        self.own = by_id(&world, &self.class);
        self.saved = self.own.clone();
        let used = self.own.keys().copied().chain(world.environment().retired(&self.class)).max().unwrap_or(0);
        self.next_id = self.next_id.max(used.saturating_add(1));
        self.world = world;
        (self.undo, self.redo, self.map) = (Vec::new(), Vec::new(), None);
        self.version += 1;
        Ok(())
    }
}

/// Words with their numbers.
#[derive(Default)]
struct Table {
    words: Vec<String>,
    numbers: HashMap<String, usize>,
}

impl Table {
    fn number(&mut self, word: &str) -> usize {
        if let Some(number) = self.numbers.get(word) {
            return *number;
        }
        self.numbers.insert(word.to_owned(), self.words.len());
        self.words.push(word.to_owned());
        self.words.len() - 1
    }
}

/// The features of a class in a world, by id.
pub(crate) fn by_id(world: &World, class: &str) -> HashMap<u32, Arc<Feature>> {
    let layer = world.environment().layer(class);
    layer.into_iter().flat_map(|layer| &layer.features).map(|f| (f.id, f.clone())).collect()
}

fn read_layer(path: &Path, class: &str) -> Result<LayerFile> {
    let file = files::read_layer(path)?;
    if file.layer.class != class {
        let what = format!("the layer has class {:?}, the sensor has class {class:?}", file.layer.class);
        return Err(Error::usage(what, "give a layer of the sensor's class").in_file(path));
    }
    Ok(file)
}

/// The ids that a change inserts, alters, restores or deletes.
fn named(change: &Change, to: &mut BTreeSet<u32>) {
    match change {
        Change::InsertFeature { feature, .. }
        | Change::SetFeature { feature, .. }
        | Change::RestoreFeature { feature, .. } => {
            to.insert(feature.id);
        }
        Change::DeleteFeature { id, .. } => {
            to.insert(*id);
        }
        Change::Group(changes) => changes.iter().for_each(|change| named(change, to)),
        _ => {}
    }
}

/// A pose inside the scene, or the middle of its bounds if no pose is free.
fn first_pose(world: &World) -> SensorPose {
    let middle = || {
        let bounds = world.environment().bounds();
        let at = if bounds.is_empty() { glam::DVec3::ZERO } else { 0.5 * (bounds.min + bounds.max) };
        Pose::from_xyz_rpy(at, 0.0, 0.0, 0.0)
    };
    SensorPose::new(free_poses(world, 1, 1995).ok().and_then(|poses| poses.first().copied()).unwrap_or_else(middle))
}

/// Length of an edge, or of the longest side of an area, metres.
fn length_of(feature: &Feature) -> f64 {
    let points = feature.shape.points();
    let sides = (0..points.len()).map(|i| points[i].distance(points[(i + 1) % points.len()]));
    sides.fold(0.0, f64::max)
}

/// The angle that the middle row spans, degrees.
fn field_of_view(sensor: &Sensor) -> f64 {
    let rays: Vec<_> = (0..sensor.width()).filter_map(|column| sensor.ray(column, sensor.height() / 2)).collect();
    let angle = |pair: &[glam::DVec3]| pair[0].cross(pair[1]).length().atan2(pair[0].dot(pair[1]));
    rays.windows(2).map(angle).sum::<f64>().to_degrees()
}

fn bounds(world: &World) -> Value {
    let bounds = world.environment().bounds();
    if bounds.is_empty() { Value::Null } else { json!([bounds.min.to_array(), bounds.max.to_array()]) }
}

fn finite(x: f64) -> Option<f64> {
    x.is_finite().then_some(x)
}

/// A word for a POSIX shell.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./:,=+@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}
