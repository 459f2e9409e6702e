// Stage 3 for ray tables: one invocation per polygon and box of pixels. Tests the cones of tiles, then their rays.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> records: array<u32>;
@group(0) @binding(2) var<storage, read> items: array<u32>;
@group(0) @binding(3) var<storage, read> grid: array<u32>;
@group(0) @binding(4) var<storage, read> counted: array<u32>;


@compute @workgroup_size(64)
fn raster(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let count = min(counted[COUNTED_ITEMS], params.item_room);
    for (var i = first_of(counted[COUNTED_ITEMS_BEFORE]) + id.x; i < count; i += groups.x * GROUP) {
        let at = i * ITEM_WORDS;
        let part = items[at + ITEM_PART];
        let within = items[at + ITEM_WITHIN];
        box(
            polygon_at(items[at + ITEM_RECORD]), vec2u(part >> 16u, part & 0xffffu),
            vec2u(within >> 16u, within & 0xffffu));
    }
}

fn float_of(at: u32) -> f32 {
    return bitcast<f32>(records[at]);
}

fn vector_of(at: u32) -> vec3f {
    return vec3f(float_of(at), float_of(at + 1u), float_of(at + 2u));
}

// A record in registers, except edges after the fourth: most polygons have at most four.
struct Polygon {
    m: vec3f,
    slot: u32,
    axis: vec3f,
    // Squared chord of the polygon's cap; negative without a cap.
    chord: f32,
    e0: vec3f,
    e1: vec3f,
    e2: vec3f,
    e3: vec3f,
    edge_count: u32,
    edges_at: u32,
}

fn polygon_at(record: u32) -> Polygon {
    let edge_count = records[record + RECORD_EDGE_COUNT];
    return Polygon(
        vector_of(record + RECORD_M),
        records[record + RECORD_SLOT],
        vector_of(record + RECORD_CAP_AXIS),
        float_of(record + RECORD_CAP_CHORD),
        edge_at(record, edge_count, 0u),
        edge_at(record, edge_count, 1u),
        edge_at(record, edge_count, 2u),
        edge_at(record, edge_count, 3u),
        edge_count,
        record + RECORD_WORDS,
    );
}

fn edge_at(record: u32, edge_count: u32, k: u32) -> vec3f {
    // A zero edge excludes nothing.
    if k >= edge_count {
        return vec3f();
    }
    return vector_of(record + RECORD_WORDS + k * EDGE_WORDS);
}

// Draws columns and rows from `first` to before `end`: all rays of a small box, else by tiles.
fn box(p: Polygon, first: vec2u, end: vec2u) {
    let few = (end.x - first.x) * (end.y - first.y) <= RAYS_PER_BOX;
    // A single tile that contains the whole small box.
    let side = select(RAYS_PER_TILE, 0x10000u, few);
    let begin = first / side;
    let last = (end - 1u) / side;
    let chord = cap_chord(p.chord);
    let columns = last.x - begin.x + 1u;
    // First find the tiles (32 at most), then draw them in turn, so that neighbouring invocations draw together.
    var met = select(0u, 1u, few);
    for (var row = begin.y; !few && row <= last.y; row++) {
        for (var column = begin.x; column <= last.x; column++) {
            let cone = cone_at(params.tiles_at + (row * params.tile_columns + column) * 4u);
            let beside =
                is_beside(p.e0, cone) || is_beside(p.e1, cone) || is_beside(p.e2, cone) || is_beside(p.e3, cone);
            let meets = cap_meets(p.axis, chord, cone) && !beside && !is_behind(p.m, cone, 0u, row, column);
            met |= select(0u, 1u, meets) << ((row - begin.y) * columns + column - begin.x);
        }
    }
    while met != 0u {
        let bit = firstTrailingBit(met);
        let corner = (begin + vec2u(bit % columns, bit / columns)) * side;
        pixels(p, max(first, corner), min(end, corner + side));
        met &= met - 1u;
    }
}

// Draws columns and rows from `first` to before `end`, inside the polygon's cap only. Towards the vanishing point of a
// sliver's long sides all edge planes intersect, and their f32 roundings may contain rays far from the polygon.
fn pixels(p: Polygon, first: vec2u, end: vec2u) {
    for (var row = first.y; row < end.y; row++) {
        for (var column = first.x; column < end.x; column++) {
            let pixel = row * params.width + column;
            let at = params.rays_at + pixel * 3u;
            // A missing ray is stored as zero, so its inverse range is zero.
            let ray = vec3f(bitcast<f32>(grid[at]), bitcast<f32>(grid[at + 1u]), bitcast<f32>(grid[at + 2u]));
            let k = dot(p.m, ray);
            let apart = ray - p.axis;
            var inside = k > 0.0 && (p.chord < 0.0 || dot(apart, apart) <= p.chord)
                && dot(p.e0, ray) >= 0.0 && dot(p.e1, ray) >= 0.0 && dot(p.e2, ray) >= 0.0 && dot(p.e3, ray) >= 0.0;
            for (var e = 4u; inside && e < p.edge_count; e++) {
                let at = p.edges_at + e * EDGE_WORDS;
                inside = dot(vector_of(at), ray) >= 0.0;
            }
            if inside {
                offer(pixel, k, p.slot);
            }
        }
    }
}
