//! Checks features before anything is computed from them.

use super::{Existence, Feature, FeatureLayer, FeatureShape};
use crate::error::{Error, Result, short, short_point};
use crate::geometry::{Aabb, PLANARITY, plane_of_polygon};
use crate::limits;
use crate::matrix::cholesky;
use crate::threads::parallel_or_here;
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use std::collections::HashSet;
use std::sync::Arc;

/// Allowed deviation of covariance entries from a positive semidefinite matrix, relative to their standard deviations:
/// half a unit of the sixth significant digit, which is the shortest that programs print by default.
const WRITTEN: f64 = 5e-6;
/// Allowed deviation of a normal's squared length from 1.
const UNIT: f64 = 1e-9;
/// Allowed deviation of a fiducial's corners from a square, relative to its side.
const SQUARE: f64 = 0.05;
/// Cosine of the largest allowed angle between a surface's normal and that of its corners, 8 degrees.
const AGREE: f64 = 0.99;
/// Maximum number of corners of a patch.
const MAX_PATCH_CORNERS: usize = 1024;

/// Number of codes in OpenCV's dictionaries.
const FAMILIES: [(&str, u32); 22] = [
    ("DICT_4X4_50", 50),
    ("DICT_4X4_100", 100),
    ("DICT_4X4_250", 250),
    ("DICT_4X4_1000", 1000),
    ("DICT_5X5_50", 50),
    ("DICT_5X5_100", 100),
    ("DICT_5X5_250", 250),
    ("DICT_5X5_1000", 1000),
    ("DICT_6X6_50", 50),
    ("DICT_6X6_100", 100),
    ("DICT_6X6_250", 250),
    ("DICT_6X6_1000", 1000),
    ("DICT_7X7_50", 50),
    ("DICT_7X7_100", 100),
    ("DICT_7X7_250", 250),
    ("DICT_7X7_1000", 1000),
    ("DICT_ARUCO_ORIGINAL", 1024),
    ("DICT_APRILTAG_16h5", 30),
    ("DICT_APRILTAG_25h9", 35),
    ("DICT_APRILTAG_36h10", 2320),
    ("DICT_APRILTAG_36h11", 587),
    ("DICT_ARUCO_MIP_36h12", 250),
];

impl FeatureLayer {
    /// Checks everything that does not need the world: features, rising ids, the tolerance, covariances of poses.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`], naming the feature.
    pub fn check(&self) -> Result<()> {
        self.check_header()?;
        let wrong = |(i, feature): (usize, &Arc<Feature>)| {
            let checked = feature.check(self.tolerance);
            checked.err().map(|e| e.at(format!("feature {} (features[{i}])", feature.id)))
        };
        let features = self.features.par_iter().enumerate().with_min_len(1024);
        if let Some(e) = parallel_or_here(|| features.find_map_first(wrong)) {
            return Err(e);
        }
        match self.features.windows(2).find(|pair| pair[0].id >= pair[1].id) {
            None => Ok(()),
            Some(pair) => Err(Error::invalid(
                format!("id {} comes after id {}", pair[1].id, pair[0].id),
                "sort the features, and give each a unique id",
            )),
        }
    }

    /// Checks everything except the features.
    pub fn check_header(&self) -> Result<()> {
        if self.class.is_empty() {
            return Err(Error::invalid("the sensor class is empty", "name one, such as \"video\""));
        }
        if !(self.tolerance > 0.0 && self.tolerance <= limits::MAX_COORDINATE) {
            return Err(Error::invalid(
                format!("the tolerance {} is not a valid length in metres", short(self.tolerance)),
                "give a small one above 0, such as 0.001",
            ));
        }
        let mut seen = HashSet::with_capacity(self.pose_covariances.len());
        for (object, covariance) in &self.pose_covariances {
            let place = || format!("pose covariance of object {object:?}");
            if !seen.insert(object) {
                return Err(Error::invalid("it is given twice", "keep one of them").at(place()));
            }
            covariance.check().map_err(|e| e.at(place()))?;
        }
        Ok(())
    }
}

