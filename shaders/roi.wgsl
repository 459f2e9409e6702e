// Regions of interest, one invocation per feature: the linear case. Nonlinear features are flagged for the CPU, where
// src/features/roi is the twin, with the same names. Everything is in the image frame. An error is a column of a square
// root of a covariance, two vectors: of the sensor (negated), of the object about the feature's first point, of the
// ends.

const KIND: u32 = 6u;
// Maximum number of points of a feature, of events of a side, and of all events.
const POINTS: u32 = 16u;
const MAX_SIDE_POINTS: u32 = 3u;
const EVENTS: u32 = 12u;
const TAIL_CELLS: u32 = 64u;
const TAIL_COLUMNS: u32 = 66u;
const TAIL_ROWS: u32 = 73u;
const LINEAR: u32 = 1u;
const BEYOND: u32 = 2u;
const HALF_PI: f32 = 1.57079633;

struct RoiParams {
    // Pairs of the sensor's columns.
    sensor: array<vec4f, 12>,
    // Focal lengths, or columns and rows per radian.
    by: vec2f,
    // Columns and rows.
    size: vec2f,
    // Columns of a full turn, or 0.
    turn: f32,
    // Logarithm of the allowed probability outside the box; standard deviations where the search starts and ends.
    log_fail: f32,
    lowest: f32,
    first: f32,
    highest: f32,
    // Events this many deviations beyond the limit do not count.
    margin: f32,
    // Limits of nonlinearity: displacement as shares of the lever; error as a share of a side's distance, plus pixels.
    bent: f32,
    much: f32,
    slightly: f32,
    slight: f32,
    tail_steps: f32,
    feature_count: u32,
}

struct RoiFeature {
    // The first point relative to the origin of the object's frame.
    origin: vec3f,
    first_point: u32,
    points: u32,
    // Into `columns`: the object's columns, then the ends' columns.
    first_column: u32,
    object_columns: u32,
    columns: u32,
}

struct RoiPoint {
    p: vec3f,
    // Shares of the errors of the two ends.
    share: f32,
    at: vec2f,
    other_share: f32,
    // An upper bound of the standard deviation of its position.
    spread: f32,
}

struct RoiBox {
    bounds: vec4f,
    deviations: f32,
    flag: u32,
    padding: vec2u,
}

@group(0) @binding(0) var<uniform> params: RoiParams;
@group(0) @binding(1) var<storage, read> features: array<RoiFeature>;
@group(0) @binding(2) var<storage, read> points: array<RoiPoint>;
@group(0) @binding(3) var<storage, read> columns: array<vec4f>;
@group(0) @binding(4) var<storage, read> tails: array<f32>;
@group(0) @binding(5) var<storage, read_write> boxes: array<RoiBox>;

// The gradient of an image coordinate at a point, for the errors of each kind.
struct ImageGradient {
    g: vec3f,
    // Its moments about the sensor and about the feature's first point.
    about_sensor: vec3f,
    about_object: vec3f,
    shares: vec2f,
}

struct Event {
    point: u32,
    side: u32,
    deviations: f32,
    rate: f32,
    tail: f32,
    parent: u32,
    // Negative: no parent.
    apart: f32,
}

var<private> feature: RoiFeature;
var<private> sigmas: array<vec2f, POINTS>;
var<private> events: array<Event, EVENTS>;
var<private> event_count: u32;

// Sides: right, left, bottom, top.
fn sign_of(side: u32) -> f32 {
    return select(1.0, -1.0, (side & 1u) == 1u);
}

fn point_of(i: u32) -> RoiPoint {
    return points[feature.first_point + i];
}

fn lever_of(p: vec3f) -> f32 {
    return select(length(p.xy), p.z, GRID == CAMERA);
}

// Gradient of the column (c = 0) or the row (c = 1).
fn gradient(p: vec3f, c: u32) -> vec3f {
    if GRID == CAMERA {
        let inverse = 1.0 / p.z;
        if c == 0u {
            return params.by.x * inverse * vec3f(1.0, 0.0, -p.x * inverse);
        }
        return params.by.y * inverse * vec3f(0.0, 1.0, -p.y * inverse);
    }
    let flat = dot(p.xy, p.xy);
    if c == 0u {
        return params.by.x / flat * vec3f(-p.y, p.x, 0.0);
    }
    let length = sqrt(flat);
    return params.by.y / (flat + p.z * p.z) * vec3f(-p.z / length * p.xy, length);
}

