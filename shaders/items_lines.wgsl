// Work items of a line grid: a polygon, some of its lines and of their samples, so that a big polygon spreads over many invocations.

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
        // The parts share out the whole line: rounding may draw a sample beyond the polygon's own.
        var start = 0u;
        for (var k = 1u; k <= parts; k++) {
            let end = select(begin + k * width / parts, params.sample_count, k == parts);
            put_item(base + i * parts + k - 1u, at, lines, start | (end << 16u));
            start = end;
        }
    }
}

// |v| / |d| above which a polygon is flat to the sensor.
const FLAT: f32 = 16.0;

// The cap of the unit sphere around a polygon that is flat to the sensor: its axis and squared chord, -1 for all others.
// Seen from so nearly within its plane all edge planes nearly are that plane; rounded to f32 they may meet beyond its
// end or beside its corner, and only the cap says that nothing is there.
fn write_cap(at: u32, instance: Instance, first_corner: u32, corner_count: u32) {
    var axis = vec3f();
    var nearest = HUGE;
    for (var k = 0u; k < corner_count; k++) {
        let v = to_image(instance, from_center(instance, vertex(instance, arena[first_corner + k * CORNER_WORDS])));
        let size = length(v);
        nearest = min(nearest, size);
        axis += v / size;
    }
    // Its length is 1 / |d|: the first words of the record, turned back from the line frame.
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
        // A little wider than rounding; a cap of a quarter turn and more need not hold the polygon.
        chord = select(-1.0, chord * 1.00001 + 1.0e-11, chord < 1.9);
    }
    put(at + RECORD_CAP_AXIS, axis);
    records[at + RECORD_CAP_CHORD] = bitcast<u32>(chord);
}
