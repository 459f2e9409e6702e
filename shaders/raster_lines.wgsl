// Stage 3 for line grids: one invocation per item, line by line.

@group(0) @binding(2) var<storage, read> items: array<u32>;

@compute @workgroup_size(64)
fn raster(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    // The count may exceed the room; only this many items were written.
    let count = min(counted[COUNTED_ITEMS], params.item_room);
    for (var i = first_of(counted[COUNTED_ITEMS_BEFORE]) + id.x; i < count; i += groups.x * GROUP) {
        let part = items[i * ITEM_WORDS + ITEM_PART];
        let within = items[i * ITEM_WORDS + ITEM_WITHIN];
        rasterize(items[i * ITEM_WORDS + ITEM_RECORD], part & 0xffffu, part >> 16u, within & 0xffffu, within >> 16u);
    }
}

fn rasterize(record: u32, first: u32, count: u32, first_sample: u32, end_sample: u32) {
    let m = vector_of(record + RECORD_M);
    let slot = records[record + RECORD_SLOT];
    let edge_count = records[record + RECORD_EDGE_COUNT];
    let axis = vector_of(record + RECORD_CAP_AXIS);
    let chord = float_of(record + RECORD_CAP_CHORD);
    // The first four edges, all that a common polygon has, stay in registers over all lines.
    let e0 = edge_at(record, edge_count, 0u);
    let e1 = edge_at(record, edge_count, 1u);
    let e2 = edge_at(record, edge_count, 2u);
    let e3 = edge_at(record, edge_count, 3u);
    for (var i = 0u; i < count; i++) {
        let over = first + i >= params.line_count;
        let index = select(first + i, first + i - params.line_count, over);
        let line = line_at(index);
        var interval = vec2f(-HUGE, HUGE);
        interval = limited(interval, e0, line.c);
        interval = limited(interval, e1, line.c);
        interval = limited(interval, e2, line.c);
        interval = limited(interval, e3, line.c);
        for (var k = 4u; k < edge_count; k++) {
            interval = limited(interval, edge_at(record, edge_count, k), line.c);
        }
        if interval.x <= interval.y {
            let k0 = m.x * line.c.x + m.y * line.c.y;
            let base = line.place * params.sample_count;
            let end = min(first_above(interval.y), end_sample);
            for (var s = max(first_at_or_above(interval.x), first_sample); s < end; s++) {
                let w = weights(s);
                if chord < 0.0 || in_cap(axis, chord, vec3f(line.c * w.x, w.y)) {
                    offer(base + s, k0 * w.x + m.z * w.y, slot);
                }
            }
        }
    }
}
