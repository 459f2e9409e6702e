//! File names of predictions: literal for one prediction, templates for several.

use super::outputs::OutputFiles;
use super::templates::{Field, Names, Template};
use presight::{Error, ErrorKind, Output, Outputs, Result, Sensor};
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// The file names of all predictions.
#[derive(Debug)]
pub struct FileNames {
    /// A template for each kind of file, in the order of [`KINDS`].
    templates: [Option<Template>; KINDS.len()],
    npy: Option<Template>,
    rays: Option<Template>,
    /// The images written as arrays.
    outputs: Vec<Output>,
}

/// Options and the file name endings that they accept.
const KINDS: [(&str, &[&str]); 6] = [
    ("--out", &["exr"]),
    ("--png", &["png"]),
    ("--depth-png", &["png"]),
    ("--mask", &["png"]),
    ("--points", &["ply", "pcd"]),
    ("--features", &["json"]),
];

/// The files of one prediction.
#[derive(Clone, Debug, Default)]
pub struct Paths {
    pub out: Option<PathBuf>,
    pub png: Option<PathBuf>,
    pub depth_png: Option<PathBuf>,
    pub mask: Option<PathBuf>,
    pub points: Option<PathBuf>,
    pub features: Option<PathBuf>,
    /// One array per image.
    pub npy: Vec<(Output, PathBuf)>,
}

impl Paths {
    /// Returns true if all files exist and were not modified after `until`. Stacked arrays are not checked.
    pub fn are_there(&self, stacked: bool, until: SystemTime) -> bool {
        let untouched = |path: &PathBuf| {
            let metadata = path.metadata();
            metadata.is_ok_and(|m| !m.is_file() || m.modified().is_ok_and(|modified| modified <= until))
        };
        let named = [&self.out, &self.png, &self.depth_png, &self.mask, &self.points, &self.features];
        let arrays = self.npy.iter().map(|(_, path)| path).filter(|_| !stacked);
        named.into_iter().flatten().chain(arrays).all(untouched)
    }
}

impl FileNames {
    /// Parses the names in `given`, which are in the order of [`KINDS`]: templates for `many` predictions, literal
    /// names for one. `npy` is always a template.
    ///
    /// # Errors
    /// [`ErrorKind::Usage`] for an invalid template.
    pub fn new(
        given: [Option<&PathBuf>; KINDS.len()],
        npy: Option<&str>,
        rays: Option<&PathBuf>,
        outputs: Outputs,
        many: bool,
    ) -> Result<Self> {
        let mut templates = [const { None }; KINDS.len()];
        for ((template, path), (option, _)) in templates.iter_mut().zip(given).zip(KINDS) {
            *template = path.map(|path| template_of(option, path, many)).transpose()?;
        }
        let array = |text: &str| text.parse().map_err(|e: Error| e.at(format!("--npy {text}")));
        let rays = rays.map(|path| template_of("--rays", path, many)).transpose()?;
        Ok(Self { templates, npy: npy.map(array).transpose()?, rays, outputs: outputs.iter().collect() })
    }

    /// Returns true if each prediction writes a file or a part of one.
    pub fn write_predictions(&self) -> bool {
        self.npy.is_some() || self.templates.iter().any(Option::is_some)
    }

    /// Returns true if one array holds the images of all poses.
    pub fn are_stacked(&self) -> bool {
        self.npy.as_ref().is_some_and(|npy| !npy.tells_poses_apart())
    }

    /// The files of one prediction.
    ///
    /// # Errors
    /// Those of [`Template::path`].
    pub fn paths(&self, names: &Names<'_>) -> Result<Paths> {
        let path = |kind: usize| {
            let template = self.templates[kind].as_ref();
            template.map(|template| template.path(names).map_err(|e| e.at(KINDS[kind].0))).transpose()
        };
        let array = |template: &Template| -> Result<Vec<(Output, PathBuf)>> {
            let one = |&output: &Output| Ok((output, template.path(&Names { output: output.name(), ..*names })?));
            self.outputs.iter().map(one).collect::<Result<_>>().map_err(|e| e.at("--npy"))
        };
        Ok(Paths {
            out: path(0)?,
            png: path(1)?,
            depth_png: path(2)?,
            mask: path(3)?,
            points: path(4)?,
            features: path(5)?,
            npy: self.npy.as_ref().map(array).transpose()?.unwrap_or_default(),
        })
    }

