// Work items of a ray table: a polygon and a supertile whose cone it may meet.

fn add_items(at: u32, instance: Instance, survivor: Survivor, first_corner: u32, corner_count: u32) {
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
    // A cap of less than a quarter turn around the vertices is convex and holds the polygon; a wider one is not.
    squared = select(-1.0, squared * 1.00001 + 1.0e-11, squared < 1.9);
    put(at + RECORD_CAP_AXIS, axis);
    records[at + RECORD_CAP_CHORD] = bitcast<u32>(squared);

    let chord = cap_chord(squared);
    // Triangles are most of all: more edges than three would leave out little more.
    let e0 = edge_of(at, 0u);
    let e1 = edge_of(at, 1u);
    let e2 = edge_of(at, 2u);
    let across = (params.tile_columns + TILES_PER_SUPERTILE - 1u) / TILES_PER_SUPERTILE;
    let side = RAYS_PER_TILE * TILES_PER_SUPERTILE;
    let rows = vec2u(survivor.lines & 0xffffu, (survivor.lines & 0xffffu) + (survivor.lines >> 16u) - 1u) / side;
    let columns = vec2u(survivor.samples & 0xffffu, (survivor.samples & 0xffffu) + (survivor.samples >> 16u) - 1u) / side;
    for (var row = rows.x; row <= rows.y; row++) {
        for (var first = columns.x; first <= columns.y; first += 32u) {
            var met = 0u;
            for (var column = first; column <= min(first + 31u, columns.y); column++) {
                let cone = cone_at(params.lines_at + (row * across + column) * 4u);
                let meets = cap_meets(axis, chord, cone)
                    && !(is_beside(e0, cone) || is_beside(e1, cone) || is_beside(e2, cone));
                met |= select(0u, 1u, meets) << (column - first);
            }
            if met != 0u {
                var index = reserve_items(countOneBits(met));
                while met != 0u {
                    put_item(index, at, row * across + first + firstTrailingBit(met));
                    index++;
                    met &= met - 1u;
                }
            }
        }
    }
}

fn edge_of(record: u32, k: u32) -> vec3f {
    let at = record + RECORD_WORDS + k * EDGE_WORDS;
    return vec3f(bitcast<f32>(records[at]), bitcast<f32>(records[at + 1u]), bitcast<f32>(records[at + 2u]));
}
