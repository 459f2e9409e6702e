// Cones around the rays of tiles and supertiles: 4 words in `grid`, the axis and the chord, which is how far a ray of length one may
// be from it; 4 where that bounds nothing, negative where there is no ray. Chords keep the digits of narrow cones, which cosines lose.

const RAYS_PER_TILE: u32 = 8u;
const TILES_PER_SUPERTILE: u32 = 8u;
// Rays of a box that are tested one by one, whatever tiles they lie in.
const RAYS_PER_BOX: u32 = 64u;

struct Cone {
    axis: vec3f,
    chord: f32,
    // Squared sine of the half angle; more than 1 where the chord bounds nothing.
    sine2: f32,
}

fn cone_at(at: u32) -> Cone {
    let axis = vec3f(bitcast<f32>(grid[at]), bitcast<f32>(grid[at + 1u]), bitcast<f32>(grid[at + 2u]));
    let chord = bitcast<f32>(grid[at + 3u]);
    let chord2 = chord * chord;
    return Cone(axis, chord, select(chord2 * (1.0 - 0.25 * chord2), 2.0, chord > 1.9));
}

// The chord of a polygon's cap, of which a record has the square; a negative one is no cap.
fn cap_chord(squared: f32) -> f32 {
    return select(4.0, sqrt(squared), squared >= 0.0);
}

// False only if no ray of the cone is in the cap: chords are no shorter than that of the angle between the axes, together.
fn cap_meets(axis: vec3f, chord: f32, cone: Cone) -> bool {
    let apart = axis - cone.axis;
    let reach = chord + cone.chord;
    return cone.chord >= 0.0 && dot(apart, apart) <= reach * reach;
}

// True if all rays of the cone are outside an edge plane. Its normal may have any length; zero limits nothing.
fn is_beside(e: vec3f, cone: Cone) -> bool {
    let d = dot(e, cone.axis);
    return d < 0.0 && d * d > cone.sine2 * dot(e, e);
}

// True if no ray of a tile, or of a square of tiles, can meet the plane m in front of what earlier waves drew there: no ray is farther from
// the axis than the chord, and rounding adds less than this.
fn is_behind(m: vec3f, cone: Cone, level: u32, row: u32, column: u32) -> bool {
    if params.hiding == 0u {
        return false;
    }
    let most = dot(m, cone.axis) + length(m) * (cone.chord + 2.0e-6);
    return bitcast<f32>(grid[coarse_at(level, row, column)]) > most;
}
