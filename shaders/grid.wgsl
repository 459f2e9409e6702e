// Access to the tables of a line grid.

// True if the whole table fits a uniform buffer, which software adapters read several times faster.
override SHORT: bool = false;
const SHORT_GRID: u32 = 4096u;

fn grid_word(at: u32) -> u32 {
    if SHORT {
        return short_grid[at / 4u][at % 4u];
    }
    return grid[at];
}

fn grid_float(at: u32) -> f32 {
    return bitcast<f32>(grid_word(at));
}

// The diamond angle: rises with the azimuth from -2 at -180 deg to 2 at 180 deg, without trigonometry.
fn diamond(direction: vec2f) -> f32 {
    let p = direction.x / (abs(direction.x) + abs(direction.y));
    return select(p - 1.0, 1.0 - p, direction.y >= 0.0);
}

fn bucket(value: f32, origin: f32, scale: f32, count: u32) -> u32 {
    return u32(clamp(floor((value - origin) * scale), 0.0, f32(count - 1u)));
}

fn position(sample: u32) -> f32 {
    return grid_float(params.positions_at + sample);
}

// Maps all elevations to -1..1: t / (1 + |t|).
fn squeezed(t: f32) -> f32 {
    return t / (1.0 + abs(t));
}

fn sample_start(t: f32) -> u32 {
    let b = bucket(squeezed(t), -1.0, 0.5 * f32(params.sample_buckets), params.sample_buckets);
    return grid_word(params.sample_buckets_at + b);
}

// The first sample at or above t. Neighbouring polygons pass the same bits for a shared edge, so there are no cracks.
fn first_at_or_above(t: f32) -> u32 {
    if GRID == CAMERA {
        return u32(clamp(ceil(t - params.first_sample), 0.0, f32(params.sample_count)));
    }
    var i = sample_start(t);
    while i < params.sample_count && position(i) < t {
        i++;
    }
    return i;
}

// The first sample above t.
fn first_above(t: f32) -> u32 {
    if GRID == CAMERA {
        return u32(clamp(floor(t - params.first_sample) + 1.0, 0.0, f32(params.sample_count)));
    }
    var i = sample_start(t);
    while i < params.sample_count && position(i) <= t {
        i++;
    }
    return i;
}

struct Line {
    c: vec2f,
    // Index of the line's keys: image row of a camera, image column of a scanner, whose lines are sorted by angle.
    place: u32,
}

fn line_at(index: u32) -> Line {
    if GRID == CAMERA {
        return Line(vec2f(params.first_line + f32(index), 1.0), index);
    }
    if GRID == RAYS {
        return Line(vec2f(), index);
    }
    let at = params.lines_at + index * 3u;
    return Line(vec2f(grid_float(at), grid_float(at + 1u)), grid_word(at + 2u));
}
