//! Learnt costs as JSON, so that a run can plan its first frames with the costs of the last run.
//!
//! `format` is 1. `models` has one entry for each combination of engine, adapter, number of threads, sensor geometry,
//! outputs and forecast: `seconds` by kind of work ([`WorkCounts::NAMES`]), the sums from which learning continues, and
//! the last ratios of measured to estimated time. Entries for other adapters or numbers of threads are not used. A key
//! does not name the CPU, so keep one file per machine.

use presight_model::error::{Error, Result};
use presight_read::atomic::write_atomically;
use presight_read::text::{FORMAT, check_version, from_text};
use presight_render::cost::{CostModel, Forecast, KINDS, Key, MAX_MODELS, UnitCosts, WorkCounts};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

/// Maximum number of ratios in an entry.
const MAX_RATIOS: usize = 200;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    format: i64,
    models: Vec<Entry>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    engine: String,
    adapter: Option<String>,
    threads: usize,
    geometry: String,
    outputs: String,
    forecast: String,
    frames: u64,
    seconds: BTreeMap<String, f64>,
    normal: Vec<Vec<f64>>,
    right: Vec<f64>,
    ratios: Vec<f64>,
}

/// Reads learnt costs.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] naming place and field: invalid JSON, wrong or repeated keys, NaN, costs
/// below 0; [`presight_model::ErrorKind::Unsupported`] for a newer format.
pub fn read(path: &Path) -> Result<CostModel> {
    from_text(path, parse)
}

/// Reads the text of learnt costs.
///
/// # Errors
/// As [`read`], without the file.
pub fn parse(text: &str) -> Result<CostModel> {
    #[derive(Deserialize)]
    struct Header {
        format: Option<i64>,
    }
    let wrong = |e: serde_json::Error| {
        let place = format!("line {}, column {}", e.line(), e.column());
        Error::invalid(format!("is not a valid file of costs: {e}"), REMEDY).at(place).caused_by(e)
    };
    let header: Header = serde_json::from_str(text).map_err(wrong)?;
    check_version(header.format, FORMAT, "\"format\": 1")?;
    let file: File = serde_json::from_str(text).map_err(wrong)?;
    if file.models.len() > MAX_MODELS {
        return Err(Error::invalid(format!("has {} models, more than {MAX_MODELS}", file.models.len()), REMEDY));
    }
    let mut model = CostModel::default();
    for (i, entry) in file.models.into_iter().enumerate() {
        let at = |e: Error| e.at(format!("models[{i}]"));
        let (key, costs) = entry.check().map_err(at)?;
        if model.models.contains_key(&key) {
            return Err(at(Error::invalid(format!("occurs twice: {key}"), REMEDY)));
        }
        model.models.insert(key, costs);
    }
    Ok(model)
}

const REMEDY: &str = "delete the file: costs are learnt again within about 50 frames";

impl Entry {
    fn check(self) -> Result<(Key, UnitCosts)> {
        let Some(forecast) = Forecast::ALL.into_iter().find(|f| f.name() == self.forecast) else {
            return Err(Error::invalid(format!("{:?} is not a forecast", self.forecast), REMEDY).at("forecast"));
        };
        let mut seconds = [0.0; KINDS];
        for (cost, name) in seconds.iter_mut().zip(WorkCounts::NAMES) {
            let Some(given) = self.seconds.get(name) else {
                return Err(Error::invalid(format!("there is no {name}"), REMEDY).at("seconds"));
            };
            *cost = within(*given, 0.0, 1e9).map_err(|e| e.at(format!("seconds: {name}")))?;
        }
        if let Some(name) = self.seconds.keys().find(|name| !WorkCounts::NAMES.contains(&name.as_str())) {
            return Err(Error::invalid(format!("{name:?} is not a kind of work"), REMEDY).at("seconds"));
        }
        let line = |of: Vec<f64>, place: &str| -> Result<[f64; KINDS]> {
            let many = of.len();
            for x in &of {
                within(*x, 0.0, 1e15).map_err(|e| e.at(place.to_owned()))?;
            }
            of.try_into()
                .map_err(|_| Error::invalid(format!("has {many} numbers, not {KINDS}"), REMEDY).at(place.to_owned()))
        };
        let rows: Vec<[f64; KINDS]> = self.normal.into_iter().map(|row| line(row, "normal")).collect::<Result<_>>()?;
        let many = rows.len();
        let wrong_rows = |_| Error::invalid(format!("has {many} rows, not {KINDS}"), REMEDY).at("normal");
        let normal: [[f64; KINDS]; KINDS] = rows.try_into().map_err(wrong_rows)?;
        let right = line(self.right, "right")?;
        if self.ratios.len() > MAX_RATIOS {
            return Err(Error::invalid(format!("there are more than {MAX_RATIOS}"), REMEDY).at("ratios"));
        }
        for ratio in &self.ratios {
            within(*ratio, 1e-6, 1e6).map_err(|e| e.at("ratios"))?;
        }
        let Self { engine, adapter, threads, geometry, outputs, frames, ratios, .. } = self;
        let key = Key { engine, adapter, threads, geometry, outputs, forecast };
        let ratios = ratios.into();
        Ok((key, UnitCosts { seconds, normal, right, factors: UnitCosts::factors_of(&ratios), ratios, frames }))
    }
}

