//! Material properties of a scene, from the sidecar `SCENE.materials.toml` or the same keys in a glTF's
//! `extras.presight`.
//!
//! For `hospital.glb` the sidecar is `hospital.materials.toml`:
//!
//! ```toml
//! format = 1
//! # Pose of the scene (z-up, after the turn from glTF's y-up) in the world:
//! # x, y, z in metres, then roll, pitch, yaw in degrees. Default: the world's origin.
//! world_from_scene = [4469320.25, 5333710.5, 512.0, 0.0, 0.0, 90.0]
//! up = "z"                     # the axis of the file that points up: "y" (default, glTF's) or "z"
//! scale = 0.001                # metres in one unit of the file, default 1
//!
//! [material."Glass"]           # every material of the scene with this name
//! reflection = 0.1             # reflection factor, 0 to 1, default 1
//! one_sided = false            # true: visible from its front only, even if mirrored; default false
//!
//! [material."Glass".classes]   # by sensor class: "opaque" (default), "transparent" or "invisible"
//! laser = "transparent"
//! radar = "invisible"
//! ```
//!
//! `scale` is applied first, then the turn, then `world_from_scene`. One error lists all mistakes of a sidecar.
//!
//! In a glTF file a material's `extras` may hold `"presight": {"reflection": 0.1, "one_sided": false,
//! "classes": {"laser": "transparent"}}`. The sidecar overrides single keys. Unknown keys and materials are errors,
//! because a typing mistake would otherwise change images silently.
//!
//! glTF's own `doubleSided` is ignored: it is meant for rendering, and its default would make the back faces of most
//! models invisible.

use super::faults::{Faults, Table};
use crate::preparation::{SceneFrame, Up};
use crate::text;
use glam::DVec3;
use presight_model::environment::{Appearance, Material};
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::limits;
use presight_model::printable::did_you_mean;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The content of a sidecar file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sidecar {
    /// Pose of the z-up scene in the world.
    pub world_from_scene: Pose,
    /// The axis of the file that points up, if given.
    pub up: Option<Up>,
    /// Metres in one unit of the file, if given.
    pub scale: Option<f64>,
    materials: BTreeMap<String, MaterialProperties>,
    /// Mistakes in the text.
    faults: Faults,
}

/// Properties of one material; absent ones stay unchanged.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaterialProperties {
    reflection: Option<f64>,
    one_sided: Option<bool>,
    #[serde(default)]
    classes: BTreeMap<String, Appearance>,
}

impl MaterialProperties {
    /// Reads the table of a sidecar.
    fn read(text: &str, mut table: Table<'_>, faults: &mut Faults) -> Self {
        let reflection = faults.take(text, &mut table, "reflection");
        let one_sided = faults.take(text, &mut table, "one_sided");
        let mut classes = BTreeMap::new();
        for (class, value) in faults.take_table(text, &mut table, "classes") {
            classes.extend(faults.read(text, value).map(|appearance| (class.into_inner().into_owned(), appearance)));
        }
        faults.check_empty(text, table, "reflection, one_sided and classes");
        Self { reflection, one_sided, classes }
    }

    /// Applies the properties that are given.
    pub fn apply_to(&self, material: &mut Material) {
        if let Some(reflection) = self.reflection {
            material.reflection = reflection;
        }
        if let Some(one_sided) = self.one_sided {
            material.one_sided = one_sided;
        }
        material.appearance.extend(self.classes.iter().map(|(class, &a)| (class.clone(), a)));
    }
}

/// The path of a scene's sidecar, which need not exist.
pub fn sidecar_path(scene: &Path) -> PathBuf {
    scene.with_extension("materials.toml")
}

