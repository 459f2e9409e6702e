// Stage 3 for line grids: one invocation per item. On every line a polygon covers one interval of samples, known in
// closed form: e . s = w0 (A + B t) >= 0 with A = e.x c0 + e.y c1, B = e.z.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> records: array<u32>;
@group(0) @binding(2) var<storage, read> items: array<u32>;
@group(0) @binding(3) var<storage, read> grid: array<u32>;
@group(0) @binding(4) var<storage, read> counted: array<u32>;

@compute @workgroup_size(64)
fn raster(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    // Word 2 of Counters: items. No more than fit were written.
    let count = min(counted[2], params.item_room);
    for (var i = id.x; i < count; i += groups.x * GROUP) {
        let what = items[i * ITEM_WORDS + 1u];
        rasterize(items[i * ITEM_WORDS], what & 0xffffu, what >> 16u);
    }
}

fn float_of(at: u32) -> f32 {
    return bitcast<f32>(records[at]);
}

fn rasterize(record: u32, first: u32, count: u32) {
    let m = vec3f(float_of(record), float_of(record + 1u), float_of(record + 2u));
    let slot = records[record + 6u];
    let edge_count = records[record + 7u];
    let edges = record + RECORD_WORDS;
    for (var i = 0u; i < count; i++) {
        let over = first + i >= params.line_count;
        let line = select(first + i, first + i - params.line_count, over);
        let at = params.lines_at + line * 3u;
        let c0 = bitcast<f32>(grid[at]);
        let c1 = bitcast<f32>(grid[at + 1u]);
        var low = -HUGE;
        var high = HUGE;
        for (var k = 0u; k < edge_count; k++) {
            let e = edges + k * EDGE_WORDS;
            let a = float_of(e) * c0 + float_of(e + 1u) * c1;
            let b = float_of(e + 2u);
            // Both owners of an edge compute the same bits here.
            let t = clamp(-a / b, -1.0e38, 1.0e38);
            low = select(low, max(low, t), b > 0.0);
            high = select(high, min(high, t), b < 0.0);
            low = select(low, HUGE, b == 0.0 && a < 0.0);
        }
        if low <= high {
            let k0 = m.x * c0 + m.y * c1;
            let base = grid[at + 2u] * params.sample_count;
            let end = first_above(high);
            for (var s = first_at_or_above(low); s < end; s++) {
                let w = params.weights_at + s * 2u;
                let k = k0 * bitcast<f32>(grid[w]) + m.z * bitcast<f32>(grid[w + 1u]);
                offer(base + s, k, slot);
            }
        }
    }
}
