//! PCD (R. B. Rusu, Point Cloud Library).

use super::records::{Encoding, Number, Records};
use super::{Cloud, POINTS_IN_WORLD, header, whole};
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::printable::quoted;

/// Maximum count of numbers in one point.
const MAX_NUMBERS: usize = 1 << 12;

pub fn parse(bytes: &[u8]) -> Result<Cloud> {
    let (lines, body) = header(bytes, "DATA")?;
    let (mut names, mut sizes, mut kinds, mut counts) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut width, mut height, mut points) = (None, 1, None);
    let (mut viewpoint, mut encoding, mut in_world) = (None, Encoding::Text, false);
    for (i, line) in lines.iter().enumerate() {
        let at = |e: Error| e.at(format!("line {}", i + 1));
        in_world |= line.starts_with('#') && line.ends_with(POINTS_IN_WORLD);
        let words: Vec<&str> = line.split_whitespace().collect();
        let Some((key, values)) = words.split_first() else { continue };
        let one = || values.first().copied().unwrap_or_default();
        match *key {
            "FIELDS" => names = values.iter().map(|v| (*v).to_owned()).collect(),
            "SIZE" => sizes = values.to_vec(),
            "TYPE" => kinds = values.to_vec(),
            "COUNT" => counts = values.to_vec(),
            "WIDTH" => width = Some(whole(one(), "WIDTH").map_err(at)?),
            "HEIGHT" => height = whole(one(), "HEIGHT").map_err(at)?,
            "POINTS" => points = Some(whole(one(), "POINTS").map_err(at)?),
            "VIEWPOINT" => viewpoint = Some(pose(values).map_err(at)?),
            "DATA" => encoding = encoding_of(one()).map_err(at)?,
            _ => {}
        }
    }
    let numbers = numbers(&names, &sizes, &kinds, &counts)?;
    let width = width.ok_or_else(|| Error::invalid("its header has no WIDTH", "give a PCD file"))?;
    let count = width.checked_mul(height).filter(|n| points.is_none_or(|p| p == *n));
    let Some(count) = count else {
        let what = format!("{width} x {height} points are not POINTS {}", points.unwrap_or_default());
        return Err(Error::invalid(what, "give a PCD file"));
    };
    if in_world {
        let remedy = "write points in the sensor's frame";
        return Err(Error::invalid("its points are in the world, and the sensor's pose is missing", remedy));
    }
    let (points, times) = Records { encoding, count, numbers }.points(body)?;
    // Writers put the identity if they do not know the pose.
    let pose = viewpoint.filter(|pose| *pose != Pose::IDENTITY).map(SensorPose::new);
    Ok(Cloud { points, size: (height > 1).then_some((width as u32, height as u32)), times, pose })
}

fn numbers(names: &[String], sizes: &[&str], kinds: &[&str], counts: &[&str]) -> Result<Vec<(String, Number)>> {
    if names.len() != sizes.len() || names.len() != kinds.len() || !(counts.is_empty() || counts.len() == names.len()) {
        return Err(Error::invalid("FIELDS, SIZE, TYPE and COUNT differ in length", "give a PCD file"));
    }
    let mut numbers = Vec::new();
    for (i, name) in names.iter().enumerate() {
        let size = whole(sizes[i], "SIZE")?;
        let number = match (kinds[i], size) {
            ("I", 1 | 2 | 4 | 8) => Number::Signed(size),
            ("U", 1 | 2 | 4 | 8) => Number::Unsigned(size),
            ("F", 4 | 8) => Number::Float(size),
            (kind, _) => {
                return Err(Error::invalid(
                    format!("a field of TYPE {} and SIZE {size}", quoted(kind)),
                    "give a PCD file",
                ));
            }
        };
        let count = counts.get(i).map_or(Ok(1), |c| whole(c, "COUNT"))?;
        if count > MAX_NUMBERS - numbers.len().min(MAX_NUMBERS) {
            return Err(Error::invalid(format!("its points have over {MAX_NUMBERS} numbers"), "give a PCD file"));
        }
        (0..count).for_each(|_| numbers.push((name.clone(), number)));
    }
    Ok(numbers)
}

fn encoding_of(name: &str) -> Result<Encoding> {
    match name {
        "ascii" => Ok(Encoding::Text),
        "binary" => Ok(Encoding::Little),
        "binary_compressed" => Err(Error::new(
            ErrorKind::Unsupported,
            "its points are compressed",
            "write DATA binary (pcl_convert_pcd_ascii_binary)",
        )),
        other => Err(Error::invalid(format!("DATA is {}", quoted(other)), "give a PCD file")),
    }
}

/// Parses x y z, then the rotation as w x y z.
fn pose(values: &[&str]) -> Result<Pose> {
    let wrong = || Error::invalid("VIEWPOINT is not a valid pose", "give x y z qw qx qy qz");
    let numbers: Vec<f64> = values.iter().filter_map(|v| v.parse().ok()).collect();
    let [x, y, z, qw, qx, qy, qz] = numbers[..] else { return Err(wrong()) };
    Pose::of_numbers(&[x, y, z, qx, qy, qz, qw]).map_err(|_| wrong())
}
