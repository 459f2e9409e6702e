//! A sensor's image as a projection of its body frame, with closed-form derivatives where possible.

use crate::columns;
use crate::roi::Projection;
use glam::{DMat3, DVec3};
use presight_model::sensor::{Angles, Distortion, Geometry, Sensor};

/// The projection of a sensor.
pub struct Image<'a> {
    pub sensor: &'a Sensor,
    pub image_from_body: DMat3,
    pub kind: Kind,
}

/// Properties of a projection that give derivatives and singularities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Straight lines stay straight. Holds the focal lengths, pixels.
    Pinhole([f64; 2]),
    /// Columns and rows are linear in azimuth and elevation. Holds columns and rows per radian.
    Beams([f64; 2]),
    /// Singular in the plane of the camera's centre.
    Lens,
    /// Singular on the scanner's axis; beams at arbitrary angles.
    Scanner,
    /// Singular only in the centre.
    Around,
}

impl<'a> Image<'a> {
    pub fn of(sensor: &'a Sensor) -> Self {
        let kind = match &sensor.spec().geometry {
            Geometry::Camera(camera) => match camera.distortion {
                Distortion::None => Kind::Pinhole([camera.fx, camera.fy]),
                Distortion::Equidistant(_) => Kind::Around,
                _ => Kind::Lens,
            },
            Geometry::Scanner(scanner) => {
                let uniform = |angles: &Angles| matches!(angles, Angles::Uniform { .. });
                let even = uniform(&scanner.azimuth) && (scanner.elevation.len() == 1 || uniform(&scanner.elevation));
                by_radian(sensor).filter(|_| even).map_or(Kind::Scanner, Kind::Beams)
            }
            Geometry::Rays(_) => Kind::Around,
        };
        Self { sensor, image_from_body: sensor.body_from_image().transpose(), kind }
    }

    /// Returns the share of the segment between two points (body frame) at which a scanner sees it highest or lowest,
    /// if that is between the ends.
    pub fn culmination_share(&self, from: DVec3, to: DVec3) -> Option<f64> {
        if !matches!(self.kind, Kind::Beams(_) | Kind::Scanner) {
            return None;
        }
        columns::culmination_share(self.image_from_body * from, self.image_from_body * to)
    }
}

/// Columns and rows per radian, if constant. They are measured, because single beams have their own height.
fn by_radian(sensor: &Sensor) -> Option<[f64; 2]> {
    let spec = sensor.spec();
    let Geometry::Scanner(scanner) = &spec.geometry else { return None };
    let (n, first) = (scanner.azimuth.len(), scanner.azimuth.degrees(0));
    let azimuth = 0.5 * (first + scanner.azimuth.degrees(n - 1)).to_radians();
    let step = 1e-3;
    let at = |azimuth: f64, elevation: f64| {
        let ((sa, ca), (se, ce)) = (azimuth.sin_cos(), elevation.sin_cos());
        sensor.project(DVec3::new(ce * ca, ce * sa, se))
    };
    let (low, high) = (at(azimuth - step, -step)?, at(azimuth + step, step)?);
    Some([(high.0 - low.0) / (2.0 * step), (high.1 - low.1) / (2.0 * step)])
}

impl Projection for Image<'_> {
    fn project(&self, p_in_body: DVec3) -> Option<[f64; 2]> {
        self.sensor.project(self.image_from_body * p_in_body).map(|(u, v)| [u, v])
    }

    fn lever(&self, p_in_body: DVec3) -> f64 {
        let p = self.image_from_body * p_in_body;
        match self.kind {
            Kind::Pinhole(_) | Kind::Lens => p.z,
            Kind::Beams(_) | Kind::Scanner => p.x.hypot(p.y),
            Kind::Around => p.length(),
        }
    }

    fn clearance(&self, p_in_body: DVec3) -> f64 {
        match self.kind {
            Kind::Pinhole(_) | Kind::Lens => (self.image_from_body * p_in_body).z,
            Kind::Beams(_) | Kind::Scanner | Kind::Around => p_in_body.length(),
        }
    }

    fn size(&self) -> (u32, u32) {
        (self.sensor.width(), self.sensor.height())
    }

    fn turn(&self) -> Option<f64> {
        self.sensor.columns_of_a_turn()
    }

    fn pole_near(&self, row: f64) -> Option<f64> {
        let row_of = |direction: DVec3| self.sensor.project(direction).map(|(_, row)| row);
        let near = |up: DVec3| {
            let (pole, half_way) = (row_of(up)?, row_of(up + DVec3::X)?);
            let is_near = if pole < half_way { row < half_way } else { row > half_way };
            is_near.then_some(pole)
        };
        match self.kind {
            Kind::Beams(_) | Kind::Scanner => near(DVec3::Z).or_else(|| near(DVec3::NEG_Z)),
            _ => None,
        }
    }

    fn culmination(&self, from: DVec3, to: DVec3) -> Option<DVec3> {
        self.culmination_share(from, to).map(|t| from.lerp(to, t))
    }

    fn gradient(&self, p_in_body: DVec3, at: [f64; 2]) -> Option<[DVec3; 2]> {
        let p = self.image_from_body * p_in_body;
        let body_from_image = self.image_from_body.transpose();
        let [column, row] = match self.kind {
            Kind::Pinhole([fx, fy]) => {
                let inverse = p.z.recip();
                let (x, y) = (fx * inverse, fy * inverse);
                [DVec3::new(x, 0.0, -x * p.x * inverse), DVec3::new(0.0, y, -y * p.y * inverse)]
            }
            Kind::Beams([columns, rows]) => {
                let flat = p.x * p.x + p.y * p.y;
                let (inverse, length) = (flat.recip(), flat.sqrt());
                let up = rows / (flat + p.z * p.z);
                let lean = -p.z / length;
                [columns * inverse * DVec3::new(-p.y, p.x, 0.0), up * DVec3::new(lean * p.x, lean * p.y, length)]
            }
            _ => return crate::roi::differences(self, p_in_body, at),
        };
        let gradient = [body_from_image * column, body_from_image * row];
        gradient.iter().all(|g| g.is_finite()).then_some(gradient)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::sensor::PRESETS;
    use presight_read::preset;

    #[test]
    fn derivatives_are_those_of_the_projection() {
        let mut closed = 0;
        for name in PRESETS.iter().map(|p| p.name) {
            let sensor = preset(name).unwrap();
            let image = Image::of(&sensor);
            closed += usize::from(matches!(image.kind, Kind::Pinhole(_) | Kind::Beams(_)));
            for p in [DVec3::new(3.0, 0.4, -0.2), DVec3::new(2.0, -0.9, 0.3), DVec3::new(40.0, 1.0, 4.0)] {
                let at = image.project(p).unwrap();
                let (got, expected) = (image.gradient(p, at).unwrap(), crate::roi::differences(&image, p, at).unwrap());
                for k in 0..2 {
                    let off = (got[k] - expected[k]).length();
                    assert!(off <= 1e-6 * expected[k].length(), "{name} {p}: {} and {}", got[k], expected[k]);
                }
            }
        }
        assert!(closed >= 4);
    }
}
