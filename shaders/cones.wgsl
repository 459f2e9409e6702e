// Cones around rays and polygons.

// Cosine of the half angle of the cone that a cap's squared chord spans, a little wide; -1, all directions, for a
// negative one. The chord keeps the digits of small caps, which the cosine loses below a milliradian.
fn cosine_of(chord: f32) -> f32 {
    return select(-1.0, 1.0 - 0.5 * chord - 1.0e-6, chord >= 0.0);
}

fn cones_meet(axis_a: vec3f, cos_a: f32, axis_b: vec3f, cos_b: f32) -> bool {
    let sin_a = sqrt(max(0.0, 1.0 - cos_a * cos_a));
    let sin_b = sqrt(max(0.0, 1.0 - cos_b * cos_b));
    // Half angles that sum to more than half a turn always meet: then the sine of the sum is negative.
    let wide = sin_a * cos_b + cos_a * sin_b <= 1.0e-3 && cos_a + cos_b < 0.5;
    return wide || dot(axis_a, axis_b) >= cos_a * cos_b - sin_a * sin_b - 1.0e-5;
}
