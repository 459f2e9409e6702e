// Bounds of a polygon in a ray table. Small polygons are bounded by quadratics (pixel_fit.wgsl), others in wide views
// by the direction map (direction_map.wgsl). Polygons that neither can bound are bounded by `ahead_at` if all rays look
// ahead; else they may cover any ray, and the setup stage tests the cones of tiles. `ahead_at` describes where rays
// meet a plane at distance 1: axes right, down and forward; then for each row of tiles, and for each column, the
// running maximum of places up to it and the running minimum from it on.

const AHEAD_ROWS: u32 = 9u;

struct Bounds {
    // Places down and to the right; valid only if all vertices are in front.
    rows: vec2f,
    columns: vec2f,
    all_in_front: bool,
    // Maximum signed distance of a vertex inside each side of the pyramid around the rays.
    inside: vec4f,
    in_front: f32,
    // The box around the vertices, their greatest squared distance, and the least distance forward.
    low: vec3f,
    high: vec3f,
    farthest2: f32,
    forward: f32,
    // The box around the vertices' directions (unit vectors).
    least: vec3f,
    greatest: vec3f,
    fit: Fit,
}

fn bounds_start() -> Bounds {
    return Bounds(vec2f(HUGE, -HUGE), vec2f(HUGE, -HUGE), true, vec4f(-1.0), -1.0, vec3f(HUGE), vec3f(-HUGE), 0.0, HUGE,
        vec3f(HUGE), vec3f(-HUGE), fit_start());
}

fn ahead(word: u32) -> f32 {
    return bitcast<f32>(grid[params.ahead_at + word]);
}

fn ahead_axis(axis: u32) -> vec3f {
    return vec3f(ahead(3u * axis), ahead(3u * axis + 1u), ahead(3u * axis + 2u));
}

fn tile_rows() -> u32 {
    return params.tile_count / params.tile_columns;
}

fn bounds_add(b: ptr<function, Bounds>, v: vec3f, previous: vec3f, first: bool) {
    (*b).low = min((*b).low, v);
    (*b).high = max((*b).high, v);
    let length2 = dot(v, v);
    (*b).farthest2 = max((*b).farthest2, length2);
    // A vertex at the sensor gets a shorter vector, which only widens the cone.
    let u = v * inverseSqrt(max(length2, 1.0e-30));
    (*b).least = min((*b).least, u);
    (*b).greatest = max((*b).greatest, u);
    if params.fit_at != 0u {
        if first {
            (*b).fit = fit_around(v);
        }
        (*b).fit = fit_with((*b).fit, v);
    }
    if params.ahead_at == 0u {
        return;
    }
    let place = vec3f(dot(ahead_axis(0u), v), dot(ahead_axis(1u), v), dot(ahead_axis(2u), v));
    let reach = abs(v.x) + abs(v.y) + abs(v.z);
    // Rounding error, metres.
    let slack = 2.0e-6 * reach;
    let columns_at = AHEAD_ROWS + 2u * tile_rows();
    let least = vec2f(ahead(columns_at + 1u), ahead(AHEAD_ROWS + 1u));
    let greatest = vec2f(ahead(columns_at + 2u * params.tile_columns - 2u), ahead(columns_at - 2u));
    (*b).inside = max((*b).inside, vec4f(
        place.xy - least * place.z + slack * (1.0 + abs(least)),
        greatest * place.z - place.xy + slack * (1.0 + abs(greatest)),
    ));
    (*b).in_front = max((*b).in_front, place.z + slack);
    (*b).forward = min((*b).forward, place.z - slack);
    // Vertices within 1 : 1000 of the plane make the bounds too loose; the pyramid's sides handle them.
    (*b).all_in_front = (*b).all_in_front && place.z > 1.0e-3 * reach;
    let w = 1.0 / place.z;
    let pad = slack * w * (1.0 + reach * w);
    (*b).columns = vec2f(min((*b).columns.x, place.x * w - pad), max((*b).columns.y, place.x * w + pad));
    (*b).rows = vec2f(min((*b).rows.x, place.y * w - pad), max((*b).rows.y, place.y * w + pad));
}

fn bounds_close(b: ptr<function, Bounds>, start: vec3f, previous: vec3f) {}

fn bounds_of_box(b: ptr<function, Bounds>) {}

// First and end tile with a ray between two places; `count` pairs of bounds start at `at`.
fn tiles_between(at: u32, count: u32, places: vec2f) -> vec2u {
    var first = 0u;
    var end = 0u;
    for (var step = 1u << firstLeadingBit(count); step > 0u; step >>= 1u) {
        if first + step <= count && ahead(at + 2u * (first + step - 1u)) < places.x {
            first += step;
        }
        if end + step <= count && ahead(at + 2u * (end + step - 1u) + 1u) <= places.y {
            end += step;
        }
    }
    return vec2u(first, end);
}

fn bounds_reach(b: Bounds) -> Reach {
    let beside = max(max(b.low, -b.high), vec3f());
    let distance = length(beside) - 2.0e-6 * sqrt(b.farthest2);
    var found = fit_pixels(b.fit);
    if !found.known {
        // The sphere around the box of directions contains the polygon's directions.
        let halves = 0.5 * (b.greatest - b.least);
        found = pixels_in(0.5 * (b.least + b.greatest), dot(halves, halves));
    }
    if found.known {
        if found.rows.x >= found.rows.y {
            return no_reach();
        }
        let nearest = select(distance, max(distance, b.forward), params.ahead_at != 0u);
        return Reach(
            found.rows.x, found.rows.y - found.rows.x, found.columns.x, found.columns.y - found.columns.x, nearest);
    }
    var reach = whole_reach();
    reach.nearest = distance;
    if params.ahead_at == 0u {
        return reach;
    }
    if b.in_front <= 0.0 || any(b.inside < vec4f()) {
        return no_reach();
    }
    if !b.all_in_front {
        return reach;
    }
    let rows = tiles_between(AHEAD_ROWS, tile_rows(), b.rows);
    let columns = tiles_between(AHEAD_ROWS + 2u * tile_rows(), params.tile_columns, b.columns);
    if rows.x >= rows.y || columns.x >= columns.y {
        return no_reach();
    }
    let first = vec2u(rows.x, columns.x) * TILE_SIDE;
    let count = min(vec2u(rows.y, columns.y) * TILE_SIDE, vec2u(params.height, params.width)) - first;
    return Reach(first.x, count.x, first.y, count.y, max(distance, b.forward));
}
