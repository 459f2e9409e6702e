//! `presight env info`, `check` and `log`.

use super::stale::Stale;
use crate::print;
use presight::environment::{Environment, Mark, Object};
use presight::features::Existence;
use presight::files;
use presight::store;
use presight::store::LogEntry;
use presight::tools::clipped;
use presight::{Error, Result};
use serde_json::{Value, json};
use std::path::Path;

/// Format version of the JSON of `info`.
const FORMAT: u32 = 1;

/// Objects that are not deleted.
pub fn live(environment: &Environment) -> impl Iterator<Item = &Object> {
    environment.objects().iter().filter(|o| !o.is_deleted())
}

/// `presight env info`.
pub fn info(path: &Path, as_json: bool, stale: Option<&Stale>) -> Result<()> {
    let info = store::info(path)?;
    let environment = &info.environment;
    let groups = environment.groups();
    let layer = |l: &presight::features::FeatureLayer| json!({"class": l.class, "features": l.features.len()});
    let stale = stale.map(|stale| stale.of(environment));
    let mut value = json!({
        "format": FORMAT,
        "store": path.display().to_string(),
        "created": info.created,
        "cause": info.cause,
        "changes": info.changes,
        "head": info.head,
        "content_hash": environment.content_hash().to_string(),
        "objects": live(environment).map(|o| &o.name).collect::<Vec<_>>(),
        "groups": groups.keys().collect::<Vec<_>>(),
        "polygons": live(environment).map(|o| o.mesh.polygon_count()).sum::<usize>(),
        "materials": environment.materials().iter().map(|m| &m.name).collect::<Vec<_>>(),
        "layers": environment.layers().iter().map(layer).collect::<Vec<_>>(),
        "marks": environment.marks().map(|(name, m)| mark(name, m)).collect::<Vec<_>>(),
        "trust": environment.trusts().map(|(object, t)| trust(object, t)).collect::<Vec<_>>(),
    });
    if let Some(stale) = &stale {
        value["stale"] = stale.iter().map(|(what, since)| json!({"what": what, "confirmed": since})).collect();
    }
    if as_json {
        return print::data(&(pretty(&value, path)? + "\n"));
    }
    let mut lines = vec![path.display().to_string()];
    lines.push(format!("created    {} ({})", utc(info.created), info.cause));
    lines.push(format!("changes    {}, head {}", info.changes, info.head));
    lines.push(format!("content    {}", environment.content_hash()));
    lines.push(format!("objects    {} of {} polygons", live(environment).count(), value["polygons"]));
    lines.push(format!("groups     {}", groups.len()));
    lines.extend(environment.layers().iter().map(|l| format!("layer      {}: {} features", l.class, l.features.len())));
    let name = |(name, m): (&str, &Mark)| format!("mark       {name}: {} {}", m.kind.name(), m.object);
    lines.extend(environment.marks().map(name));
    let since = |time: &Option<f64>| time.map_or("never confirmed".to_owned(), |t| format!("confirmed {}", utc(t)));
    lines.extend(stale.iter().flatten().map(|(what, time)| format!("stale      {what}: {}", since(time))));
    lines.push(String::new());
    lines.extend(live(environment).map(|o| format!("  {}", o.name)));
    print::lines(lines)
}

fn mark(name: &str, mark: &Mark) -> Value {
    let bounds = mark.bounds.map(|b| [b.min.to_array(), b.max.to_array()]);
    json!({"mark": name, "object": mark.object, "kind": mark.kind.name(), "class": mark.class, "box": bounds})
}

fn trust(object: &str, trust: &Existence) -> Value {
    json!({"object": object, "existence": trust.p0, "confirmed": trust.confirmed, "rate": trust.rate})
}

/// `presight env check`.
pub fn check(path: &Path) -> Result<()> {
    let info = store::check(path)?;
    print::data(&format!("sound: {} objects, {} changes\n", live(&info.environment).count(), info.changes))?;
    match files::problem_of_lost_features(&info.environment)? {
        Some(problem) => print::lines(problem.lines("    ")),
        None => Ok(()),
    }
}

/// `presight env log`.
pub fn log(path: &Path, as_json: bool) -> Result<()> {
    let mut lines = Vec::new();
    store::log(path, |entry| {
        lines.push(if as_json { json_line(&entry, path)? } else { line(&entry) });
        Ok(())
    })?;
    if as_json {
        print::data(&lines.iter().map(|line| format!("{line}\n")).collect::<String>())
    } else {
        print::lines(lines)
    }
}

fn line(e: &LogEntry) -> String {
    /// The length at which causes, ids and changes are cut, in characters.
    const WIDTH: usize = 160;
    let undoes = e.undoes.map(|n| format!(" (undoes {n})")).unwrap_or_default();
    let id = e.id.as_ref().map(|id| format!(" [{}]", clipped(id, WIDTH))).unwrap_or_default();
    let (cause, change) = (clipped(&e.cause, WIDTH), clipped(&e.change, WIDTH));
    format!("{:>6}  {}  {cause}{id}{undoes}: {change}", e.number, utc(e.time))
}

fn json_line(e: &LogEntry, path: &Path) -> Result<String> {
    let parse = |text: &str| {
        serde_json::from_str::<Value>(text).map_err(|e| Error::invalid(e.to_string(), "").in_file(path).caused_by(e))
    };
    let value = json!({
        "number": e.number,
        "time": e.time,
        "cause": e.cause,
        "id": e.id,
        "undoes": e.undoes,
        "change": parse(&e.change)?,
        "inverse": parse(&e.inverse)?,
        "evidence": e.evidence.as_deref().map(parse).transpose()?,
        "hash": presight::environment::ContentHash(e.hash).to_string(),
    });
    Ok(value.to_string())
}

fn pretty(value: &Value, path: &Path) -> Result<String> {
    serde_json::to_string_pretty(value).map_err(|e| Error::invalid(format!("not valid JSON: {e}"), "").in_file(path))
}

/// Formats UTC seconds as an ISO 8601 date and time (Gregorian calendar) with milliseconds.
fn utc(time: f64) -> String {
    let millis = (time * 1e3).round();
    if !(millis.abs() < 2e14) {
        return format!("{time} s");
    }
    let millis = millis as i64;
    let (days, rest) = (millis.div_euclid(86_400_000), millis.rem_euclid(86_400_000));
    // Convert days since 1970 to a date, with years that begin in March and eras of 400 years.
    let shifted = days + 719_468;
    let (era, day_of_era) = (shifted.div_euclid(146_097), shifted.rem_euclid(146_097));
    let year_of_era = (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted_month + 2) / 5 + 1;
    let month = if shifted_month < 10 { shifted_month + 3 } else { shifted_month - 9 };
    let year = era * 400 + year_of_era + i64::from(month <= 2);
    let (h, m, s) = (rest / 3_600_000, rest / 60_000 % 60, rest % 60_000);
    format!("{year:04}-{month:02}-{day:02}T{h:02}:{m:02}:{:02}.{:03}Z", s / 1000, s % 1000)
}

#[cfg(test)]
mod tests {
    use super::utc;

    #[test]
    fn times_are_dates() {
        assert_eq!(utc(0.0), "1970-01-01T00:00:00.000Z");
        assert_eq!(utc(951_782_400.25), "2000-02-29T00:00:00.250Z");
        assert_eq!(utc(-1.0), "1969-12-31T23:59:59.000Z");
        assert_eq!(utc(2e15), "2000000000000000 s");
    }
}
