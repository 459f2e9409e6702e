// Bounds of a polygon in a scanner's image: azimuths as diamond angles, elevations as t = -tan(elevation).

struct Bounds {
    // Horizontal direction of the first vertex; angles below are relative to it.
    start: vec2f,
    turn: vec2f,
    least: vec2f,
    greatest: vec2f,
    t: vec2f,
    // Minimum ratio of horizontal to full distance of a vertex, squared: small near the poles.
    flatness: f32,
    z: vec2f,
    // The box around the vertices, and their greatest squared distance.
    low: vec3f,
    high: vec3f,
    farthest2: f32,
}

fn bounds_start() -> Bounds {
    return Bounds(vec2f(), vec2f(), vec2f(), vec2f(), vec2f(HUGE, -HUGE), 1.0, vec2f(HUGE, -HUGE),
        vec3f(HUGE), vec3f(-HUGE), 0.0);
}

fn bounds_add(b: ptr<function, Bounds>, v: vec3f, previous: vec3f, first: bool) {
    let h2 = dot(v.xy, v.xy);
    (*b).flatness = min((*b).flatness, h2 / dot(v, v));
    (*b).z = vec2f(min((*b).z.x, -v.z), max((*b).z.y, -v.z));
    (*b).low = min((*b).low, v);
    (*b).high = max((*b).high, v);
    (*b).farthest2 = max((*b).farthest2, dot(v, v));
    if first {
        (*b).start = v.xy;
        (*b).least = v.xy;
        (*b).greatest = v.xy;
        return;
    }
    let s = (*b).start;
    let relative = diamond(vec2f(dot(s, v.xy), s.x * v.y - s.y * v.x));
    if relative < (*b).turn.x {
        (*b).turn.x = relative;
        (*b).least = v.xy;
    }
    if relative > (*b).turn.y {
        (*b).turn.y = relative;
        (*b).greatest = v.xy;
    }
    bounds_edge(b, v, previous);
}

fn bounds_close(b: ptr<function, Bounds>, start: vec3f, previous: vec3f) {
    bounds_edge(b, start, previous);
}

// Finishes the bounds of a box, whose corners come in any order: its faces and edges lie between these bounds.
fn bounds_of_box(b: ptr<function, Bounds>) {
    let beside = max(max((*b).low.xy, -(*b).high.xy), vec2f());
    let near = inverseSqrt(max(dot(beside, beside), 1.0e-37));
    let far = inverseSqrt(max((*b).farthest2, 1.0e-37));
    (*b).t.y = max((*b).t.y, (*b).z.y * select(far, near, (*b).z.y > 0.0));
    (*b).t.x = min((*b).t.x, (*b).z.x * select(near, far, (*b).z.x > 0.0));
    (*b).flatness = min((*b).flatness, dot(beside, beside) * far * far);
}

// A lower bound of the distance; 0 if the outline may enclose the vertical axis.
fn nearest_of(b: Bounds, around: bool) -> f32 {
    let beside = max(max(b.low, -b.high), vec3f());
    return select(length(beside) - 2.0e-6 * sqrt(b.farthest2), 0.0, around);
}

fn bounds_edge(b: ptr<function, Bounds>, v: vec3f, previous: vec3f) {
    // Bounds of t = z / h along an edge: z is linear, and h is least at the foot of the perpendicular.
    let d = v.xy - previous.xy;
    let foot = previous.xy + d * clamp(-dot(previous.xy, d) / max(dot(d, d), 1.0e-37), 0.0, 1.0);
    let near = inverseSqrt(max(dot(foot, foot), 1.0e-37));
    let far = inverseSqrt(max(max(dot(v.xy, v.xy), dot(previous.xy, previous.xy)), 1.0e-37));
    let high = -min(v.z, previous.z);
    let low = -max(v.z, previous.z);
    (*b).t.y = max((*b).t.y, high * select(far, near, high > 0.0));
    (*b).t.x = min((*b).t.x, low * select(near, far, low > 0.0));
}

fn bounds_reach(b: Bounds) -> Reach {
    // Within 0.06 deg of a pole, or half a turn wide: the outline may enclose the vertical axis.
    let around = !(b.flatness > 1.0e-6) || b.turn.y - b.turn.x > 1.999;
    var t = b.t;
    if around {
        t = vec2f(select(t.x, -HUGE, !(b.z.x > 0.0)), select(t.y, HUGE, !(b.z.y < 0.0)));
    }
    // Rounding error: 2^-23 of the distance, projected on the elevation.
    let pad = 2.0e-6 * (vec2f(1.0) + min(abs(t), vec2f(1.0e15)) * min(abs(t), vec2f(1.0e15)));
    let first_sample = first_at_or_above(t.x - pad.x);
    let end_sample = first_above(t.y + pad.y);
    if first_sample >= end_sample {
        return no_reach();
    }
    if around {
        return Reach(0u, params.line_count, first_sample, end_sample - first_sample, 0.0);
    }
    let turn_pad = 4.0e-6 + 1.0e-6 * inverseSqrt(b.flatness);
    let low = diamond(b.least) - turn_pad;
    var high = diamond(b.greatest) + turn_pad;
    high = select(high, high + 4.0, high < low);
    let first = line_at_or_above(low);
    let end = line_above(high);
    if end <= first {
        return no_reach();
    }
    let n = i32(params.line_count);
    return Reach(
        u32((first + n) % n), u32(min(end - first, n)), first_sample, end_sample - first_sample, nearest_of(b, around));
}

// The first line whose bucket is at or above the angle; angles outside -2..2 wrap around.
fn line_at_or_above(angle: f32) -> i32 {
    let n = i32(params.line_count);
    let turns = select(select(0, -1, angle < -2.0), 1, angle >= 2.0);
    let b = bucket(angle - 4.0 * f32(turns), -2.0, 0.25 * f32(params.line_buckets), params.line_buckets);
    return i32(grid_word(params.line_buckets_at + b)) + turns * n;
}

// One past the last line whose bucket is at or below the angle.
fn line_above(angle: f32) -> i32 {
    let n = i32(params.line_count);
    let turns = select(select(0, -1, angle < -2.0), 1, angle >= 2.0);
    let b = bucket(angle - 4.0 * f32(turns), -2.0, 0.25 * f32(params.line_buckets), params.line_buckets);
    return i32(grid_word(params.line_buckets_at + b + 1u)) + turns * n;
}