fn gradient_at(i: u32, c: u32) -> ImageGradient {
    let point = point_of(i);
    let g = gradient(point.p, c);
    let d = point.p - point_of(0u).p;
    return ImageGradient(g, cross(point.p, g), cross(d, g), vec2f(point.share, point.other_share));
}

// Derivative with respect to an error.
fn slope(w: ImageGradient, i: u32) -> f32 {
    if i < KIND {
        return dot(params.sensor[2u * i].xyz, w.g) + dot(params.sensor[2u * i + 1u].xyz, w.about_sensor);
    }
    let at = 2u * (feature.first_column + i - KIND);
    let a = columns[at].xyz;
    let b = columns[at + 1u].xyz;
    if i - KIND < feature.object_columns {
        return dot(a, w.g) + dot(b, w.about_object);
    }
    return w.shares.x * dot(a, w.g) + w.shares.y * dot(b, w.g);
}

fn product(a: ImageGradient, b: ImageGradient) -> f32 {
    var sum = 0.0;
    for (var i = 0u; i < KIND + feature.columns; i++) {
        sum += slope(a, i) * slope(b, i);
    }
    return sum;
}

// Row of the tail table, and the fraction to the next row.
fn tail_row(x: f32) -> vec2f {
    let at = clamp(x * params.tail_steps, 0.0, f32(TAIL_ROWS - 1u));
    let i = min(floor(at), f32(TAIL_ROWS - 2u));
    return vec2f(i, at - i);
}

fn tail(x: f32) -> f32 {
    let row = tail_row(x);
    let i = u32(row.x) * TAIL_COLUMNS;
    return mix(tails[i], tails[i + TAIL_COLUMNS], row.y) * exp(-0.5 * x * x);
}

fn shared_tail(x: f32, apart: f32) -> f32 {
    let row = tail_row(x);
    let at = clamp(apart * f32(TAIL_CELLS), 0.0, f32(TAIL_CELLS));
    let j = min(floor(at), f32(TAIL_CELLS - 1u));
    let i = u32(row.x) * TAIL_COLUMNS + u32(j) + 1u;
    let below = mix(tails[i], tails[i + 1u], at - j);
    let above = mix(tails[i + TAIL_COLUMNS], tails[i + TAIL_COLUMNS + 1u], at - j);
    return mix(below, above, row.y);
}

fn reach(i: u32, side: u32, k: f32) -> f32 {
    let c = side / 2u;
    return sign_of(side) * point_of(i).at[c] + k * sigmas[i][c];
}

fn maker(side: u32, k: f32) -> u32 {
    var best = 0u;
    for (var i = 1u; i < feature.points; i++) {
        if reach(i, side, k) > reach(best, side, k) {
            best = i;
        }
    }
    return best;
}

// For each side, the outermost point and other points almost as likely to cross it.
fn choose_events(k: f32) {
    event_count = 0u;
    for (var side = 0u; side < 4u; side++) {
        let c = side / 2u;
        let first = event_count;
        let best = maker(side, k);
        let limit = reach(best, side, k);
        var at = best;
        loop {
            let deviations = (limit - sign_of(side) * point_of(at).at[c]) / sigmas[at][c];
            if !(sigmas[at][c] > 0.0 && deviations < k + params.margin) {
                break;
            }
            let along = gradient_at(at, c);
            var known = false;
            for (var e = first; e < event_count; e++) {
                let other = events[e].point;
                // Fully correlated points (to f32 precision) are merged.
                known |= product(along, gradient_at(other, c)) > (1.0 - 2e-6) * sigmas[at][c] * sigmas[other][c];
            }
            if !known {
                let rate = sigmas[best][c] / sigmas[at][c];
                events[event_count] = Event(at, side, deviations, rate, tail(deviations), 0u, -1.0);
                event_count++;
            }
            if event_count == first + MAX_SIDE_POINTS {
                break;
            }
            // The next point, by deviations and then by number.
            var next = POINTS;
            var next_deviations = 0.0;
            for (var i = 0u; i < feature.points; i++) {
                if i == best || !(sigmas[i][c] > 0.0) {
                    continue;
                }
                let here = (limit - sign_of(side) * point_of(i).at[c]) / sigmas[i][c];
                let after = at == best || here > deviations || here == deviations && i > at;
                if after && (next == POINTS || here < next_deviations) {
                    next = i;
                    next_deviations = here;
                }
            }
            if next == POINTS {
                break;
            }
            at = next;
        }
    }
}

