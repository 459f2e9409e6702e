// Work items of a line grid: a polygon with some of its lines and samples. Many invocations share a big polygon.

fn add_items(at: u32, index: u32, instance: Instance, survivor: Survivor, first_corner: u32, corner_count: u32) {
    write_cap(at, instance, first_corner, corner_count);
    if RENDER && set_shape(at, index, instance, survivor, first_corner, corner_count) {
        return;
    }
    let first = survivor.lines & 0xffffu;
    let count = survivor.lines >> 16u;
    let share = max(LINES_PER_ITEM, (count + ITEMS_PER_POLYGON - 1u) / ITEMS_PER_POLYGON);
    let stretches = (count + share - 1u) / share;
    let begin = survivor.samples & 0xffffu;
    let width = survivor.samples >> 16u;
    let parts = max(1u, width / SAMPLES_PER_ITEM);
    let base = reserve_items(stretches * parts);
    for (var i = 0u; i < stretches; i++) {
        let lines = (first + i * share) | (min(share, count - i * share) << 16u);
        // The parts together cover whole lines, because rounding may draw samples outside the survivor's bounds.
        var start = 0u;
        for (var k = 1u; k <= parts; k++) {
            let end = select(begin + k * width / parts, params.sample_count, k == parts);
            put_item(base + i * parts + k - 1u, at, lines, start | (end << 16u));
            start = end;
        }
    }
}

// Ratio |v| / |d| above which a polygon is treated as edge-on.
const FLAT: f32 = 16.0;

// Writes the cap of an edge-on polygon: the axis and squared chord of a cone around its corners; -1 for other polygons.
// Seen edge-on, all edge planes nearly coincide with the polygon's plane, and their f32 roundings may intersect beyond
// its ends. Only the cap excludes rays there.
fn write_cap(at: u32, instance: Instance, first_corner: u32, corner_count: u32) {
    var axis = vec3f();
    var nearest = HUGE;
    for (var k = 0u; k < corner_count; k++) {
        let v = to_image(instance, from_center(instance, vertex(instance, arena[first_corner + k * CORNER_WORDS])));
        let size = length(v);
        nearest = min(nearest, size);
        axis += v / size;
    }
    // Its length is 1 / |d|: read from the record and transformed back from the line frame.
    var m = vec3f(bitcast<f32>(records[at]), bitcast<f32>(records[at + 1u]), bitcast<f32>(records[at + 2u]));
    if GRID == CAMERA {
        m = vec3f(m.z * params.fx, m.x * params.fy, m.y);
    }
    var chord = -1.0;
    if length(m) * nearest > FLAT {
        axis = normalize(axis);
        for (var k = 0u; k < corner_count; k++) {
            let v = to_image(instance, from_center(instance, vertex(instance, arena[first_corner + k * CORNER_WORDS])));
            let apart = normalize(v) - axis;
            chord = max(chord, dot(apart, apart));
        }
        // Widened by a little more than rounding. A cap of a quarter turn or more may not contain the polygon.
        chord = select(-1.0, chord * 1.00001 + 1.0e-11, chord < 1.9);
    }
    put(at + RECORD_CAP_AXIS, axis);
    records[at + RECORD_CAP_CHORD] = bitcast<u32>(chord);
}
