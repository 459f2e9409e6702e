// Work items of a ray table: a polygon with a small box of pixels, or with tiles of a supertile that it may meet.

fn add_items(at: u32, index: u32, instance: Instance, survivor: Survivor, first_corner: u32, corner_count: u32) {
    var axis = vec3f();
    for (var k = 0u; k < corner_count; k++) {
        let p = vertex(instance, arena[first_corner + k * CORNER_WORDS]);
        axis += normalize(to_image(instance, from_center(instance, p)));
    }
    axis = normalize(axis + vec3f(1.0e-12, 0.0, 0.0));
    var squared = 0.0;
    for (var k = 0u; k < corner_count; k++) {
        let p = vertex(instance, arena[first_corner + k * CORNER_WORDS]);
        let apart = normalize(to_image(instance, from_center(instance, p))) - axis;
        squared = max(squared, dot(apart, apart));
    }
    // A cap of less than a quarter turn around the vertices is convex, so it contains the polygon; a wider one may not.
    squared = select(-1.0, squared * 1.00001 + 1.0e-11, squared < 1.9);
    put(at + RECORD_CAP_AXIS, axis);
    records[at + RECORD_CAP_CHORD] = bitcast<u32>(squared);

    let lines = survivor.lines >> 16u;
    let samples = survivor.samples >> 16u;
    let first_pixel = vec2u(survivor.samples & 0xffffu, survivor.lines & 0xffffu);
    let end = first_pixel + vec2u(samples, lines);
    if lines * samples <= RAYS_PER_BOX {
        put_box(reserve_items(1u), at, first_pixel, end);
        return;
    }
    let chord = cap_chord(squared);
    let m = vec3f(bitcast<f32>(records[at]), bitcast<f32>(records[at + 1u]), bitcast<f32>(records[at + 2u]));
    // Three edges suffice for a triangle, the common case: further edges would exclude little more.
    let e0 = edge_of(at, 0u);
    let e1 = edge_of(at, 1u);
    let e2 = edge_of(at, 2u);
    let across = (params.tile_columns + TILES_PER_SUPERTILE - 1u) / TILES_PER_SUPERTILE;
    let tile_rows = tiles_of(survivor.lines);
    let tile_columns = tiles_of(survivor.samples);
    let rows = tile_rows / TILES_PER_SUPERTILE;
    let columns = tile_columns / TILES_PER_SUPERTILE;
    for (var row = rows.x; row <= rows.y; row++) {
        for (var first = columns.x; first <= columns.y; first += 32u) {
            var met = 0u;
            for (var column = first; column <= min(first + 31u, columns.y); column++) {
                let cone = cone_at(params.lines_at + (row * across + column) * 4u);
                let meets = cap_meets(axis, chord, cone)
                    && !(is_beside(e0, cone) || is_beside(e1, cone) || is_beside(e2, cone))
                    && !is_behind(m, cone, LEVELS - 1u, row, column);
                met |= select(0u, 1u, meets) << (column - first);
            }
            while met != 0u {
                let column = first + firstTrailingBit(met);
                put_tiles(at, clamped(tile_rows, row), clamped(tile_columns, column), first_pixel, end);
                met &= met - 1u;
            }
        }
    }
}

// First and last tile of a range of rays.
fn tiles_of(stretch: u32) -> vec2u {
    let first = stretch & 0xffffu;
    return vec2u(first, first + (stretch >> 16u) - 1u) / RAYS_PER_TILE;
}

// The part of a range of tiles that lies in one row or column of supertiles.
fn clamped(tiles: vec2u, supertile: u32) -> vec2u {
    let first = supertile * TILES_PER_SUPERTILE;
    return vec2u(max(tiles.x, first), min(tiles.y, first + TILES_PER_SUPERTILE - 1u));
}

// Maximum number of tiles of an item.
const TILES_PER_ITEM: u32 = 16u;

// Adds items for some tiles, cut to the pixels from `first` to before `end`.
fn put_tiles(record: u32, rows: vec2u, columns: vec2u, first: vec2u, end: vec2u) {
    let share = TILES_PER_ITEM / (columns.y - columns.x + 1u);
    let wanted = (rows.y - rows.x + share) / share;
    let base = reserve_items(wanted);
    for (var i = 0u; i < wanted; i++) {
        let row = rows.x + i * share;
        let last = min(row + share - 1u, rows.y);
        let begin = max(first, vec2u(columns.x, row) * RAYS_PER_TILE);
        put_box(base + i, record, begin, min(end, vec2u(columns.y + 1u, last + 1u) * RAYS_PER_TILE));
    }
}

// Adds an item with the columns and rows from `first` to before `end`.
fn put_box(index: u32, record: u32, first: vec2u, end: vec2u) {
    put_item(index, record, first.y | (first.x << 16u), end.y | (end.x << 16u));
}

fn edge_of(record: u32, k: u32) -> vec3f {
    let at = record + RECORD_WORDS + k * EDGE_WORDS;
    return vec3f(bitcast<f32>(records[at]), bitcast<f32>(records[at + 1u]), bitcast<f32>(records[at + 2u]));
}