// The spanning tree with the greatest joint tails.
fn join_events() {
    var best: array<f32, EVENTS>;
    var out: array<bool, EVENTS>;
    for (var i = 0u; i < event_count; i++) {
        best[i] = -1.0;
        out[i] = true;
    }
    var last = 0u;
    for (var n = 1u; n < event_count; n++) {
        out[last] = false;
        let b = events[last];
        let along = gradient_at(b.point, b.side / 2u);
        let b_sigma = sigmas[b.point][b.side / 2u];
        var next = EVENTS;
        for (var i = 0u; i < event_count; i++) {
            if !out[i] {
                continue;
            }
            let a = events[i];
            let sigma = sigmas[a.point][a.side / 2u] * b_sigma;
            let rho = sign_of(a.side) * sign_of(b.side) * product(gradient_at(a.point, a.side / 2u), along) / sigma;
            if rho > 0.0 {
                let apart = sqrt(max(1.0 - rho, 0.0) / (1.0 + rho));
                let a_is_far = a.deviations > b.deviations;
                let joint = select(b.tail, a.tail, a_is_far) * shared_tail(max(a.deviations, b.deviations), apart);
                if joint > best[i] {
                    best[i] = joint;
                    events[i].parent = last;
                    events[i].apart = apart;
                }
            }
            if next == EVENTS || best[i] > best[next] {
                next = i;
            }
        }
        last = next;
    }
}

// Upper bound of the probability that any side is crossed, with all limits `more` standard deviations farther out.
fn passed(more: f32) -> f32 {
    var sum = 0.0;
    for (var i = 0u; i < event_count; i++) {
        let e = events[i];
        let deviations = max(e.deviations + more * e.rate, 0.0);
        sum += tail(deviations);
        if e.apart >= 0.0 {
            let parent = events[e.parent];
            let far = max(deviations, parent.deviations + more * parent.rate);
            sum -= tail(far) * shared_tail(far, e.apart);
        }
    }
    return max(sum, 1e-37);
}

fn common_deviation() -> f32 {
    let first = params.first;
    choose_events(first);
    if event_count == 0u {
        return params.lowest;
    }
    join_events();
    let before = log(passed(0.0)) - params.log_fail;
    let hazard = 0.39894228 * exp(-0.5 * first * first) / tail(first);
    let k = clamp(first + before / hazard, params.lowest, params.highest);
    let step = k - first;
    if abs(step) < 1e-4 {
        return k;
    }
    let after = log(passed(step)) - params.log_fail;
    let along = (after - before) / step;
    return clamp(select(k, k - after / along, along < -0.1), params.lowest, params.highest);
}

// Exp(turn) v - v - turn x v.
fn turned_beyond(turn: vec3f, v: vec3f) -> vec3f {
    let square = dot(turn, turn);
    let sine = -square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0)));
    let versine = 0.5 - square / 24.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0 * (1.0 - square / 90.0)));
    let across = cross(turn, v);
    return sine * across + versine * cross(turn, across);
}

// The angle with this sine and cosine, within a right angle of 0, to 2e-7 (atan2 may be off by 4096 ulp).
fn angle(sine: f32, cosine: f32) -> f32 {
    let steep = abs(sine) > cosine;
    let x = select(sine / cosine, cosine / sine, steep);
    let s = x * x;
    // Abramowitz and Stegun 4.4.49.
    let series = x * (1.0 + s * (-0.3333314528 + s * (0.1999355085 + s * (-0.1420889944 + s * (0.1065626393
        + s * (-0.0752896400 + s * (0.0429096138 + s * (-0.0161657367 + s * 0.0028662257))))))));
    return select(series, sign(sine) * HALF_PI - series, steep);
}

// Displacement of the image when the point moves, without cancellation.
fn image_moves(p: vec3f, by: vec3f) -> vec2f {
    if GRID == CAMERA {
        return params.by * (by.xy - p.xy / p.z * by.z) / (p.z + by.z);
    }
    let there = p + by;
    let turn = angle(p.x * by.y - p.y * by.x, dot(p.xy, there.xy));
    let before = length(p.xy);
    let after = length(there.xy);
    let longer = dot(by.xy, p.xy + there.xy) / (before + after);
    let rise = angle(before * by.z - p.z * longer, before * after + p.z * there.z);
    return params.by * vec2f(turn, rise);
}

