// The direction map (sensor::DirectionMap): boxes of pixels by direction, in cells on the sides of a cube. Levels have
// fine cells for narrow cones and coarse cells for wide ones. In `grid` at `map_at`: levels, narrow first; then boxes.

// SINE2: squared sine of the largest half angle that the level serves. ACROSS: cells along an edge of the cube. SIDES:
// the stored rectangle of cells on the six sides, at twice the index of the dominant axis, plus one if it is negative.
const LEVEL_SINE2: u32 = 0u;
const LEVEL_ACROSS: u32 = 1u;
const LEVEL_SIDES: u32 = 2u;
const LEVEL_WORDS: u32 = 32u;
// FIRST and COUNT: two words each. BOXES_AT: in `grid`; boxes along the first axis are consecutive.
const SIDE_FIRST: u32 = 0u;
const SIDE_COUNT: u32 = 2u;
const SIDE_BOXES_AT: u32 = 4u;
const SIDE_WORDS: u32 = 5u;
// A box: first row and end, first column and end, 16 bits each.
const PIXEL_BOX_WORDS: u32 = 2u;

struct PixelBox {
    // False if the cone is wider than the widest level.
    known: bool,
    // First and end; empty unless the end is above.
    rows: vec2u,
    columns: vec2u,
}

// The pixels whose rays are in a cone. The axis may have any length; sin^2 of the half angle is radius2 / length^2.
fn pixels_in(axis: vec3f, radius2: f32) -> PixelBox {
    let length2 = dot(axis, axis);
    var level = params.map_at;
    let end = level + params.map_levels * LEVEL_WORDS;
    // The negated comparison treats NaN as too wide.
    while level < end && !(radius2 < bitcast<f32>(grid[level + LEVEL_SINE2]) * length2) {
        level += LEVEL_WORDS;
    }
    if level == end {
        return PixelBox(false, vec2u(), vec2u());
    }
    let a = abs(axis);
    let is_x = a.x >= a.y && a.x >= a.z;
    let is_z = !is_x && a.z > a.y;
    // The component along the dominant axis, then the next two in cyclic order.
    let turned = select(select(axis.yzx, axis.zxy, is_z), axis, is_x);
    let side = select(select(2u, 4u, is_z), 0u, is_x) + select(0u, 1u, turned.x < 0.0);
    let across = grid[level + LEVEL_ACROSS];
    let place = turned.yz / abs(turned.x);
    let cell = min(vec2u(max(0.5 * (place + 1.0) * f32(across), vec2f())), vec2u(across - 1u));
    let at = level + LEVEL_SIDES + side * SIDE_WORDS;
    // Unsigned: a cell before the first wraps to a number beyond the last.
    let within = cell - vec2u(grid[at + SIDE_FIRST], grid[at + SIDE_FIRST + 1u]);
    let columns = grid[at + SIDE_COUNT];
    if within.x >= columns || within.y >= grid[at + SIDE_COUNT + 1u] {
        return PixelBox(true, vec2u(), vec2u());
    }
    let found = grid[at + SIDE_BOXES_AT] + (within.y * columns + within.x) * PIXEL_BOX_WORDS;
    let rows = grid[found];
    let box_columns = grid[found + 1u];
    return PixelBox(true, vec2u(rows & 0xffffu, rows >> 16u), vec2u(box_columns & 0xffffu, box_columns >> 16u));
}
