//! How a scene's file lies in the world, as the command line says it.

use presight::Result;
use presight::io::gltf::ImportOptions;
use presight::preparation::{SceneFrame, Up};

/// The flags by which every command reads a scene.
#[derive(Clone, Debug, clap::Args)]
pub struct FrameArgs {
    /// The axis of the scene file that points up, y or z [default: the sidecar's, else y as glTF has it]
    #[arg(long, value_name = "AXIS")]
    up: Option<Up>,

    /// Metres in one unit of the scene file, such as 0.001 [default: the sidecar's, else 1]
    #[arg(long, value_name = "X")]
    scale: Option<f64>,
}

impl FrameArgs {
    /// Import options with them.
    ///
    /// # Errors
    /// [`presight::ErrorKind::Usage`] for what is no scale.
    pub fn options(&self) -> Result<ImportOptions> {
        self.scale.map_or(Ok(()), SceneFrame::check_scale).map_err(|e| e.at("--scale"))?;
        Ok(ImportOptions { up: self.up, scale: self.scale, ..ImportOptions::default() })
    }
}