impl Existence {
    /// Checks probability, time and rate.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if the probability is outside 0..=1, the time is not finite or the rate negative.
    pub(super) fn check(&self) -> Result<()> {
        check_share("existence probability", self.p0)?;
        if !self.confirmed.is_finite() {
            return Err(Error::invalid(
                format!("the time of confirmation {} is not finite", self.confirmed),
                "give UTC seconds since 1970",
            ));
        }
        if !(self.rate.is_finite() && self.rate >= 0.0) {
            return Err(Error::invalid(
                format!("the decay rate {} is negative or not finite", self.rate),
                "give 1 / s, 0 for no decay",
            ));
        }
        Ok(())
    }
}

impl Feature {
    /// Checks everything that does not need the world, for a layer with this tolerance (metres).
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`], naming the fault.
    pub fn check(&self, tolerance: f64) -> Result<()> {
        if self.id == 0 {
            return Err(Error::invalid("id 0 is nothing", "count from 1"));
        }
        let sound = |p: &DVec3| p.is_finite() && p.abs().max_element() <= limits::MAX_COORDINATE;
        if let Some((k, p)) = self.shape.points().iter().enumerate().find(|(_, p)| !sound(p)) {
            return Err(Error::invalid(
                format!("point {k} is {}, not a finite position", short_point(*p)),
                format!("give metres, at most {:e}", limits::MAX_COORDINATE),
            ));
        }
        self.existence.check()?;
        self.check_properties()?;
        self.shape.check(tolerance)?;
        self.check_normal()
    }

    /// Checks that a fiducial belongs to one of OpenCV's dictionaries. Not for stored features, which may be older.
    pub fn check_dictionary(&self) -> Result<()> {
        match &self.shape {
            FeatureShape::Fiducial { family, .. } if codes_of(family).is_none() => {
                let place = format!("family {family:?}");
                Err(Error::invalid("OpenCV has no such dictionary", FAMILY).at(place))
            }
            _ => Ok(()),
        }
    }

    fn check_properties(&self) -> Result<()> {
        for (name, value) in [("strength", self.properties.strength), ("contrast", self.properties.contrast)] {
            value.map_or(Ok(()), |v| check_share(name, v))?;
        }
        match self.properties.normal {
            Some(n) if !((n.length_squared() - 1.0).abs() <= UNIT) => Err(Error::invalid(
                format!("the normal {n} has length {}, not 1", n.length()),
                "divide it by its length",
            )),
            _ => Ok(()),
        }
    }

    /// Checks that a surface's normal agrees with its corners.
    fn check_normal(&self) -> Result<()> {
        let Some(normal) = self.properties.normal else { return Ok(()) };
        let plane = match &self.shape {
            FeatureShape::Patch { corners, .. } => plane_of_polygon(corners),
            // Clockwise from the front.
            FeatureShape::Fiducial { corners, .. } => {
                plane_of_polygon(&[corners[3], corners[2], corners[1], corners[0]])
            }
            _ => None,
        };
        let Some(plane) = plane else { return Ok(()) };
        let cosine = plane.normal.dot(normal);
        let sided = matches!(self.shape, FeatureShape::Fiducial { .. });
        if cosine >= AGREE || (!sided && cosine <= -AGREE) {
            return Ok(());
        }
        let remedy = if sided {
            "list the corners clockwise from the top left as seen from the front, or omit the normal"
        } else {
            "correct it, or omit it"
        };
        let off = cosine.clamp(-1.0, 1.0).acos().to_degrees();
        Err(Error::invalid(format!("the normal is {off:.1} degrees off that of the corners"), remedy))
    }
}

impl FeatureShape {
    fn check(&self, tolerance: f64) -> Result<()> {
        match self {
            Self::Point { covariance, .. } | Self::Reflector { covariance, .. } => check_covariance(&rows(covariance)),
            Self::Segment { ends, covariances, cross } => {
                if ends[0] == ends[1] {
                    return Err(Error::invalid("the segment has no length", "give two ends, or make it a point"));
                }
                for (k, covariance) in covariances.iter().enumerate() {
                    check_covariance(&rows(covariance)).map_err(|e| e.at(format!("end {k}")))?;
                }
                // Without a cross-covariance the segment is valid if both ends are.
                if *cross == DMat3::ZERO {
                    return Ok(());
                }
                check_covariance(&joint(covariances, cross)).map_err(|e| e.at("both ends with their cross-covariance"))
            }
            Self::Patch { corners, covariance } => {
                check_patch(corners, tolerance)?;
                check_covariance(&rows(covariance))
            }
            Self::Fiducial { corners, covariance, family, code } => {
                check_fiducial(corners)?;
                check_family(family, *code)?;
                check_covariance(&rows(covariance))
            }
            Self::Contour { crease_deg, covariance, .. } => {
                if !(*crease_deg > 0.0 && *crease_deg <= 90.0) {
                    let what = format!("the crease angle of {} degrees is out of its range", short(*crease_deg));
                    return Err(Error::invalid(what, "give degrees above 0, up to 90"));
                }
                check_covariance(&rows(covariance))
            }
        }
    }
}

fn check_share(name: &str, value: f64) -> Result<()> {
    if (0.0..=1.0).contains(&value) {
        return Ok(());
    }
    Err(Error::invalid(format!("the {name} {value} is outside 0..=1"), "give a value from 0 to 1"))
}

fn check_patch(corners: &[DVec3], tolerance: f64) -> Result<()> {
    let n = corners.len();
    if !(3..=MAX_PATCH_CORNERS).contains(&n) {
        let remedy = if n < 3 { "give at least 3" } else { "split the patch" };
        return Err(Error::invalid(format!("a patch of {n} corners"), remedy));
    }
    let crossing = || Error::invalid("the outline crosses itself", "list each corner once, in order around the patch");
    let plane = plane_of_polygon(corners).ok_or_else(|| match crosses_itself(corners) {
        // For example a bow-tie of two equal halves.
        true => crossing(),
        false => Error::invalid("the patch has no area", "give corners that are not on one line"),
    })?;
    let size = Aabb::of(corners.iter().copied()).size();
    let dent = PLANARITY * size;
    // Relative to the first corner: in world coordinates the plane's offset would be rounded.
    let offset = plane.normal.dot(corners.iter().map(|c| *c - corners[0]).sum::<DVec3>() / n as f64);
    let mut turned = 0.0;
    for k in 0..n {
        let off = plane.normal.dot(corners[k] - corners[0]) - offset;
        if off.abs() > tolerance {
            return Err(Error::invalid(
                format!("corner {k} is {:.3e} m off the patch's plane; {tolerance:e} m is allowed", off.abs()),
                "split the patch into planar ones",
            ));
        }
        let before = corners[k] - corners[(k + n - 1) % n];
        let after = corners[(k + 1) % n] - corners[k];
        if before == DVec3::ZERO {
            return Err(Error::invalid(format!("corner {k} repeats the one before"), "drop one of them"));
        }
        let turn = before.cross(after).dot(plane.normal);
        if turn < -dent * before.length().max(after.length()) {
            let dented = || {
                let what = format!("corner {k} turns inwards: the patch is not convex");
                Error::invalid(what, "split it into convex ones")
            };
            return Err(if crosses_itself(corners) { crossing() } else { dented() });
        }
        turned += turn.atan2(before.dot(after));
    }
    if (turned - std::f64::consts::TAU).abs() > 1.0 {
        return Err(Error::invalid("the outline winds more than once", "list each corner once, in order"));
    }
    Ok(())
}

/// True if two sides cross, as seen along the normal of the largest triangle at the first corner.
fn crosses_itself(corners: &[DVec3]) -> bool {
    let from_first = |k: usize| corners[k] - corners[0];
    let normals = (1..corners.len() - 1).map(|k| from_first(k).cross(from_first(k + 1)));
    let normal = normals.max_by(|a, b| a.length().total_cmp(&b.length())).unwrap_or(DVec3::ZERO);
    let side = |k: usize| [corners[k], corners[(k + 1) % corners.len()]];
    // True if c and d lie on opposite sides of the line a b, clear of rounding.
    let parts = |[a, b]: [DVec3; 2], [c, d]: [DVec3; 2]| {
        let [left, right] = [c, d].map(|p| normal.dot((b - a).cross(p - a)));
        let rounding =
            64.0 * f64::EPSILON * normal.length() * (b - a).length() * (c - a).length().max((d - a).length());
        left.min(right) < -rounding && left.max(right) > rounding
    };
    let crosses = |i: usize, j: usize| parts(side(i), side(j)) && parts(side(j), side(i));
    (0..corners.len()).any(|i| (0..i).any(|j| crosses(i, j)))
}

fn check_fiducial(corners: &[DVec3; 4]) -> Result<()> {
    let [a, b, c, d] = *corners;
    let (right, down) = (0.5 * ((b - a) + (c - d)), 0.5 * ((d - a) + (c - b)));
    let side = 0.5 * (right.length() + down.length());
    // Residual of each corner to the best-fitting parallelogram.
    let left_over = 0.25 * ((a - b) + (c - d)).length();
    let square = side > 0.0
        && left_over <= SQUARE * side
        && (right.length() - down.length()).abs() <= SQUARE * side
        && right.dot(down).abs() <= SQUARE * side * side;
    if square {
        return Ok(());
    }
    Err(Error::invalid(
        format!("the corners {} do not form a square", corners.map(short_point).join(", ")),
        "give the marker's four corners clockwise from the top left, seen from the front",
    ))
}

fn check_family(family: &str, code: u32) -> Result<()> {
    let place = || format!("family {family:?}");
    match codes_of(family) {
        Some(count) if code >= count => {
            let remedy = "give its number in the dictionary";
            Err(Error::invalid(format!("code {code} is not below {count}, the dictionary's size"), remedy).at(place()))
        }
        None if family.is_empty() => Err(Error::invalid("it has no name", FAMILY).at(place())),
        _ => Ok(()),
    }
}

/// Remedy for a wrong family name.
const FAMILY: &str = "write OpenCV's name of the dictionary, such as \"DICT_APRILTAG_36h11\"";

/// Number of codes in one of OpenCV's dictionaries.
fn codes_of(family: &str) -> Option<u32> {
    FAMILIES.iter().find(|(name, _)| *name == family).map(|(_, count)| *count)
}

fn rows(m: &DMat3) -> [[f64; 3]; 3] {
    m.transpose().to_cols_array_2d()
}

fn joint(covariances: &[DMat3; 2], cross: &DMat3) -> [[f64; 6]; 6] {
    let (first, second, cross, back) =
        (rows(&covariances[0]), rows(&covariances[1]), rows(cross), rows(&cross.transpose()));
    std::array::from_fn(|i| {
        std::array::from_fn(|j| match (i / 3, j / 3) {
            (0, 0) => first[i][j],
            (0, _) => cross[i][j - 3],
            (_, 0) => back[i - 3][j],
            _ => second[i - 3][j - 3],
        })
    })
}

/// Checks that a covariance is finite, symmetric and positive semidefinite, as far as six printed digits allow.
///
/// Entries are scaled by their standard deviations, so that mixed units do not matter. An error of `WRITTEN` in each
/// entry moves eigenvalues by at most 2 n `WRITTEN`; with that much on the diagonal, Cholesky must succeed.
pub fn check_covariance<const N: usize>(covariance: &[[f64; N]; N]) -> Result<()> {
    if covariance.as_flattened().iter().all(|x| *x == 0.0) {
        return Ok(());
    }
    let wrong = |what: String| Err(Error::invalid(what, "give a covariance: symmetric, without negative eigenvalues"));
    let most = limits::MAX_COORDINATE * limits::MAX_COORDINATE;
    if let Some(x) = covariance.as_flattened().iter().find(|x| !(x.abs() <= most)) {
        return wrong(format!("the covariance contains {}, which is not finite or too large", short(*x)));
    }
    if let Some(i) = (0..N).find(|&i| covariance[i][i] < 0.0) {
        return wrong(format!("the variance at [{i}][{i}] is negative: {}", short(covariance[i][i])));
    }
    let sigma: [f64; N] = std::array::from_fn(|i| covariance[i][i].sqrt());
    let mut scaled = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..N {
            let (a, b) = (covariance[i][j], covariance[j][i]);
            let scale = sigma[i] * sigma[j];
            if (a - b).abs() > 2.0 * WRITTEN * scale {
                return wrong(format!("the covariance is not symmetric: [{i}][{j}] is {a}, [{j}][{i}] is {b}"));
            }
            if scale == 0.0 && a != 0.0 {
                return wrong(format!("the covariance is indefinite: [{i}][{j}] is {a}, but a variance is 0"));
            }
            scaled[i][j] = if scale == 0.0 { 0.0 } else { 0.5 * (a + b) / scale };
        }
    }
    (0..N).for_each(|i| scaled[i][i] += 2.0 * N as f64 * WRITTEN);
    if cholesky(&scaled, |rest| (rest > 0.0).then_some(rest)).is_some() {
        return Ok(());
    }
    wrong("the covariance is indefinite: it has a negative eigenvalue".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn singular_covariances_pass_and_indefinite_ones_do_not() {
        let check = |a: [[f64; 3]; 3]| check_covariance(&a);
        assert!(check([[0.0; 3]; 3]).is_ok());
        assert!(check([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1e-18]]).is_ok());
        // Singular, printed with six digits.
        assert!(check([[0.333333, 0.57735, 0.0], [0.57735, 1.0, 0.0], [0.0, 0.0, 1.0]]).is_ok());
        assert!(check([[1.0, 1.0005, 0.0], [1.0005, 1.0, 0.0], [0.0, 0.0, 1.0]]).is_err());
        // Indefinite in a block much smaller than the rest.
        assert!(check([[1e6, 0.0, 0.0], [0.0, 1e-18, 1.001e-18], [0.0, 1.001e-18, 1e-18]]).is_err());
        assert!(check([[1.0, 0.0, 0.0], [0.0, -1e-30, 0.0], [0.0, 0.0, 1.0]]).is_err());
        assert!(check([[1.0, 0.1, 0.0], [0.1001, 1.0, 0.0], [0.0, 0.0, 1.0]]).is_err());
        assert!(check([[0.0, 1e-12, 0.0], [1e-12, 1.0, 0.0], [0.0, 0.0, 1.0]]).is_err());
    }

    proptest! {
        /// J S J^T in f64, of any rank, with standard deviations from a nanometre to a kilometre.
        #[test]
        fn products_are_accepted_and_with_an_axis_turned_negative_they_are_not(
            factors in prop::collection::vec((-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64, -9.0..3.0f64), 1..5),
        ) {
            let mut sum = [[0.0; 3]; 3];
            for (x, y, z, power) in &factors {
                let v = [x, y, z].map(|c| c * 10f64.powf(*power));
                for i in 0..3 {
                    for j in 0..3 {
                        sum[i][j] += v[i] * v[j];
                    }
                }
            }
            prop_assert!(check_covariance(&sum).is_ok(), "{sum:?}");
            // Negative along x.
            let mut less = sum;
            less[0][0] = less[0][0] * 0.999 - 1.0;
            let det2 = less[0][0] * less[1][1] - less[0][1] * less[1][0];
            if less[0][0] < 0.0 || det2 < -1e-3 * (less[0][0] * less[1][1]).abs() {
                prop_assert!(check_covariance(&less).is_err(), "{less:?}");
            }
        }
    }
}