// Error of the linear image position of a side's outermost point, under the most likely error that reaches the side.
fn bend(i: u32, side: u32, k: f32) -> vec2f {
    let c = side / 2u;
    let point = point_of(i);
    let gradients = array<ImageGradient, 2>(gradient_at(i, 0u), gradient_at(i, 1u));
    let scale = sign_of(side) * k / sigmas[i][c];
    var own = vec3f();
    var object_shift = vec3f();
    var object_turn = vec3f();
    var sensor_shift = vec3f();
    var sensor_turn = vec3f();
    var linear = vec2f();
    for (var e = 0u; e < KIND + feature.columns; e++) {
        let slopes = vec2f(slope(gradients[0], e), slope(gradients[1], e));
        let xi = scale * slopes[c];
        linear += xi * slopes;
        if e < KIND {
            sensor_shift += xi * params.sensor[2u * e].xyz;
            sensor_turn += xi * params.sensor[2u * e + 1u].xyz;
            continue;
        }
        let at = 2u * (feature.first_column + e - KIND);
        if e - KIND < feature.object_columns {
            object_shift += xi * columns[at].xyz;
            object_turn += xi * columns[at + 1u].xyz;
        } else {
            own += xi * (point.share * columns[at].xyz + point.other_share * columns[at + 1u].xyz);
        }
    }
    // Relative to the first point, which avoids a difference of large numbers for a far origin.
    let d = point.p - point_of(0u).p + own;
    let object = object_shift + cross(object_turn, d) + turned_beyond(object_turn, feature.origin + d);
    let shift = own + object + sensor_shift;
    let moved = shift + cross(sensor_turn, point.p + shift) + turned_beyond(sensor_turn, point.p + shift);
    return image_moves(point.p, moved) - linear;
}

// Left, top, right, bottom, clipped to the image, at least one pixel wide; right may exceed the seam of a full circle.
fn clipped(b: vec4f) -> vec4f {
    let short = 0.5 * max(vec2f(1.0) - (b.zw - b.xy), vec2f());
    let low = b.xy - short;
    let high = b.zw + short;
    let least = clamp(low, vec2f(-0.5), params.size - 1.5);
    let most = clamp(high, vec2f(0.5), params.size - 0.5);
    var x = vec2f(least.x, most.x);
    if params.turn > 0.0 {
        let back = params.turn * floor((low.x + 0.5) / params.turn);
        x = vec2f(low.x, high.x) - back;
        if b.z - b.x >= params.turn {
            x = vec2f(-0.5, params.size.x - 0.5);
        }
    }
    return vec4f(x.x, least.y, x.y, most.y);
}

fn found() -> RoiBox {
    for (var i = 0u; i < feature.points; i++) {
        let u = gradient_at(i, 0u);
        let v = gradient_at(i, 1u);
        sigmas[i] = sqrt(vec2f(product(u, u), product(v, v)));
    }
    let k = common_deviation();
    var near = true;
    for (var i = 0u; i < feature.points; i++) {
        let point = point_of(i);
        let lever = lever_of(point.p);
        if !(k * point.spread <= params.much * lever) {
            return RoiBox(vec4f(), k, BEYOND, vec2u());
        }
        near &= k * point.spread <= params.bent * lever;
    }
    // Right, left, bottom, top, each positive outward.
    var limits: array<f32, 4>;
    var widen = array<f32, 4>();
    for (var side = 0u; side < 4u; side++) {
        let i = maker(side, k);
        limits[side] = reach(i, side, k);
        let sigma = sigmas[i][side / 2u];
        if near || !(sigma > 0.0) {
            continue;
        }
        let off = bend(i, side, k);
        if !all(abs(off) <= params.slightly * k * sigmas[i] + params.slight) {
            return RoiBox(vec4f(), k, BEYOND, vec2u());
        }
        for (var s = 0u; s < 4u; s++) {
            widen[s] = max(widen[s], sign_of(s) * off[s / 2u]);
        }
    }
    let right = limits[0] + widen[0];
    let left = -limits[1] - widen[1];
    let bottom = limits[2] + widen[2];
    let top = -limits[3] - widen[3];
    return RoiBox(clipped(vec4f(left, top, right, bottom)), k, LINEAR, vec2u());
}

@compute @workgroup_size(64)
fn roi(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let index = (group.y * groups.x + group.x) * GROUP + lane;
    if index >= params.feature_count {
        return;
    }
    feature = features[index];
    boxes[index] = found();
}
