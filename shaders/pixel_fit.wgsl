// The pixel fit (sensor::PixelFit): pixel positions by direction, in cells on the sides of a cube. Each cell has
// quadratics for column and row, and a bound of their error. In `grid` at `fit_at`; sides as in direction_map.wgsl.

// OFF: maximum error of column and row, pixels; -1 if unknown, -2 if no ray looks there. BEND: bounds of the second
// derivatives. COLUMN and ROW: coefficients of 1, x, y, xx, xy, yy, with x and y from -1 to 1 around the cell.
const FIT_OFF: u32 = 0u;
const FIT_BEND: u32 = 2u;
const FIT_COLUMN: u32 = 4u;
const FIT_ROW: u32 = 10u;
const FIT_WORDS: u32 = 16u;
const FIT_ACROSS: u32 = 20u;
const FIT_CELL: f32 = 0.1;

struct Fit {
    // The cell of the first vertex.
    side: u32,
    middle: vec2f,
    off: vec2f,
    bend: vec2f,
    column: vec3f,
    column2: vec3f,
    row: vec3f,
    row2: vec3f,
    // Bounds over the vertices: column, row, and position around the cell.
    low: vec4f,
    high: vec4f,
    // True if all vertices are near the cell.
    known: bool,
}

fn fit_start() -> Fit {
    return Fit(
        0u, vec2f(), vec2f(-1.0), vec2f(), vec3f(), vec3f(), vec3f(), vec3f(), vec4f(HUGE), vec4f(-HUGE),
        params.fit_at != 0u);
}

// The component along a side's axis, then the next two in cyclic order.
fn on_side(side: u32, v: vec3f) -> vec3f {
    let turned = select(select(v.zxy, v.yzx, side < 4u), v, side < 2u);
    return vec3f(select(turned.x, -turned.x, (side & 1u) != 0u), turned.yz);
}

fn fit_float(at: u32) -> f32 {
    return bitcast<f32>(grid[at]);
}

fn fit_three(at: u32) -> vec3f {
    return vec3f(fit_float(at), fit_float(at + 1u), fit_float(at + 2u));
}

// Starts with the cell around a vertex.
fn fit_around(v: vec3f) -> Fit {
    let a = abs(v);
    let axis = select(select(1u, 2u, a.z > a.y), 0u, a.x >= a.y && a.x >= a.z);
    let side = 2u * axis + select(0u, 1u, on_side(2u * axis, v).x < 0.0);
    let turned = on_side(side, v);
    let place = (turned.yz / turned.x + 1.0) / FIT_CELL;
    let cell = min(vec2u(max(place, vec2f())), vec2u(FIT_ACROSS - 1u));
    let at = params.fit_at + ((side * FIT_ACROSS + cell.y) * FIT_ACROSS + cell.x) * FIT_WORDS;
    return Fit(
        side,
        (vec2f(cell) + 0.5) * FIT_CELL - 1.0,
        vec2f(fit_float(at + FIT_OFF), fit_float(at + FIT_OFF + 1u)),
        vec2f(fit_float(at + FIT_BEND), fit_float(at + FIT_BEND + 1u)),
        fit_three(at + FIT_COLUMN),
        fit_three(at + FIT_COLUMN + 3u),
        fit_three(at + FIT_ROW),
        fit_three(at + FIT_ROW + 3u),
        vec4f(HUGE),
        vec4f(-HUGE),
        true,
    );
}

// Adds a vertex.
fn fit_with(f: Fit, v: vec3f) -> Fit {
    let turned = on_side(f.side, v);
    let place = (turned.yz / turned.x - f.middle) / FIT_CELL;
    let linear = vec3f(1.0, place);
    let squares = vec3f(place.x * place.x, place.x * place.y, place.y * place.y);
    let pixel = vec2f(dot(f.column, linear) + dot(f.column2, squares), dot(f.row, linear) + dot(f.row2, squares));
    var grown = f;
    grown.low = min(f.low, vec4f(pixel, place));
    grown.high = max(f.high, vec4f(pixel, place));
    // NaN fails these comparisons.
    grown.known = f.known && turned.x > 0.0 && all(abs(place) < vec2f(1.0));
    return grown;
}

// The pixels that a polygon with these vertices may cover.
fn fit_pixels(f: Fit) -> PixelBox {
    if !f.known || f.off.x == -1.0 {
        return PixelBox(false, vec2u(), vec2u());
    }
    if f.off.x < 0.0 {
        return PixelBox(true, vec2u(), vec2u());
    }
    let size = vec2f(f32(params.width), f32(params.height));
    let apart = f.high.zw - f.low.zw;
    // The second term bounds how far a quadratic leaves the plane through the vertices; the last terms cover rounding.
    let wide = f.off + 0.25 * dot(apart, apart) * f.bend + 2.0e-3 + 4.0e-6 * size;
    let first = ceil(f.low.xy - wide);
    let last = floor(f.high.xy + wide);
    if any(last < vec2f()) || any(first >= size) || any(last < first) {
        return PixelBox(true, vec2u(), vec2u());
    }
    let begin = vec2u(max(first, vec2f()));
    let end = vec2u(min(last, size - 1.0)) + 1u;
    return PixelBox(true, vec2u(begin.y, end.y), vec2u(begin.x, end.x));
}