impl Sidecar {
    /// Reads the sidecar of a scene. A scene without a sidecar gives an empty one. [`Sidecar::apply_to`] reports wrong
    /// keys and values, together with materials that the scene lacks.
    pub(crate) fn for_scene(scene: &Path) -> Result<Self> {
        let path = sidecar_path(scene);
        match std::fs::metadata(&path) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(Self::default()),
            _ => text::from_settings(&path, Self::read),
        }
    }

    /// Reads the text of a sidecar.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] naming the lines of all unknown keys and impossible values,
    /// [`presight_model::ErrorKind::Unsupported`] for a newer format.
    pub fn parse(text: &str) -> Result<Self> {
        let sidecar = Self::read(text)?;
        sidecar.faults.check()?;
        Ok(sidecar)
    }

    fn read(text: &str) -> Result<Self> {
        let mut table = Faults::parse(text)?;
        text::check_format(text)?;
        table.remove("format");
        let mut faults = Faults::default();
        let place: Option<[f64; 6]> = faults.take(text, &mut table, "world_from_scene");
        let world_from_scene = match place {
            Some(v) if !v.iter().all(|x| x.is_finite() && x.abs() <= limits::MAX_COORDINATE) => {
                let remedy = "give [x, y, z, roll_deg, pitch_deg, yaw_deg]";
                faults.note("world_from_scene", "a number is not finite, or too large", remedy);
                Pose::IDENTITY
            }
            Some([x, y, z, roll, pitch, yaw]) => {
                Pose::from_xyz_rpy(DVec3::new(x, y, z), roll.to_radians(), pitch.to_radians(), yaw.to_radians())
            }
            None => Pose::IDENTITY,
        };
        let up = faults.take(text, &mut table, "up");
        let scale: Option<f64> = faults.take(text, &mut table, "scale");
        if let Some(Err(e)) = scale.map(SceneFrame::check_scale) {
            faults.note("scale", e.what(), e.remedy());
        }
        let mut materials = BTreeMap::new();
        for (name, value) in faults.take_table(text, &mut table, "material") {
            let own = faults.as_table(text, value);
            materials.insert(name.into_inner().into_owned(), MaterialProperties::read(text, own, &mut faults));
        }
        faults.check_empty(text, table, "format, world_from_scene, up, scale and material");
        Ok(Self { world_from_scene, up, scale, materials, faults })
    }

    /// Changes the named materials of a scene.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] listing all unknown materials, reflection factors outside 0..=1 and
    /// mistakes in the text.
    pub fn apply_to(&self, materials: &mut [Material]) -> Result<()> {
        let mut faults = self.faults.clone();
        for (name, properties) in &self.materials {
            let mut known = false;
            for material in materials.iter_mut().filter(|m| &m.name == name) {
                properties.apply_to(material);
                if let (Err(e), false) = (material.check(), known) {
                    faults.note(e.place().unwrap_or("material"), e.what(), e.remedy());
                }
                known = true;
            }
            if !known {
                let alike = did_you_mean(name, materials.iter().map(|m| m.name.as_str()));
                let remedy = format!("{alike}`presight inspect` lists the names; correct or remove it");
                faults.note(format!("material {name:?}"), "the scene has no material of this name", remedy);
            }
        }
        faults.check()
    }
}

