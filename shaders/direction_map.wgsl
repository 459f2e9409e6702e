// Which pixels look in about a direction: boxes of pixels by cells of directions on the sides of a cube, several times, finer for narrow
// cones than for wide ones (sensor::DirectionMap). In `grid`, at `map_at`: levels, from narrow to wide; then the boxes of their cells.

// SINE2: squared sine of the half angle of the cones that the level serves. ACROSS: cells along an edge of the cube. SIDES: six, each the
// rectangle of cells that there is room for, twice the axis nearest to a direction and one more where that is negative.
const LEVEL_SINE2: u32 = 0u;
const LEVEL_ACROSS: u32 = 1u;
const LEVEL_SIDES: u32 = 2u;
const LEVEL_WORDS: u32 = 32u;
// FIRST and COUNT: two words each. BOXES_AT: in `grid`; those along the first axis follow one another.
const SIDE_FIRST: u32 = 0u;
const SIDE_COUNT: u32 = 2u;
const SIDE_BOXES_AT: u32 = 4u;
const SIDE_WORDS: u32 = 5u;
// A box: first row and end, first column and end, 16 bits each.
const PIXEL_BOX_WORDS: u32 = 2u;

struct PixelBox {
    // False if the cone is too wide.
    known: bool,
    // First and end; none where the end is not above.
    rows: vec2u,
    columns: vec2u,
}

// The pixels whose rays are in a cone around a direction of any length: the squared sine of its half angle is `radius2 / length^2`.
fn pixels_in(axis: vec3f, radius2: f32) -> PixelBox {
    let length2 = dot(axis, axis);
    var level = params.map_at;
    let end = level + params.map_levels * LEVEL_WORDS;
    // Written so that what is not a number is too wide.
    while level < end && !(radius2 < bitcast<f32>(grid[level + LEVEL_SINE2]) * length2) {
        level += LEVEL_WORDS;
    }
    if level == end {
        return PixelBox(false, vec2u(), vec2u());
    }
    let a = abs(axis);
    let is_x = a.x >= a.y && a.x >= a.z;
    let is_z = !is_x && a.z > a.y;
    // The component along the nearest axis, then those along the next two.
    let turned = select(select(axis.yzx, axis.zxy, is_z), axis, is_x);
    let side = select(select(2u, 4u, is_z), 0u, is_x) + select(0u, 1u, turned.x < 0.0);
    let across = grid[level + LEVEL_ACROSS];
    let place = turned.yz / abs(turned.x);
    let cell = min(vec2u(max(0.5 * (place + 1.0) * f32(across), vec2f())), vec2u(across - 1u));
    let at = level + LEVEL_SIDES + side * SIDE_WORDS;
    // What is before the first one is far behind the last one.
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
