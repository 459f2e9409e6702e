//! Points as lines of text.

use super::Cloud;
use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::{limits, memory};

pub fn parse(bytes: &[u8]) -> Result<Cloud> {
    let text = std::str::from_utf8(bytes).map_err(|_| Error::invalid("it is not UTF-8", "save it as UTF-8 text"))?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let lines = || {
        let lines = (1..).zip(text.lines()).map(|(n, line)| (n, line.split('#').next().unwrap_or_default().trim()));
        lines.filter(|(_, line)| !line.is_empty())
    };
    let count = lines().count();
    if count as u64 > limits::MAX_PIXELS {
        return Err(Error::invalid(
            format!("it has {count} points"),
            format!("the limit is {}: give fewer points", limits::MAX_PIXELS),
        ));
    }
    let mut points = memory::reserved(count)?;
    let mut columns = [0, 1, 2];
    for (i, (number, line)) in lines().enumerate() {
        let words: Vec<&str> = line.split(',').map(str::trim).collect();
        if i == 0 && words.iter().any(|w| w.parse::<f64>().is_err()) {
            columns = named(&words).ok_or_else(|| {
                Error::invalid("its first line does not name x, y and z", "name these columns, or give only numbers")
                    .at(format!("line {number}"))
            })?;
            continue;
        }
        let value = |k: usize| words.get(k).and_then(|w| w.parse::<f64>().ok());
        let [Some(x), Some(y), Some(z)] = columns.map(value) else {
            return Err(Error::invalid("this is not a point", "give x,y,z in metres").at(format!("line {number}")));
        };
        points.push(DVec3::new(x, y, z));
    }
    Ok(Cloud { points, size: None, times: None, pose: None })
}

fn named(words: &[&str]) -> Option<[usize; 3]> {
    let column = |name: &str| words.iter().position(|w| w.eq_ignore_ascii_case(name));
    Some([column("x")?, column("y")?, column("z")?])
}
