//! Column and row intervals of polygons in a scanner's image, including across the seam.

use glam::DVec3;
use presight_model::sensor::{Angles, Geometry, Scanner, Sensor};

/// An edge passes too near the axis to decide on which side if its distance from there is a smaller part of its length:
/// it then turns by more than 99.9 % of half a turn.
const HALF: f64 = 1e-3 * std::f64::consts::PI;
/// Rounding may reverse the apparent direction of an edge that turns by less, radians.
const SLIGHTLY: f64 = 1e-3;

/// Column interval of the image of a convex polygon, unwrapped: the lower end is in the first turn, and the upper end
/// may exceed the width. Returns `None` if the polygon surrounds the axis, or if uneven columns do not go fully round.
pub(super) fn of_corners(sensor: &Sensor, corners: &[DVec3]) -> Option<[f64; 2]> {
    let turn = turn(sensor)?;
    let mut from = corners.first()?.truncate();
    let first = sensor.project(*corners.first()?)?.0;
    let Geometry::Scanner(Scanner { azimuth, .. }) = &sensor.spec().geometry else { return None };
    let is_left = match azimuth {
        Angles::Uniform { step_deg, .. } => *step_deg > 0.0,
        Angles::Listed(angles) => angles.last() > angles.first(),
    };
    // Azimuth is monotonic along an edge and spans less than half a turn.
    let (mut column, mut low, mut high) = (first, first, first);
    for corner in corners.iter().cycle().skip(1).take(corners.len()) {
        let to = corner.truncate();
        let (across, along) = (from.perp_dot(to), from.dot(to));
        if across.abs() <= -HALF * along {
            return None;
        }
        from = to;
        let by = sensor.project(*corner)?.0 - column;
        column += if across.abs() < SLIGHTLY * along {
            by - turn * (by / turn).round()
        } else if (across > 0.0) == is_left {
            by.rem_euclid(turn)
        } else {
            -(-by).rem_euclid(turn)
        };
        (low, high) = (low.min(column), high.max(column));
    }
    if (column - first).abs() > 0.5 * turn || high - low >= turn {
        return None;
    }
    let back = turn * ((low + 0.5) / turn).floor();
    Some([low - back, high - back])
}

/// Returns the share of the segment from `a` to `b` (image frame) at which a scanner sees it highest or lowest, if that
/// is between the ends. There the ratio of height to distance from the axis is stationary.
pub(super) fn culmination_share(a: DVec3, b: DVec3) -> Option<f64> {
    let d = b - a;
    let (aa, ad, dd) = (a.x * a.x + a.y * a.y, a.x * d.x + a.y * d.y, d.x * d.x + d.y * d.y);
    let t = (d.z * aa - a.z * ad) / (a.z * dd - d.z * ad);
    (t > 0.0 && t < 1.0).then_some(t)
}

/// First and last row of the outline of a polygon.
pub(super) fn rows_of_outline(sensor: &Sensor, corners: &[DVec3]) -> Option<[f64; 2]> {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for (k, a) in corners.iter().enumerate() {
        let b = corners[(k + 1) % corners.len()];
        let highest = culmination_share(*a, b).map(|t| a.lerp(b, t));
        for at in [*a].into_iter().chain(highest) {
            let row = sensor.project(at)?.1;
            (low, high) = (low.min(row), high.max(row));
        }
    }
    Some([low, high])
}

/// Number of columns for 360 degrees, even if the image has fewer.
pub fn turn(sensor: &Sensor) -> Option<f64> {
    match &sensor.spec().geometry {
        Geometry::Scanner(Scanner { azimuth: Angles::Uniform { step_deg, .. }, .. }) if *step_deg != 0.0 => {
            Some(360.0 / step_deg.abs())
        }
        _ => sensor.columns_of_a_turn(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;
    use presight_model::sensor::SensorSpec;
    use presight_read::preset;

    fn scanner(start_deg: f64, step_deg: f64) -> Sensor {
        let azimuth = Angles::Uniform { start_deg, step_deg, count: 360 };
        let elevation = Angles::Uniform { start_deg: -40.0, step_deg: 1.0, count: 81 };
        let scanner = Scanner { azimuth, elevation, beam_height_deg: None };
        Sensor::new(SensorSpec::new("scanner", "laser", Geometry::Scanner(scanner))).unwrap()
    }

    #[test]
    fn columns_go_on_over_the_seam() {
        let square = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)].map(|(y, z)| DVec3::new(5.0, y, z));
        for (start, step) in [(-180.0, 1.0), (0.0, -1.0), (37.0, 1.0)] {
            let sensor = scanner(start, step);
            for degrees in 0..360 {
                let turned = square.map(|p| DMat3::from_rotation_z(f64::from(degrees).to_radians()) * p);
                let [low, high] = of_corners(&sensor, &turned).unwrap();
                assert!((high - low - 2.0 * f64::atan2(0.5, 5.0).to_degrees()).abs() < 1e-9, "{low} {high}");
                assert!((-0.5..359.5).contains(&low));
                let middle =
                    sensor.project(DMat3::from_rotation_z(f64::from(degrees).to_radians()) * DVec3::X).unwrap().0;
                let apart = 0.5 * (low + high) - middle;
                assert!((apart - 360.0 * (apart / 360.0).round()).abs() < 1e-9);
            }
        }
    }

    /// Checks rows along the outlines of walls, and of roofs that do not cover the axis.
    #[test]
    fn rows_of_outlines_hold_all_of_them() {
        let sensor = scanner(-180.0, 1.0);
        let square = [(-0.5, -3.0), (0.5, -3.0), (0.5, 3.0), (-0.5, 3.0)];
        let shapes = [
            square.map(|(z, y)| DVec3::new(2.0, y, z + 1.0)),
            square.map(|(x, y)| DVec3::new(x + 2.0, y, 1.5)),
            square.map(|(x, y)| DVec3::new(x - 2.0, y, -1.5)),
        ];
        for corners in shapes {
            let [low, high] = rows_of_outline(&sensor, &corners).unwrap();
            let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
            for k in 0..4 {
                for i in 0..1000 {
                    let at = corners[k].lerp(corners[(k + 1) % 4], f64::from(i) / 1000.0);
                    let row = sensor.project(at).unwrap().1;
                    assert!(row > low - 1e-9 && row < high + 1e-9, "{row} is not in {low}..{high}");
                    (least, most) = (least.min(row), most.max(row));
                }
            }
            assert!(least < low + 1e-3 && most > high - 1e-3, "{least} {low} {high} {most}");
            // The corners alone do not reach these rows.
            let of_corners = corners.map(|c| sensor.project(c).unwrap().1);
            let beyond = |row: f64| of_corners.iter().all(|c| (c - row).abs() > 1.0);
            assert!(beyond(low) || beyond(high));
        }
    }

    #[test]
    fn around_the_axis_and_uneven_columns_say_nothing() {
        let roof = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| DVec3::new(x, y, 2.0));
        assert_eq!(of_corners(&scanner(0.0, 1.0), &roof), None);
        assert_eq!(of_corners(&preset("video-camera").unwrap(), &roof), None);
    }
}
