// Stage 3 for line grids: one invocation per item. On every line a polygon covers one interval of samples, known in
// closed form: e . s = w0 (A + B t) >= 0 with A = e.x c0 + e.y c1, B = e.z.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> records: array<u32>;
@group(0) @binding(2) var<storage, read> items: array<u32>;
@group(0) @binding(3) var<storage, read> grid: array<u32>;
@group(0) @binding(4) var<storage, read> counted: array<u32>;
@group(0) @binding(6) var<uniform> short_grid: array<vec4u, SHORT_GRID>;

@compute @workgroup_size(64)
fn raster(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    // No more than fit were written.
    let count = min(counted[COUNTED_ITEMS], params.item_room);
    for (var i = first_item() + id.x; i < count; i += groups.x * GROUP) {
        let part = items[i * ITEM_WORDS + ITEM_PART];
        let within = items[i * ITEM_WORDS + ITEM_WITHIN];
        rasterize(items[i * ITEM_WORDS + ITEM_RECORD], part & 0xffffu, part >> 16u, within & 0xffffu, within >> 16u);
    }
}

fn float_of(at: u32) -> f32 {
    return bitcast<f32>(records[at]);
}

fn vector_of(at: u32) -> vec3f {
    return vec3f(float_of(at), float_of(at + 1u), float_of(at + 2u));
}

fn edge_at(record: u32, edge_count: u32, k: u32) -> vec3f {
    // What is not there limits nothing.
    if k >= edge_count {
        return vec3f();
    }
    return vector_of(record + RECORD_WORDS + k * EDGE_WORDS);
}

// The positions that an edge leaves of an interval. Both owners of an edge compute the same bits here.
fn limited(interval: vec2f, e: vec3f, line: vec2f) -> vec2f {
    let a = e.x * line.x + e.y * line.y;
    let t = clamp(-a / e.z, -1.0e38, 1.0e38);
    let low = select(interval.x, max(interval.x, t), e.z > 0.0);
    let high = select(interval.y, min(interval.y, t), e.z < 0.0);
    return vec2f(select(low, HUGE, e.z == 0.0 && a < 0.0), high);
}

fn rasterize(record: u32, first: u32, count: u32, first_sample: u32, end_sample: u32) {
    let m = vector_of(record + RECORD_M);
    let slot = records[record + RECORD_SLOT];
    let edge_count = records[record + RECORD_EDGE_COUNT];
    let axis = vector_of(record + RECORD_CAP_AXIS);
    let chord = float_of(record + RECORD_CAP_CHORD);
    // Most polygons have no more than four edges: these stay in registers over all lines.
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

// True if a ray of the line frame meets the cap around a polygon.
fn in_cap(axis: vec3f, chord: f32, ray: vec3f) -> bool {
    var u = vec3f(ray.x, ray.y, -ray.z);
    if GRID == CAMERA {
        u = normalize(vec3f(ray.z / params.fx, ray.x / params.fy, ray.y));
    }
    let apart = u - axis;
    return dot(apart, apart) <= chord;
}

fn weights(s: u32) -> vec2f {
    if GRID == CAMERA {
        return vec2f(1.0, params.first_sample + f32(s));
    }
    let at = params.weights_at + s * 2u;
    return vec2f(grid_float(at), grid_float(at + 1u));
}
