//! The up axis and unit of a scene file, from the command line.

use presight::Result;
use presight::files::{ImportOptions, SceneFrame, Up};

/// Flags shared by all commands that read a scene.
#[derive(Clone, Debug, clap::Args)]
pub struct FrameArgs {
    /// The axis of the scene file that points up, y or z [default: from the sidecar, else y as in glTF]
    #[arg(long, value_name = "AXIS")]
    up: Option<Up>,

    /// Metres in one unit of the scene file, such as 0.001 [default: from the sidecar, else 1]
    #[arg(long, value_name = "X")]
    scale: Option<f64>,
}

impl FrameArgs {
    /// Import options with these flags set.
    ///
    /// # Errors
    /// [`presight::ErrorKind::Usage`] if the scale is invalid.
    pub fn options(&self) -> Result<ImportOptions> {
        self.scale.map_or(Ok(()), SceneFrame::check_scale).map_err(|e| e.at("--scale"))?;
        Ok(ImportOptions { up: self.up, scale: self.scale, ..ImportOptions::default() })
    }

    /// The flags as they were given, for a command that repeats them.
    #[cfg(feature = "edit")]
    pub fn given(&self) -> Vec<String> {
        let axis = |up| if up == Up::Z { "z" } else { "y" };
        let up = self.up.map(|up| ["--up".to_owned(), axis(up).to_owned()]);
        let scale = self.scale.map(|scale| ["--scale".to_owned(), scale.to_string()]);
        up.into_iter().chain(scale).flatten().collect()
    }
}