    /// The file for a sensor's rays.
    ///
    /// # Errors
    /// Those of [`Template::path`].
    pub fn rays(&self, sensor: &Sensor) -> Result<Option<PathBuf>> {
        let names = Names { sensor: &sensor.spec().name, ..Names::default() };
        self.rays.as_ref().map(|rays| rays.path(&names).map_err(|e| e.at("--rays"))).transpose()
    }

    /// Adds the files of all predictions to `files`, for poses with these time stamps.
    ///
    /// # Errors
    /// [`ErrorKind::Usage`] for a name shared by several predictions, and errors of [`OutputFiles::add`];
    /// [`ErrorKind::System`] for a missing folder.
    pub fn add_to(&self, files: &mut OutputFiles, stamps: &[&str], sensors: &[Sensor]) -> Result<()> {
        self.check_fields(stamps.len(), sensors.len())?;
        let mut folders = HashSet::new();
        for (index, sensor) in (0..stamps.len()).flat_map(|i| sensors.iter().map(move |sensor| (i, sensor))) {
            let names = Names { index, stamp: stamps[index], sensor: &sensor.spec().name, output: "" };
            let Paths { out, png, depth_png, mask, points, features, npy } = self.paths(&names)?;
            for ((option, endings), path) in KINDS.into_iter().zip([out, png, depth_png, mask, points, features]) {
                files.add(option, path.as_deref(), endings)?;
                path.iter().try_for_each(|path| check_folder(path, &mut folders))?;
            }
            for (_, path) in npy.iter().filter(|_| index == 0 || !self.are_stacked()) {
                files.add("--npy", Some(path), &["npy"])?;
                check_folder(path, &mut folders)?;
            }
            if index == 0 {
                files.add("--rays", self.rays(sensor)?.as_deref(), &["npy"])?;
            }
        }
        Ok(())
    }

    /// Checks that the fields of each template distinguish all predictions.
    fn check_fields(&self, poses: usize, sensors: usize) -> Result<()> {
        let kinds = KINDS.iter().zip(&self.templates).map(|((option, _), template)| (*option, template));
        for (option, template) in kinds.chain([("--npy", &self.npy), ("--rays", &self.rays)]) {
            let Some(template) = template else { continue };
            let of_poses = option != "--npy" && option != "--rays";
            let (what, field) = if poses > 1 && of_poses && !template.tells_poses_apart() {
                (format!("{poses} poses"), "{i} or {t}")
            } else if sensors > 1 && !template.has(Field::Sensor) {
                (format!("{sensors} sensors"), "{sensor}")
            } else if option == "--npy" && self.outputs.len() > 1 && !template.has(Field::Output) {
                (format!("{} images", self.outputs.len()), "{output}")
            } else {
                continue;
            };
            let remedy = format!("put {field} into it, as in 'run/{{i:06}}.{{output}}.npy'");
            return Err(Error::usage(format!("{option}: one name for {what}"), remedy));
        }
        Ok(())
    }
}

fn template_of(option: &str, path: &Path, many: bool) -> Result<Template> {
    if !many {
        return Ok(Template::literal(path));
    }
    let text = path.to_str().ok_or_else(|| Error::usage("the name is not UTF-8", "choose another name").at(option))?;
    text.parse().map_err(|e: Error| e.at(format!("{option} {text}")))
}

/// Checks that the folder of a file exists. `seen` caches the folders found.
fn check_folder(path: &Path, seen: &mut HashSet<PathBuf>) -> Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if seen.contains(folder) {
        return Ok(());
    }
    if !folder.is_dir() {
        let what = "cannot write: its folder does not exist";
        return Err(Error::new(ErrorKind::System, what, "create the folder first, or write elsewhere").in_file(path));
    }
    seen.insert(folder.to_owned());
    Ok(())
}
