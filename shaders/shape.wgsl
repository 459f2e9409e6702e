// Selects the polygons for the hardware rasterizer, and a rectangle to draw for each. The rectangle encloses the
// polygon's image with a margin for the driver (corners snapped to 1/16 pixel and rounded) and for the rounding of the
// polygon's edges. Spans draw all other polygons.

// Margin for the driver, pixels. 0 plants a fault for tests: no margin at all.
override GROWTH: f32 = 1.0;

// Maximum rounding error of an edge, pixels.
const MAX_OFFSET: f32 = 1.0;
// Greater than the ratio for any polygon that is drawn; keeps divisions finite.
const HUGE_RATIO: f32 = 1.0e9;
// Rounding of an edge plane, a corner and a ray: an angle of 40 * 2^-24, multiplied by the ratio of the near corner's
// distance to the edge line's.
const EDGE_ROUNDING: f32 = 2.4e-6;
// 2^-48 of the centre's coordinates, in units of 24 * 2^-24.
const CENTER_ROUNDING: f32 = 1.0e-8;
// Beyond this, f32 positions lose fractions of a pixel.
const MAX_PIXELS: f32 = 16384.0;
// Maximum area in pixels of a box for which a turned rectangle does not pay.
const SMALL: f32 = 256.0;
// A turned rectangle is used if its area is below this share of the box.
const WORTH_TURNING: f32 = 0.8;

struct Outline {
    // Direction of the longest side.
    direction: vec2f,
    // Rounding error of an edge, pixels; negative if the polygon cannot be drawn.
    off: f32,
}

fn image_place(v: vec3f) -> vec2f {
    return vec2f(params.fx * v.x / v.z - params.first_sample, params.fy * v.y / v.z - params.first_line) + 0.5;
}

fn outline(instance: Instance, first_corner: u32, corner_count: u32) -> Outline {
    let stretch = sqrt(dot(instance.linear_x, instance.linear_x) + dot(instance.linear_y, instance.linear_y)
        + dot(instance.linear_z, instance.linear_z));
    let center = length(instance.center_high) * CENTER_ROUNDING;
    var p = vertex(instance, arena[first_corner + (corner_count - 1u) * CORNER_WORDS]);
    var q = from_center(instance, p);
    var v = to_image(instance, q);
    var place = image_place(v);
    var direction = vec2f(1.0, 0.0);
    var longest = 0.0;
    var slope = 0.0;
    var times = 1.0;
    for (var k = 0u; k < corner_count; k++) {
        let p_next = vertex(instance, arena[first_corner + k * CORNER_WORDS]);
        let q_next = from_center(instance, p_next);
        let v_next = to_image(instance, q_next);
        let place_next = image_place(v_next);
        let side = place_next - place;
        direction = select(direction, side, dot(side, side) > longest);
        longest = max(longest, dot(side, side));
        slope = max(slope, (abs(v_next.x) + abs(v_next.y) + abs(v_next.z)) / v_next.z);
        let from_next = dot(v_next, v_next) < dot(v, v);
        let anchor = select(v, v_next, from_next);
        let distance = length(select(q, q_next, from_next)) + center;
        let edge = length(cross(anchor, to_image(instance, p_next - p)));
        let needed = stretch * distance * stretch * length(p_next - p);
        // The negated comparison also rejects NaN.
        if !(v_next.z > 0.0 && needed < edge * HUGE_RATIO) {
            return Outline(direction, -1.0);
        }
        times = max(times, needed / edge);
        p = p_next;
        q = q_next;
        v = v_next;
        place = place_next;
    }
    let off = EDGE_ROUNDING * times * max(params.fx, params.fy) * slope * slope;
    return Outline(normalize(direction), select(-1.0, off, off < MAX_OFFSET));
}

// Sets the shape of a survivor. Returns false if spans must draw it.
fn set_shape(
    at: u32, index: u32, instance: Instance, survivor: Survivor, first_corner: u32, corner_count: u32) -> bool {
    let seen = outline(instance, first_corner, corner_count);
    if seen.off < 0.0 {
        return false;
    }
    let wider = GROWTH * (1.0 + seen.off);
    let first = vec2f(f32(survivor.samples & 0xffffu), f32(survivor.lines & 0xffffu)) + 0.5;
    let count = vec2f(f32(survivor.samples >> 16u), f32(survivor.lines >> 16u));
    var direction = vec2f(1.0, 0.0);
    var least = first - wider;
    var greatest = first + count - 1.0 + wider;
    let size = greatest - least;
    if size.x * size.y > SMALL {
        var low = vec2f(HUGE);
        var high = vec2f(-HUGE);
        for (var k = 0u; k < corner_count; k++) {
            let v = to_image(instance, from_center(instance, vertex(instance, arena[first_corner + k * CORNER_WORDS])));
            let place = image_place(v);
            let turned = vec2f(dot(place, seen.direction), dot(place, vec2f(-seen.direction.y, seen.direction.x)));
            low = min(low, turned - wider);
            high = max(high, turned + wider);
        }
        let far = max(abs(low), abs(high));
        if (high.x - low.x) * (high.y - low.y) < WORTH_TURNING * size.x * size.y && max(far.x, far.y) < MAX_PIXELS {
            direction = seen.direction;
            least = low;
            greatest = high;
        }
    }
    survivors[index].record = at;
    survivors[index].direction = direction;
    survivors[index].least = least;
    survivors[index].greatest = greatest;
    atomicAdd(&counters.shapes, 1u);
    return true;
}
