//! PLY (G. Turk, 1994).

use super::records::{Encoding, Number, Records};
use super::{Cloud, POINTS_IN_WORLD, header, whole};
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::printable::quoted;

pub fn parse(bytes: &[u8]) -> Result<Cloud> {
    if !bytes.starts_with(b"ply") {
        return Err(Error::invalid("it does not begin with ply", "give a PLY file"));
    }
    let (lines, body) = header(bytes, "end_header")?;
    let mut records = Records { encoding: Encoding::Text, count: 0, numbers: Vec::new() };
    let (mut format, mut elements) = (None, 0);
    let (mut pose, mut in_world) = (None, false);
    for (i, line) in lines.iter().enumerate().skip(1) {
        let at = |e: Error| e.at(format!("line {}", i + 1));
        match line.split_whitespace().collect::<Vec<_>>()[..] {
            ["format", name, "1.0"] => format = Some(encoding(name).map_err(at)?),
            ["comment", "world_from_sensor", _, numbers] => {
                pose = Some(crate::exr::pose_from_text(numbers).map_err(at)?);
            }
            ["comment", ..] => in_world |= line.ends_with(POINTS_IN_WORLD),
            ["element", name, count] => {
                elements += 1;
                if elements == 1 && name != "vertex" {
                    let what = format!("its first element is {}", quoted(name));
                    return Err(at(Error::new(ErrorKind::Unsupported, what, "write vertex first")));
                }
                if elements == 1 {
                    records.count = whole(count, "the number of its points").map_err(at)?;
                }
            }
            ["property", "list", ..] if elements == 1 => {
                let what = "its points have lists";
                return Err(at(Error::new(ErrorKind::Unsupported, what, "write points of single numbers")));
            }
            ["property", kind, name] if elements == 1 => {
                records.numbers.push((name.to_owned(), number(kind).map_err(at)?));
            }
            _ => {}
        }
    }
    records.encoding = format.ok_or_else(|| Error::invalid("its header has no format 1.0", "give a PLY file"))?;
    let (mut points, times) = records.points(body)?;
    if in_world {
        let world_from_sensor: Pose = pose.ok_or_else(|| {
            Error::invalid(
                "its points are in the world, and the sensor's pose is missing",
                "give points in the sensor's frame",
            )
        })?;
        let sensor_from_world = world_from_sensor.inverse();
        points.iter_mut().for_each(|p| *p = sensor_from_world.transform_point(*p));
    }
    Ok(Cloud { points, size: None, times, pose: pose.map(SensorPose::new) })
}

fn encoding(name: &str) -> Result<Encoding> {
    match name {
        "ascii" => Ok(Encoding::Text),
        "binary_little_endian" => Ok(Encoding::Little),
        "binary_big_endian" => Ok(Encoding::Big),
        other => Err(Error::invalid(format!("its format is {}", quoted(other)), "give a PLY file")),
    }
}

fn number(kind: &str) -> Result<Number> {
    Ok(match kind {
        "char" | "int8" => Number::Signed(1),
        "uchar" | "uint8" => Number::Unsigned(1),
        "short" | "int16" => Number::Signed(2),
        "ushort" | "uint16" => Number::Unsigned(2),
        "int" | "int32" => Number::Signed(4),
        "uint" | "uint32" => Number::Unsigned(4),
        "float" | "float32" => Number::Float(4),
        "double" | "float64" => Number::Float(8),
        other => return Err(Error::invalid(format!("a property of type {}", quoted(other)), "give a PLY file")),
    })
}
