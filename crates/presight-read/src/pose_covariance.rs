//! Pose covariances as text: standard deviations, or 36 numbers in the order of ROS messages.

use super::text::from_settings;
use presight_model::error::{Error, Result};
use presight_model::geometry::{InWorld, PoseCovariance};
use presight_model::limits;
use std::path::Path;

/// Reads `sx,sy,sz,sroll_deg,spitch_deg,syaw_deg` (standard deviations, metres and degrees), or the named JSON file.
///
/// ```
/// let covariance = presight::files::parse_pose_covariance("0.1,0.1,0,0,0,2")?;
/// assert!((covariance[1][1] - 0.01).abs() < 1e-15);
/// assert!((covariance[5][5].sqrt().to_degrees() - 2.0).abs() < 1e-12);
/// # Ok::<(), presight::Error>(())
/// ```
///
/// # Errors
/// [`presight_model::ErrorKind::Usage`] for invalid or negative numbers; [`presight_model::ErrorKind::Invalid`] for an
/// invalid file.
pub fn parse(text: &str) -> Result<PoseCovariance<InWorld>> {
    file(text).map_or_else(|| deviations(text), from_file)
}

/// The file that a text for [`parse`] names; `None` for standard deviations.
pub fn file(text: &str) -> Option<&Path> {
    (!text.contains(',')).then_some(Path::new(text))
}

fn deviations(text: &str) -> Result<PoseCovariance<InWorld>> {
    let remedy = "give sx,sy,sz,sroll_deg,spitch_deg,syaw_deg, metres and degrees, or a JSON file of 36 numbers";
    let wrong = |what: String| Error::usage(format!("pose covariance {text}: {what}"), remedy);
    let words: Vec<&str> = text.split(',').map(str::trim).collect();
    if words.len() != 6 {
        return Err(wrong(format!("{} numbers where 6 are needed", words.len())));
    }
    let mut sigmas = [0.0; 6];
    for (i, word) in words.into_iter().enumerate() {
        let value = word.parse::<f64>().ok().filter(|v| (0.0..=limits::MAX_COORDINATE).contains(v));
        let sigma = value.ok_or_else(|| wrong(format!("{word:?} is not a standard deviation")))?;
        sigmas[i] = if i < 3 { sigma } else { sigma.to_radians() };
    }
    Ok(PoseCovariance::from_sigmas(sigmas))
}

fn from_file(path: &Path) -> Result<PoseCovariance<InWorld>> {
    from_settings(path, from_json)
}

/// Reads the JSON text of 36 numbers: row-major, x y z, then rotation about x y z, metres and radians.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] for text that is not a covariance.
pub fn from_json(text: &str) -> Result<PoseCovariance<InWorld>> {
    let remedy = "give 36 numbers, row-major: x y z, then rotation about x y z, metres and radians";
    let numbers: Vec<f64> = serde_json::from_str(text)
        .map_err(|e| Error::invalid(format!("not a list of numbers: {e}"), remedy).caused_by(e))?;
    PoseCovariance::from_row_major(&numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deviations_and_files_are_read() {
        let c = parse("0.1,0.2,0,0,0,180").unwrap();
        assert!((c[1][1] - 0.04).abs() < 1e-15 && (c[5][5] - std::f64::consts::PI.powi(2)).abs() < 1e-12);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cov.json");
        let write = |numbers: &[f64]| std::fs::write(&path, serde_json::to_string(numbers).unwrap()).unwrap();
        let mut numbers = [0.0; 36];
        (numbers[0], numbers[7]) = (4.0, 9.0);
        write(&numbers);
        assert_eq!(parse(path.to_str().unwrap()).unwrap()[1][1], 9.0);
        numbers[1] = 1.0;
        write(&numbers);
        assert!(parse(path.to_str().unwrap()).is_err(), "not symmetric");
        for bad in ["1,2,3", "1,2,3,4,5,x", "1,2,3,4,5,-6", "nan,0,0,0,0,0", "1e200,0,0,0,0,0"] {
            assert!(parse(bad).is_err(), "{bad}");
        }
    }
}
