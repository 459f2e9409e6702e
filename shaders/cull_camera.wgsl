// Bounds of a polygon in a pinhole image.

struct Bounds {
    // Lines (y) and samples (x) in pixels from the principal point; valid only if all vertices are in front.
    lines: vec2f,
    samples: vec2f,
    all_in_front: bool,
    // Maximum signed distance of a vertex inside each side of the frustum: left, right, top, bottom.
    inside: vec4f,
    in_front: f32,
    // Minimum depth of a vertex, reduced by its rounding.
    nearest: f32,
}

fn bounds_start() -> Bounds {
    return Bounds(vec2f(HUGE, -HUGE), vec2f(HUGE, -HUGE), true, vec4f(-1.0), -1.0, HUGE);
}

fn bounds_add(b: ptr<function, Bounds>, v: vec3f, previous: vec3f, first: bool) {
    let x = params.fx * v.x;
    let y = params.fy * v.y;
    let reach = abs(v.x) + abs(v.y) + abs(v.z);
    // Rounding error, metres times focal length.
    let slack = 1.0e-6 * (params.fx + params.fy) * reach;
    (*b).inside = max((*b).inside, slack + vec4f(
        x - params.first_sample * v.z,
        params.last_sample * v.z - x,
        y - params.first_line * v.z,
        params.last_line * v.z - y,
    ));
    (*b).in_front = max((*b).in_front, v.z);
    (*b).nearest = min((*b).nearest, v.z - 1.0e-6 * reach);
    // Vertices within 1 : 1000 of the image plane make the bounds too loose; the frustum test handles them.
    (*b).all_in_front = (*b).all_in_front && v.z > 1.0e-3 * reach;
    let w = 1.0 / v.z;
    let pad = slack * w * (reach * w);
    (*b).samples = vec2f(min((*b).samples.x, x * w - pad), max((*b).samples.y, x * w + pad));
    (*b).lines = vec2f(min((*b).lines.x, y * w - pad), max((*b).lines.y, y * w + pad));
}

fn bounds_close(b: ptr<function, Bounds>, start: vec3f, previous: vec3f) {}

fn bounds_of_box(b: ptr<function, Bounds>) {}

fn bounds_reach(b: Bounds) -> Reach {
    if b.in_front <= 0.0 || any(b.inside < vec4f()) {
        return no_reach();
    }
    if !b.all_in_front {
        return whole_reach();
    }
    let samples = clamp(vec2f(ceil(b.samples.x - params.first_sample), floor(b.samples.y - params.first_sample)),
        vec2f(-1.0), vec2f(f32(params.sample_count)));
    let lines = clamp(vec2f(ceil(b.lines.x - params.first_line), floor(b.lines.y - params.first_line)),
        vec2f(-1.0), vec2f(f32(params.line_count)));
    let first = max(lines.x, 0.0);
    let last = min(lines.y, f32(params.line_count) - 1.0);
    let left = max(samples.x, 0.0);
    let right = min(samples.y, f32(params.sample_count) - 1.0);
    // Between pixel centres, or outside the image.
    if first > last || left > right {
        return no_reach();
    }
    return Reach(u32(first), u32(last - first) + 1u, u32(left), u32(right - left) + 1u, b.nearest);
}
