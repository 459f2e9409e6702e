// Stage 4: one invocation per pixel, row-major. Computes the requested images from the winning slot.

override RANGE: bool = false;
override DEPTH: bool = false;
override POLYGON: bool = false;
override OBJECT: bool = false;
override COSINE: bool = false;
// Record which slots are shown.
override SHOWN: bool = false;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> keys: array<vec2u>;
@group(0) @binding(2) var<storage, read> seen_slots: array<u32>;
@group(0) @binding(3) var<storage, read> grid: array<u32>;
@group(0) @binding(4) var<storage, read_write> outputs: array<u32>;
@group(0) @binding(5) var<storage, read_write> counters: Counters;
@group(0) @binding(6) var<storage, read_write> shown: array<atomic<u32>>;

// Bit patterns: WGSL has no literals for these.
const PLUS_INFINITY: u32 = 0x7f800000u;
const MINUS_INFINITY: u32 = 0xff800000u;
const NAN: u32 = 0x7fc00000u;

struct Pixel {
    range: u32,
    depth: u32,
    polygon: u32,
    object: u32,
    cosine: u32,
}

@compute @workgroup_size(64)
fn resolve(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let index = (group.y * groups.x + group.x) * GROUP + lane;
    if index >= params.width * params.height {
        return;
    }
    let pixel = resolved(index % params.width, index / params.width, index);
    if RANGE {
        outputs[params.range_at + index] = pixel.range;
    }
    if DEPTH {
        outputs[params.depth_at + index] = pixel.depth;
    }
    if POLYGON {
        outputs[params.polygon_at + index] = pixel.polygon;
    }
    if OBJECT {
        outputs[params.object_at + index] = pixel.object;
    }
    if COSINE {
        outputs[params.cos_at + index] = pixel.cosine;
    }
}

// Length of the ray whose inverse depth was rasterized, and its depth per unit of inverse depth.
struct Scale {
    ray: f32,
    depth: f32,
    none: bool,
}

fn scale_of(column: u32, row: u32, index: u32) -> Scale {
    if GRID == CAMERA {
        let x = (params.first_sample + f32(column)) / params.fx;
        let y = (params.first_line + f32(row)) / params.fy;
        return Scale(sqrt(1.0 + x * x + y * y), 1.0, false);
    }
    if GRID == RAYS {
        let at = params.rays_at + index * 3u;
        let ray = vec3f(bitcast<f32>(grid[at]), bitcast<f32>(grid[at + 1u]), bitcast<f32>(grid[at + 2u]));
        return Scale(1.0, ray.z, dot(ray, ray) == 0.0);
    }
    return Scale(1.0, 0.0, false);
}

// Neighbouring pixels usually show the same slot, so the load saves atomics.
fn note(slot: u32) {
    let bit = 1u << (slot & 31u);
    if (atomicLoad(&shown[slot >> 5u]) & bit) == 0u {
        atomicOr(&shown[slot >> 5u], bit);
    }
}

fn resolved(column: u32, row: u32, index: u32) -> Pixel {
    let scale = scale_of(column, row, index);
    if scale.none {
        return Pixel(NAN, NAN, 0u, 0u, NAN);
    }
    let nothing = Pixel(PLUS_INFINITY, PLUS_INFINITY, 0u, 0u, NAN);
    let key = keys[select(index, column * params.height + row, GRID == SCANNER)];
    if key.y == 0u {
        return nothing;
    }
    if key.x == 0u {
        atomicAdd(&counters.lost_ids, 1u);
        return nothing;
    }
    let k = bitcast<f32>(key.y);
    let range = scale.ray / k;
    if range > params.range_max {
        return nothing;
    }
    let slot = ~key.x;
    if SHOWN {
        note(slot);
    }
    let seen = slot * SLOT_WORDS;
    let cosine = min(1.0, k * bitcast<f32>(seen_slots[seen + SLOT_DISTANCE]) / scale.ray);
    var id = slot + 1u;
    if params.source_ids != 0u {
        id = seen_slots[seen + SLOT_SOURCE];
    }
    let below = range < params.range_min;
    return Pixel(
        select(bitcast<u32>(range), MINUS_INFINITY, below),
        select(bitcast<u32>(scale.depth / k), MINUS_INFINITY, below),
        id,
        seen_slots[seen + SLOT_OBJECT],
        bitcast<u32>(cosine),
    );
}
