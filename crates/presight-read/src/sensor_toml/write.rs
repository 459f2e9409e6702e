//! Writing sensor TOML: text that reads back to an equal sensor.

use glam::DQuat;
use presight_model::geometry::Pose;
use presight_model::sensor::{Angles, Camera, Distortion, Geometry, Mixture, Noise, RayTable, Scanner, SensorSpec};

/// Writes a sensor as TOML that [`super::parse`] reads back as an equal sensor.
///
/// Numbers read back with the same bits. The exception is an angle that was never given in degrees: it may read back
/// one ulp off, because neighbouring values in radians can be less than one ulp of a degree apart.
///
/// ```
/// use presight::files::{read_sensor_toml, sensor_to_toml};
/// let radar = presight::preset("microwave-radar-image")?;
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("radar.toml");
/// std::fs::write(&path, sensor_to_toml(radar.spec()))?;
/// assert_eq!(read_sensor_toml(&path)?, *radar.spec());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn to_string(spec: &SensorSpec) -> String {
    let mut out = Writer(String::new());
    out.line("format", "1");
    let kind = match &spec.geometry {
        Geometry::Camera(_) => "camera",
        Geometry::Scanner(_) => "scanner",
        Geometry::Rays(_) => "rays",
    };
    out.line("kind", &quoted(kind));
    out.line("name", &quoted(&spec.name));
    out.line("class", &quoted(&spec.class));
    out.number("range_min", spec.range_min);
    out.number("range_max", spec.range_max);
    if let Some(angle) = spec.max_incidence {
        out.number("max_incidence_deg", degrees(angle));
    }
    if spec.turn_s != 0.0 {
        out.number("turn_s", spec.turn_s);
    }
    match &spec.geometry {
        Geometry::Camera(camera) => out.camera(camera, spec.optical_from_image),
        Geometry::Scanner(scanner) => out.scanner(scanner),
        Geometry::Rays(table) => out.rays(table),
    }
    if spec.mount != Pose::IDENTITY {
        out.table("mount");
        out.list("xyz", &spec.mount.translation.to_array());
        out.list("quaternion", &spec.mount.rotation.to_array());
    }
    if spec.noise != Noise::default() {
        out.table("noise");
        out.number("range_sigma", spec.noise.range_sigma);
        out.number("angle_sigma_deg", degrees(spec.noise.angle_sigma));
        out.number("pixel_sigma", spec.noise.pixel_sigma);
        out.beams(&spec.noise);
    }
    out.0
}

struct Writer(String);

impl Writer {
    fn line(&mut self, key: &str, value: &str) {
        self.0.push_str(key);
        self.0.push_str(" = ");
        self.0.push_str(value);
        self.0.push('\n');
    }

    fn table(&mut self, name: &str) {
        self.0.push_str("\n[");
        self.0.push_str(name);
        self.0.push_str("]\n");
    }

    fn number(&mut self, key: &str, value: f64) {
        self.line(key, &number(value));
    }

    fn list(&mut self, key: &str, values: &[f64]) {
        self.line(key, &list(values));
    }

    fn camera(&mut self, c: &Camera, optical_from_image: DQuat) {
        self.line("width", &c.width.to_string());
        self.line("height", &c.height.to_string());
        for (key, value) in [("fx", c.fx), ("fy", c.fy), ("cx", c.cx), ("cy", c.cy)] {
            self.number(key, value);
        }
        if optical_from_image != DQuat::IDENTITY {
            self.list("optical_from_image", &optical_from_image.to_array());
        }
        if c.distortion != Distortion::None {
            self.table("distortion");
            self.line("model", &quoted(c.distortion.model()));
            self.list("coefficients", c.distortion.coefficients());
        }
    }

    fn scanner(&mut self, s: &Scanner) {
        if let Some(height) = s.beam_height_deg {
            self.number("beam_height_deg", height);
        }
        for (name, angles) in [("azimuth", &s.azimuth), ("elevation", &s.elevation)] {
            self.table(name);
            match angles {
                Angles::Uniform { start_deg, step_deg, count } => {
                    self.number("start_deg", *start_deg);
                    self.number("step_deg", *step_deg);
                    self.line("count", &count.to_string());
                }
                Angles::Listed(listed) => self.list("angles_deg", listed),
            }
        }
    }

    /// Writes the parts of the beam model that differ from the default.
    fn beams(&mut self, noise: &Noise) {
        if noise.range_sigma_quadratic != 0.0 {
            self.number("range_sigma_quadratic", noise.range_sigma_quadratic);
        }
        if noise.stamp_sigma != 0.0 {
            self.number("stamp_sigma_s", noise.stamp_sigma);
        }
        let Mixture { hit, short, none, any, beam_dependence } = noise.mixture;
        if noise.mixture != Mixture::default() {
            let keys = ["p_hit", "p_short", "p_none", "p_any", "beam_dependence"];
            keys.iter().zip([hit, short, none, any, beam_dependence]).for_each(|(key, value)| self.number(key, value));
        }
    }

    fn rays(&mut self, table: &RayTable) {
        self.line("width", &table.width().to_string());
        self.line("height", &table.height().to_string());
        let rows: Vec<String> = table.directions().iter().map(|d| list(&d.to_array())).collect();
        self.line("directions", &format!("[\n{}\n]", rows.join(",\n")));
    }
}

/// Rust's shortest round-trip digits; TOML spells NaN `nan`.
fn number(value: f64) -> String {
    if value.is_nan() { "nan".to_owned() } else { format!("{value:?}") }
}

fn list(values: &[f64]) -> String {
    format!("[{}]", values.iter().map(|v| number(*v)).collect::<Vec<_>>().join(", "))
}

fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

/// The roundest degrees that convert to exactly these radians, or the nearest if none do.
fn degrees(radians: f64) -> f64 {
    let near = radians.to_degrees();
    let round = format!("{near:.12e}").parse().unwrap_or(near);
    let candidates = [round, near, near.next_up(), near.next_down()];
    candidates.into_iter().find(|d| d.to_radians() == radians).unwrap_or(near)
}
