// Shared by the stages that rasterize line grids. On each line a polygon covers one interval of samples, in closed
// form: e . s = w0 (A + B t) >= 0 with A = e.x c0 + e.y c1, B = e.z.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> records: array<u32>;
@group(0) @binding(3) var<storage, read> grid: array<u32>;
@group(0) @binding(4) var<storage, read> counted: array<u32>;
@group(0) @binding(6) var<uniform> short_grid: array<vec4u, SHORT_GRID>;

fn float_of(at: u32) -> f32 {
    return bitcast<f32>(records[at]);
}

fn vector_of(at: u32) -> vec3f {
    return vec3f(float_of(at), float_of(at + 1u), float_of(at + 2u));
}

fn edge_at(record: u32, edge_count: u32, k: u32) -> vec3f {
    // A zero edge excludes nothing.
    if k >= edge_count {
        return vec3f();
    }
    return vector_of(record + RECORD_WORDS + k * EDGE_WORDS);
}

// Clips an interval of positions by an edge. Both polygons of an edge compute the same bits here.
fn limited(interval: vec2f, e: vec3f, line: vec2f) -> vec2f {
    let a = e.x * line.x + e.y * line.y;
    // Short of HUGE, where a pole's ray is: no finite edge reaches it.
    let t = clamp(-a / e.z, -0.1 * HUGE, 0.1 * HUGE);
    let low = select(interval.x, max(interval.x, t), e.z > 0.0);
    let high = select(interval.y, min(interval.y, t), e.z < 0.0);
    return vec2f(select(low, HUGE, e.z == 0.0 && a < 0.0), high);
}

// True if a ray of the line frame is in a polygon's cap.
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