/// Reads the value of `extras` of a glTF material.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] on an unknown key or impossible value under `presight`; other extras are
/// ignored.
pub fn from_extras(extras: &str) -> Result<Option<MaterialProperties>> {
    let value: serde_json::Value = serde_json::from_str(extras)
        .map_err(|e| Error::invalid(e.to_string(), "export the model again").at("extras"))?;
    let Some(own) = value.get("presight") else { return Ok(None) };
    MaterialProperties::deserialize(own).map(Some).map_err(|e| {
        Error::invalid(e.to_string(), "known keys are reflection, one_sided, classes").at("extras.presight")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"
        format = 1
        world_from_scene = [5e6, 1.5, 0, 0, 0, 90]
        [material."a.b"]
        reflection = 0.4
        one_sided = true
        [material."a.b".classes]
        radar = "transparent"
        laser = "invisible"
    "#;

    #[test]
    fn a_whole_sidecar_is_applied() {
        let sidecar = Sidecar::parse(TEXT).unwrap();
        assert_eq!(sidecar.world_from_scene.translation.x, 5e6);
        let turned = sidecar.world_from_scene.transform_point(DVec3::X) - DVec3::new(5e6, 2.5, 0.0);
        assert!(turned.length() < 1e-9);
        let mut materials = [Material::named("a.b"), Material::named("c")];
        sidecar.apply_to(&mut materials).unwrap();
        assert_eq!((materials[0].reflection, materials[0].one_sided), (0.4, true));
        assert_eq!(materials[0].appearance("radar"), Appearance::Transparent);
        assert_eq!(materials[0].appearance("laser"), Appearance::Invisible);
        assert_eq!(materials[0].appearance("video"), Appearance::Opaque);
        assert_eq!(materials[1], Material::named("c"));
    }

    #[test]
    fn mistakes_are_errors_with_their_place() {
        let cases = [
            ("[material.a]\nreflection = 1", "format = 1"),
            ("format = 2\nnew = 1", "format 2"),
            ("format = 1\nmaterials = 3", "line 2"),
            ("format = 1\n[material.a]\nreflektion = 1", "line 3"),
            ("format = 1\n[material.a.classes]\nradar = \"glassy\"", "line 3"),
            ("format = 1\nworld_from_scene = [1, 2, 3]", "line 2"),
            ("format = 1\nworld_from_scene = [nan, 0, 0, 0, 0, 0]", "world_from_scene"),
            ("format = ", "line 1"),
        ];
        for (text, part) in cases {
            let e = Sidecar::parse(text).unwrap_err().to_string();
            assert!(e.contains(part) && !e.contains('\n'), "{text:?}: {e}");
        }
        for (text, part) in
            [("up = \"x\"", "line 2"), ("scale = 0", "0 is not a valid"), ("scale = nan", "NaN is not a valid scale")]
        {
            let e = Sidecar::parse(&format!("format = 1\n{text}")).unwrap_err().to_string();
            assert!(e.contains(part), "{text:?}: {e}");
        }
        let stray = Sidecar::parse(TEXT).unwrap().apply_to(&mut [Material::named("c")]).unwrap_err();
        assert!(stray.to_string().contains("a.b"), "{stray}");
    }

    #[test]
    fn all_mistakes_are_told_at_once() {
        let text = "format = 1\nscale = -1\nupp = \"z\"\n[material.a]\nreflektion = 1\none_sided = 3\n\
            [material.a.classes]\nradar = \"glassy\"\n[material.b]\nreflection = 2.0\n[material.c]\n";
        let e = Sidecar::read(text).unwrap().apply_to(&mut [Material::named("a"), Material::named("b")]).unwrap_err();
        let said = e.to_string();
        for part in ["7 mistakes", "-1 is not a valid", "line 3", "line 5", "line 6", "line 8", "\"b\"", "\"c\""] {
            assert!(said.contains(part), "{part}: {said}");
        }
        let syntax = Sidecar::parse("format = 1\na = = 2\nb = [\n").unwrap_err().to_string();
        assert!(syntax.contains("line 2") && syntax.contains("mistakes"), "{syntax}");
    }

    #[test]
    fn the_file_says_which_way_is_up() {
        let sidecar = Sidecar::parse("format = 1\nup = \"z\"\nscale = 0.001\n").unwrap();
        assert_eq!((sidecar.up, sidecar.scale), (Some(Up::Z), Some(0.001)));
    }

    #[test]
    fn extras_are_read_and_strangers_left_alone() {
        assert_eq!(from_extras(r#"{"texture": 1}"#).unwrap(), None);
        let p = from_extras(r#"{"presight": {"reflection": 0.25, "classes": {"radar": "invisible"}}}"#).unwrap();
        let mut m = Material::named("m");
        p.unwrap().apply_to(&mut m);
        assert_eq!((m.reflection, m.appearance("radar")), (0.25, Appearance::Invisible));
        assert!(from_extras(r#"{"presight": {"reflexion": 0.25}}"#).is_err());
    }
}
