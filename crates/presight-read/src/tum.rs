//! Trajectories in the format of the TUM RGB-D benchmark: one pose per line, `timestamp tx ty tz qx qy qz qw`.

use super::file;
use super::text::{from_text, read_line};
use glam::{DQuat, DVec3};
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::printable::quoted;
use std::fs::File;
use std::io::{BufReader, Take};
use std::path::Path;

/// A pose with its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampedPose {
    /// Time in seconds.
    pub time: f64,
    /// The pose.
    pub pose: Pose,
}

/// Reads a trajectory; lines that start with `#` and empty ones are skipped.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] naming a line that is not eight finite numbers with a non-zero quaternion.
pub fn read(path: &Path) -> Result<Vec<StampedPose>> {
    from_text(path, parse)
}

/// As [`read`], with the time stamp of each pose as text.
///
/// # Errors
/// As [`read`].
pub fn read_with_stamps(path: &Path) -> Result<Vec<(String, StampedPose)>> {
    from_text(path, |text| poses_in(text).collect())
}

/// Reads the text of a trajectory.
///
/// # Errors
/// As [`read`], without the file.
pub fn parse(text: &str) -> Result<Vec<StampedPose>> {
    poses_in(text).map(|pose| Ok(pose?.1)).collect()
}

/// The valid lines of a trajectory, and the errors of the others.
pub(crate) fn parse_valid(text: &str) -> (Vec<StampedPose>, Vec<Error>) {
    let (mut poses, mut faults) = (Vec::new(), Vec::new());
    for pose in poses_in(text) {
        match pose {
            Ok((_, pose)) => poses.push(pose),
            Err(e) => faults.push(e),
        }
    }
    (poses, faults)
}

fn poses_in(text: &str) -> impl Iterator<Item = Result<(String, StampedPose)>> {
    (1..).zip(text.lines()).filter_map(|(number, line)| pose_in(line, number).transpose())
}

/// The pose of a line with its time stamp as text; `None` for an empty line and a comment.
fn pose_in(line: &str, number: usize) -> Result<Option<(String, StampedPose)>> {
    let line = line.trim();
    if line.is_empty() || line.starts_with('#') {
        return Ok(None);
    }
    let pose = stamped(line).map_err(|e| e.at(format!("line {number}")))?;
    Ok(Some((line.split_whitespace().next().unwrap_or_default().to_owned(), pose)))
}

/// Opens a trajectory that may be larger than memory. An invalid line gives an error when reached, and ends the stream.
///
/// # Errors
/// As for opening a file; pipes are refused, because callers read the file twice.
pub fn stream(path: &Path) -> Result<impl Iterator<Item = Result<StampedPose>> + use<>> {
    Ok(poses_of(path, file::open(path)?).map(|pose| Ok(pose?.1)))
}

/// As [`stream`], also from a pipe that was passed to this process. Each pose comes as soon as its line does, with its
/// time stamp as text.
///
/// # Errors
/// As for opening a file.
pub fn stream_with_stamps(path: &Path) -> Result<impl Iterator<Item = Result<(String, StampedPose)>> + use<>> {
    Ok(poses_of(path, file::open_or_given(path)?))
}

/// The poses of a file up to the first error.
fn poses_of(path: &Path, file: Take<File>) -> impl Iterator<Item = Result<(String, StampedPose)>> + use<> {
    let (path, mut reader) = (path.to_owned(), BufReader::new(file));
    let mut numbers = 1..;
    let mut next = move || -> Result<Option<(String, StampedPose)>> {
        for number in numbers.by_ref() {
            let Some(line) = read_line(&mut reader, number)? else { break };
            if let Some(pose) = pose_in(&line, number)? {
                return Ok(Some(pose));
            }
        }
        Ok(None)
    };
    let mut ended = false;
    std::iter::from_fn(move || {
        let pose = if ended { None } else { next().map_err(|e| e.in_file(&path)).transpose() };
        ended = !matches!(pose, Some(Ok(_)));
        pose
    })
}

fn stamped(line: &str) -> Result<StampedPose> {
    let wrong = |what: String| Error::invalid(what, "write timestamp tx ty tz qx qy qz qw, separated by spaces");
    let mut numbers = [0.0; 8];
    let mut words = line.split_whitespace();
    for number in &mut numbers {
        let word = words.next().ok_or_else(|| wrong("there are fewer than eight numbers".into()))?;
        let value = word.parse::<f64>().ok().filter(|v| v.is_finite());
        *number = value.ok_or_else(|| wrong(format!("{} is not a finite number", quoted(word))))?;
    }
    if let Some(word) = words.next() {
        return Err(wrong(format!("{} comes after the eighth number", quoted(word))));
    }
    let [time, x, y, z, qx, qy, qz, qw] = numbers;
    let pose = Pose::new(DVec3::new(x, y, z), DQuat::from_xyzw(qx, qy, qz, qw));
    Ok(StampedPose {
        time,
        pose: pose.map_err(|_| wrong("the pose is too far away, or its quaternion has not the length 1".into()))?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_become_poses_and_faults_name_theirs() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tum");
        std::fs::write(&path, "# time x y z q\n\n1.5 1 2 3 0 0 0 0.999\n").unwrap();
        let read_back = read(&path).unwrap();
        assert_eq!(read_back.len(), 1);
        assert_eq!((read_back[0].time, read_back[0].pose.translation), (1.5, DVec3::new(1.0, 2.0, 3.0)));
        assert_eq!(read_back[0].pose.rotation, DQuat::IDENTITY);
        assert_eq!(stream(&path).unwrap().map(Result::unwrap).collect::<Vec<_>>(), read_back);
        for bad in [
            "1 2 3",
            "0 0 0 0 0 0 0 0",
            "0 0 0 0 0 0 0 2",
            "0 0 NaN 0 0 0 0 1",
            "0 0 0 0 0 0 0 1 9",
            "0 0 0 x 0 0 0 1",
            "0 0 0 0 1e200 0 0 1",
            "0 1e300 0 0 0 0 0 1",
        ] {
            std::fs::write(&path, format!("# a\n{bad}\n")).unwrap();
            let e = read(&path).unwrap_err();
            assert!(e.to_string().contains("line 2"), "{e}");
            let mut stream = stream(&path).unwrap();
            assert_eq!(stream.next().unwrap().unwrap_err().to_string(), e.to_string());
            assert!(stream.next().is_none());
        }
    }
}
