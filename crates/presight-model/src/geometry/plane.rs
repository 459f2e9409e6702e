//! The plane of a polygon.

use glam::DVec3;

/// Relative error of planar polygons with f32 corners: distance of a corner from the plane over the largest coordinate
/// extent. It covers rounding and the residual of merging.
pub(crate) const PLANARITY: f64 = 4e-6;

/// `normal . p = offset` for every point p of the plane; `normal` has unit length.
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Plane {
    /// Unit normal, by the right-hand rule from the winding.
    pub normal: DVec3,
    /// Metres along the normal.
    pub offset: f64,
}

/// The best plane of a closed vertex loop by Newell's sum. Returns `None` if the area is within rounding.
///
/// Vertices are treated as exact. With longest side l, the rounding of the sum is below `n * 2^-52 * l^2`; a smaller
/// area does not determine the direction. Aspect ratios of 10^6, even 10^9, are far above it.
pub fn plane_of_polygon(vertices: &[DVec3]) -> Option<Plane> {
    plane_of_loop(vertices.len(), |k| vertices[k])
}

/// [`plane_of_polygon`] of `count` vertices, which `vertex` returns for 0, 1 and so on.
pub fn plane_of_loop(count: usize, vertex: impl Fn(usize) -> DVec3) -> Option<Plane> {
    if count == 0 {
        return None;
    }
    let origin = vertex(0);
    let mut doubled_area = DVec3::ZERO;
    let mut sum = DVec3::ZERO;
    let mut longest_squared = 0.0f64;
    let mut a = DVec3::ZERO;
    for k in 1..=count {
        let b = if k < count { vertex(k) - origin } else { DVec3::ZERO };
        doubled_area += a.cross(b);
        sum += b;
        longest_squared = longest_squared.max((b - a).length_squared());
        a = b;
    }
    let length = doubled_area.length();
    let rounding = count as f64 * f64::EPSILON * longest_squared;
    if !(length.is_finite() && length > rounding && length > 0.0) {
        return None;
    }
    let normal = doubled_area / length;
    let offset = normal.dot(origin) + normal.dot(sum) / count as f64;
    Some(Plane { normal, offset })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slivers_have_planes_and_lines_do_not() {
        let a = DVec3::new(10.0, 20.0, 1.0);
        let sliver = [a, a + DVec3::X, a + DVec3::new(0.5, 1e-6, 0.0)];
        let plane = plane_of_polygon(&sliver).unwrap();
        assert!((plane.normal - DVec3::Z).length() < 1e-6);
        assert!((plane.offset - 1.0).abs() < 1e-12);
        assert!(plane_of_polygon(&[a, a + DVec3::X, a + 2.0 * DVec3::X]).is_none());
        assert!(plane_of_polygon(&[a, a, a + DVec3::X]).is_none());
    }

    #[test]
    fn normal_follows_the_winding() {
        let v = [DVec3::ZERO, DVec3::X, DVec3::Y];
        assert_eq!(plane_of_polygon(&v).unwrap().normal, DVec3::Z);
        let r = [v[0], v[2], v[1]];
        assert_eq!(plane_of_polygon(&r).unwrap().normal, -DVec3::Z);
    }
}
