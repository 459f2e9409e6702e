//! The selection of a path by a user: flags of `presight predict`, keys of the sensor file, or library calls.

use super::path::{EnginePath, Path};
use super::views::ImageVariant;
use presight_features::{BoxMethod, STEP, Visibility};
use presight_model::sensor::{Angles, Geometry, Scanner, Sensor};

/// Settings of a path to images: flags of `presight predict` first, then the others after a semicolon.
pub(super) fn of_image(path: &Path, sensor: &Sensor) -> String {
    let engine = match path.which {
        EnginePath::Reference => "library: reference::render",
        EnginePath::CpuOne => "--backend cpu --threads 1",
        EnginePath::CpuAll => "--backend cpu",
        EnginePath::Gpu => "--backend gpu",
        EnginePath::GpuNarrow => {
            "library: gpu::DeviceOptions::without_int64 (automatic on devices without 64-bit atomics)"
        }
    };
    let index = path.index.map(|s| format!(" --index {}", s.name())).unwrap_or_default();
    format!("{engine}{index}{}", of_view(path.view, sensor))
}

/// Changes to the sensor file that give exactly the measured geometry.
fn of_view(view: ImageVariant, sensor: &Sensor) -> String {
    match view {
        ImageVariant::Whole => return String::new(),
        ImageVariant::Rays => return "; sensor file: kind = \"rays\" with the directions of all pixels".into(),
        ImageVariant::Reduced(_) | ImageVariant::Region => {}
    }
    // A path is not measured if its sensor has no such view.
    let Ok(Some(seen)) = view.of(sensor) else { return String::new() };
    match (view, &sensor.spec().geometry, &seen.sensor.spec().geometry) {
        (_, _, Geometry::Camera(c)) => format!(
            "; sensor file: width = {}, height = {}, fx = {:?}, fy = {:?}, cx = {:?}, cy = {:?}",
            c.width, c.height, c.fx, c.fy, c.cx, c.cy
        ),
        (_, Geometry::Scanner(old), Geometry::Scanner(new)) => format!("; sensor file: {}", of_scanner(old, new)),
        (ImageVariant::Reduced(n), _, Geometry::Rays(new)) => format!(
            "; sensor file: width = {}, height = {}, directions of columns and rows {}, {}, .. from 0 on, of the last \
             beyond it",
            new.width(),
            new.height(),
            n / 2,
            n / 2 + n
        ),
        _ => String::new(),
    }
}

/// The keys that differ.
fn of_scanner(old: &Scanner, new: &Scanner) -> String {
    let mut keys = Vec::new();
    if let Some(height) = new.beam_height_deg.filter(|_| new.beam_height_deg != old.beam_height_deg) {
        keys.push(format!("beam_height_deg = {height:?}"));
    }
    for (table, old, new) in [("azimuth", &old.azimuth, &new.azimuth), ("elevation", &old.elevation, &new.elevation)] {
        if let Angles::Uniform { start_deg, step_deg, count } = new
            && old != new
        {
            keys.push(format!("[{table}] start_deg = {start_deg:?}, step_deg = {step_deg:?}, count = {count}"));
        }
    }
    keys.join(", ")
}

/// Settings of a path to features.
pub(super) fn of_features(
    which: EnginePath,
    visibility: Visibility,
    step: f64,
    view: ImageVariant,
    sensor: &Sensor,
) -> String {
    let engine = if which == EnginePath::Gpu { "--backend gpu" } else { "--backend cpu" };
    let mut options = Vec::new();
    if visibility == Visibility::Rays {
        options.push("FeatureSettings::visibility = Visibility::Rays".to_owned());
    }
    if step != STEP {
        options.push(format!("FeatureSettings::step = {step}"));
    }
    match options.is_empty() {
        true => format!("{engine}{}", of_view(view, sensor)),
        false => format!("library: {}", options.join(", ")),
    }
}

/// Settings of a path to regions of interest.
pub(super) fn of_regions(which: EnginePath, method: BoxMethod) -> String {
    match (which, method) {
        (_, BoxMethod::Linear) => "library: BoxOptions::method = BoxMethod::Linear".into(),
        (_, BoxMethod::Set) => "library: BoxOptions::method = BoxMethod::Set".into(),
        (EnginePath::Gpu, BoxMethod::AsNeeded) => "--backend gpu".into(),
        (_, BoxMethod::AsNeeded) => "--backend cpu".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_read::sensor_toml;

    const CAMERA: &str = "width = 61\nheight = 48\nfx = 40.0\nfy = 41.0\ncx = 31.5\ncy = 23.25\n";
    const TURN: &str = "[azimuth]\nstart_deg = -180.0\nstep_deg = 0.3\ncount = 1200\n";
    const ROWS: &str = "[elevation]\nstart_deg = 15.0\nstep_deg = -2.0\ncount = 16\n";
    const ROW: &str = "[elevation]\nstart_deg = 0.0\nstep_deg = 1.0\ncount = 1\n";
    const LISTED: &str = "[elevation]\nangles_deg = [3.0, 1.0, 0.0, -4.0]\n";

    fn sensor(kind: &str, keys: &str) -> Sensor {
        let text = format!("format = 1\nkind = \"{kind}\"\nclass = \"laser\"\n{keys}");
        Sensor::new(sensor_toml::parse(&text, "s", None).unwrap_or_else(|e| panic!("{e}: {text}"))).unwrap()
    }

    /// Replaces keys of a file by those of a recipe.
    fn changed(keys: &str, recipe: &str) -> String {
        let recipe = recipe.strip_prefix("; sensor file: ").unwrap().replace("] ", "]\n").replace(", ", "\n");
        let mut all: toml::Table = keys.parse().unwrap();
        for (key, value) in recipe.parse::<toml::Table>().unwrap() {
            match (all.get_mut(&key), value) {
                (Some(toml::Value::Table(table)), toml::Value::Table(new)) => table.extend(new),
                (_, value) => drop(all.insert(key, value)),
            }
        }
        toml::to_string(&all).unwrap()
    }

    /// The recipes give exactly the measured sensor.
    #[test]
    fn recipes_give_what_was_measured() {
        let tall = format!("beam_height_deg = 0.5\n{TURN}{ROWS}");
        for (kind, keys) in [
            ("camera", CAMERA.to_owned()),
            ("scanner", format!("{TURN}{ROWS}")),
            ("scanner", format!("{TURN}{ROW}")),
            ("scanner", format!("{TURN}{LISTED}")),
            ("scanner", tall),
        ] {
            let whole = sensor(kind, &keys);
            for view in [ImageVariant::Reduced(2), ImageVariant::Reduced(4), ImageVariant::Region] {
                let recipe = of_view(view, &whole);
                let taken = sensor(kind, &changed(&keys, &recipe));
                let measured = view.of(&whole).unwrap().unwrap().sensor;
                assert_eq!(taken.spec().geometry, measured.spec().geometry, "{view:?}: {recipe}");
            }
        }
        // Recipes include the height of beams, and omit rows that do not change.
        let rows = of_view(ImageVariant::Reduced(2), &sensor("scanner", &format!("{TURN}{ROWS}")));
        assert!(rows.contains("beam_height_deg = 2.0") && rows.contains("[elevation]"), "{rows}");
        assert!(
            !of_view(ImageVariant::Reduced(2), &sensor("scanner", &format!("{TURN}{LISTED}"))).contains("elevation")
        );
    }
}