fn within(x: f64, low: f64, high: f64) -> Result<f64> {
    if x >= low && x <= high { Ok(x) } else { Err(Error::invalid(format!("{x} is not in {low:e}..{high:e}"), REMEDY)) }
}

/// Writes learnt costs atomically.
///
/// ```
/// use presight::predict::CostModel;
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("costs.json");
/// presight::files::write_costs(&path, &CostModel::default())?;
/// assert_eq!(presight::files::read_costs(&path)?, CostModel::default());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`presight_model::ErrorKind::System`] naming the file.
pub fn write(path: &Path, model: &CostModel) -> Result<()> {
    write_atomically(path, |file| file.write_all(to_text(model).as_bytes()))
}

/// The text of learnt costs.
pub fn to_text(model: &CostModel) -> String {
    let entry = |(key, costs): (&Key, &UnitCosts)| Entry {
        engine: key.engine.clone(),
        adapter: key.adapter.clone(),
        threads: key.threads,
        geometry: key.geometry.clone(),
        outputs: key.outputs.clone(),
        forecast: key.forecast.name().to_owned(),
        frames: costs.frames,
        seconds: WorkCounts::NAMES.iter().map(|n| (*n).to_owned()).zip(costs.seconds).collect(),
        normal: costs.normal.iter().map(|row| row.to_vec()).collect(),
        right: costs.right.to_vec(),
        ratios: costs.ratios.iter().copied().collect(),
    };
    let file = File { format: FORMAT, models: model.models.iter().map(entry).collect() };
    // Numbers and strings always serialize.
    serde_json::to_string_pretty(&file).unwrap_or_default() + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::error::ErrorKind;

    fn learnt() -> (CostModel, Key) {
        let key = Key {
            engine: "gpu".into(),
            adapter: Some("llvmpipe".into()),
            threads: 2,
            geometry: "scanner 361 x 1".into(),
            outputs: "range".into(),
            forecast: Forecast::Wave,
        };
        let mut model = CostModel::default();
        for k in 1..300u64 {
            let counts =
                WorkCounts { polygons: k * 7 % 1000, samples_tested: k * k, waves: k % 5, ..WorkCounts::default() };
            model.observe(&key, &counts, 1e-4 + k as f64 * 1e-6).unwrap();
        }
        (model, key)
    }

    /// A saved model continues as if it had never stopped: the same counts and times give the same bits.
    #[test]
    fn learning_goes_on_where_it_was() {
        let (mut model, key) = learnt();
        let mut again = parse(&to_text(&model)).unwrap();
        assert_eq!(again, model);
        let counts = WorkCounts { polygons: 321, waves: 3, ..WorkCounts::default() };
        model.observe(&key, &counts, 3e-3).unwrap();
        again.observe(&key, &counts, 3e-3).unwrap();
        assert_eq!(again.estimate(&key, &counts), model.estimate(&key, &counts));
    }

    #[test]
    fn faults_are_named() {
        let good = to_text(&learnt().0);
        let polygon = good.lines().find(|l| l.contains("\"polygon\"")).unwrap().trim().to_owned();
        for (from, to, named, kind) in [
            ("\"format\": 1", "\"format\": 2", "newer", ErrorKind::Unsupported),
            ("\"format\": 1", "\"format\": 0", "never existed", ErrorKind::Invalid),
            ("\"format\": 1", "\"form\": 1", "name its format", ErrorKind::Invalid),
            (&polygon, "\"polygon\": -1e-9,", "seconds: polygon", ErrorKind::Invalid),
            (&polygon, "\"polygon\": NaN,", "line", ErrorKind::Invalid),
            (&polygon, "\"polygon\": null,", "line", ErrorKind::Invalid),
            (&polygon, "\"polygon\": 1e400,", "line", ErrorKind::Invalid),
            (&polygon, "", "there is no polygon", ErrorKind::Invalid),
            (&polygon, "\"polygon\": 1e-7, \"quad\": 1e-7,", "not a kind of work", ErrorKind::Invalid),
            ("\"wave\",\n", "\"wafe\",\n", "not a forecast", ErrorKind::Invalid),
            ("\"right\": [", "\"right\": [1.0,", "11 numbers", ErrorKind::Invalid),
            ("\"ratios\": [", "\"ratios\": [-1.0,", "ratios", ErrorKind::Invalid),
            ("{", "", "line 2", ErrorKind::Invalid),
        ] {
            let text = good.replacen(from, to, 1);
            assert_ne!(text, good, "{from}");
            let e = parse(&text).expect_err(to);
            assert!(e.to_string().contains(named), "{to}: {e}");
            assert_eq!(e.kind(), kind, "{to}: {e}");
            assert!(!e.to_string().contains('\n'));
        }
    }

    #[test]
    fn a_key_twice_is_an_error() {
        let (model, _) = learnt();
        let text = to_text(&model);
        let (start, end) = (text.find('[').unwrap() + 1, text.rfind(']').unwrap());
        let twice = format!("{}{},{}{}", &text[..start], &text[start..end], &text[start..end], &text[end..]);
        assert!(parse(&twice).unwrap_err().to_string().contains("twice"));
    }
}
