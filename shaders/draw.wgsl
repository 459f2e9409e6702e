// Stage 3 for pinhole cameras with the hardware rasterizer: draws the shapes of a wave's survivors. A shape covers more
// than its polygon; the fragments test pixels and compute keys exactly as raster_lines.wgsl does.

@group(0) @binding(2) var<storage, read> survivors: array<Survivor>;

struct Corner {
    @builtin(position) position: vec4f,
    @location(0) @interpolate(flat, either) record: u32,
}

@vertex
fn corner(@builtin(vertex_index) vertex: u32) -> Corner {
    let index = first_of(counted[COUNTED_SURVIVORS_BEFORE]) + vertex / SHAPE_VERTICES;
    let record = survivors[index].record;
    if record == NO_RECORD {
        // Outside the image.
        return Corner(vec4f(2.0, 2.0, 0.0, 1.0), record);
    }
    let along = survivors[index].direction;
    let least = survivors[index].least;
    let greatest = survivors[index].greatest;
    // Corners 0 1 2, 2 1 3: the first bit selects along, the second across.
    let number = (0x312210u >> (4u * (vertex % SHAPE_VERTICES))) & 3u;
    let at = select(least, greatest, vec2<bool>((number & 1u) != 0u, (number & 2u) != 0u));
    let pixel = at.x * along + at.y * vec2f(-along.y, along.x);
    let size = vec2f(f32(params.width), f32(params.height));
    return Corner(vec4f((2.0 * pixel - size) / size * vec2f(1.0, -1.0), 0.0, 1.0), record);
}

@fragment
fn draw(in: Corner) {
    let line = line_at(u32(in.position.y));
    let s = u32(in.position.x);
    let edge_count = records[in.record + RECORD_EDGE_COUNT];
    var interval = vec2f(-HUGE, HUGE);
    for (var k = 0u; k < edge_count; k++) {
        interval = limited(interval, edge_at(in.record, edge_count, k), line.c);
    }
    if interval.x <= interval.y && s >= first_at_or_above(interval.x) && s < first_above(interval.y) {
        draw_sample(in.record, line, s);
    }
}

fn draw_sample(record: u32, line: Line, s: u32) {
    let m = vector_of(record + RECORD_M);
    let chord = float_of(record + RECORD_CAP_CHORD);
    let w = weights(s);
    if chord < 0.0 || in_cap(vector_of(record + RECORD_CAP_AXIS), chord, vec3f(line.c * w.x, w.y)) {
        let k0 = m.x * line.c.x + m.y * line.c.y;
        offer(line.place * params.sample_count + s, k0 * w.x + m.z * w.y, records[record + RECORD_SLOT]);
    }
}
