// Cones around the rays of tiles and supertiles, 4 words each in `grid`: axis, and chord (distance from the axis to its
// farthest unit ray): 4 if unbounded, negative without rays. Chords stay precise for narrow cones; cosines do not.

const RAYS_PER_TILE: u32 = 8u;
const TILES_PER_SUPERTILE: u32 = 8u;
// A box with at most this many rays is tested ray by ray, without its tiles' cones.
const RAYS_PER_BOX: u32 = 64u;

struct Cone {
    axis: vec3f,
    chord: f32,
    // Squared sine of the half angle; 2 if the chord is too long to bound an angle.
    sine2: f32,
}

fn cone_at(at: u32) -> Cone {
    let axis = vec3f(bitcast<f32>(grid[at]), bitcast<f32>(grid[at + 1u]), bitcast<f32>(grid[at + 2u]));
    let chord = bitcast<f32>(grid[at + 3u]);
    let chord2 = chord * chord;
    return Cone(axis, chord, select(chord2 * (1.0 - 0.25 * chord2), 2.0, chord > 1.9));
}

// Chord of a polygon's cap from its square in the record; 4 (unbounded) without a cap.
fn cap_chord(squared: f32) -> f32 {
    return select(4.0, sqrt(squared), squared >= 0.0);
}

// False only if no ray of the cone is in the cap: two chords together are at least the chord of the summed angle.
fn cap_meets(axis: vec3f, chord: f32, cone: Cone) -> bool {
    let apart = axis - cone.axis;
    let reach = chord + cone.chord;
    return cone.chord >= 0.0 && dot(apart, apart) <= reach * reach;
}

// True if all rays of the cone are outside an edge plane. The normal may have any length; zero excludes nothing.
fn is_beside(e: vec3f, cone: Cone) -> bool {
    let d = dot(e, cone.axis);
    return d < 0.0 && d * d > cone.sine2 * dot(e, e);
}

// True if no ray of a tile or square of tiles can meet the plane m in front of the depth drawn by earlier waves. Rays
// differ from the axis by the chord at most; the added constant covers rounding.
fn is_behind(m: vec3f, cone: Cone, level: u32, row: u32, column: u32) -> bool {
    if params.hiding == 0u {
        return false;
    }
    let most = dot(m, cone.axis) + length(m) * (cone.chord + 2.0e-6);
    return bitcast<f32>(grid[coarse_at(level, row, column)]) > most;
}
