//! New objects of known shapes: the library and the recognizer of `presight update`.

use crate::print;
use presight::update::{Learner, Library, ProgramRecognizer, Recognizer, SiteFindings};
use presight::{Error, Result, World};
use std::path::PathBuf;
use std::time::Duration;

/// Flags on known shapes.
#[derive(Debug, clap::Args)]
pub struct KnownArgs {
    /// Fit the meshes of this folder (.glb, .gltf) to new objects; a mesh that explains the points better than boxes is
    /// proposed
    #[arg(long, value_name = "DIR")]
    library: Option<PathBuf>,

    /// Recognize new objects by this program, which reads points as PLY and prints {"object": NAME, "pose": [..]}
    ///
    /// It runs once for each group of points, without a shell. Points are in the world, metres. NAME is a file of
    /// --library without its ending, or an object of the map. The pose is x, y, z, roll, pitch, yaw in degrees, or x,
    /// y, z, qx, qy, qz, qw. A proposal that
    /// explains the points no better than boxes, or that rays pass through, is ignored.
    #[arg(long, value_name = "CMD")]
    recognizer: Option<String>,

    /// Maximum time for one answer of the recognizer, milliseconds
    #[arg(long, value_name = "MS", default_value_t = 10_000.0, requires = "recognizer")]
    recognizer_ms: f64,
}

/// The sources of known shapes.
#[derive(Debug)]
pub struct Recognizers {
    library: Library,
    program: Option<ProgramRecognizer>,
}

impl KnownArgs {
    /// Reads the library.
    ///
    /// # Errors
    /// Those of [`Library::open`], and for a recognizer without a name or a time.
    pub fn open(&self) -> Result<Recognizers> {
        let ms = self.recognizer_ms;
        let within = (ms > 0.0).then(|| Duration::try_from_secs_f64(ms / 1e3).ok()).flatten();
        let within =
            within.ok_or_else(|| Error::usage(format!("--recognizer-ms {ms}"), "give milliseconds above 0"))?;
        let program = self.recognizer.as_deref().map(|command| ProgramRecognizer::new(command, within));
        let program = program.transpose().map_err(|e| e.at("--recognizer"))?;
        let Some(folder) = &self.library else { return Ok(Recognizers { library: Library::default(), program }) };
        let (library, notices) = Library::open(folder)?;
        print::notices(&notices);
        Ok(Recognizers { library, program })
    }
}

impl Recognizers {
    /// Replaces boxes by known shapes. If the recognizer fails, the error is reported, and the findings keep their
    /// boxes.
    pub fn improve(&mut self, learner: &mut Learner, world: &World, findings: &mut SiteFindings) {
        let program = self.program.as_mut().map(|program| program as &mut dyn Recognizer);
        if let Err(e) = learner.recognize(world, findings, &self.library, program) {
            print::message(&e.to_string());
        }
    }
}
