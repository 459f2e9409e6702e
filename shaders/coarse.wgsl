// Coarse depth: the farthest depth drawn in each tile of TILE_SIDE lines by TILE_SIDE samples, stored as the least
// inverse depth; 0 if a ray has met nothing. A block has 8 x 8 tiles and the minima of 2 x 2, 4 x 4 and 8 x 8 of them.

const TILE_SIDE: u32 = 8u;
const BLOCK_WORDS: u32 = 85u;
const LEVELS: u32 = 4u;
// Maximum number of tiles to read before switching to a coarser level.
const FEW_TILES: u32 = 16u;

fn coarse_at(level: u32, row: u32, column: u32) -> u32 {
    let shift = 3u - level;
    let mask = (1u << shift) - 1u;
    let block = (row >> shift) * params.coarse_columns + (column >> shift);
    let start = (256u - (256u >> (2u * level))) / 3u;
    return params.coarse_at + block * BLOCK_WORDS + start + ((row & mask) << shift) + (column & mask);
}

// The least inverse depth in these lines and samples (first and last); 0 unless it is above `than`.
fn least_inverse(lines: vec2u, samples: vec2u, than: f32) -> f32 {
    var level = 0u;
    var shift = 3u;
    while level + 1u < LEVELS
        && ((lines.y >> shift) - (lines.x >> shift) + 1u) * ((samples.y >> shift) - (samples.x >> shift) + 1u)
            > FEW_TILES {
        level++;
        shift++;
    }
    var least = HUGE;
    for (var row = lines.x >> shift; row <= lines.y >> shift; row++) {
        for (var column = samples.x >> shift; column <= samples.y >> shift; column++) {
            least = min(least, bitcast<f32>(grid[coarse_at(level, row, column)]));
            if !(least > than) {
                return 0.0;
            }
        }
    }
    return least;
}

// The least inverse depth that earlier waves drew within a reach widened by one line and sample; 0 unless above `than`.
fn least_around(reach: Reach, than: f32) -> f32 {
    let samples =
        vec2u(max(reach.first_sample, 1u) - 1u, min(reach.first_sample + reach.sample_count, params.sample_count - 1u));
    let first = max(reach.first, 1u) - 1u;
    let last = reach.first + reach.count;
    let least = least_inverse(vec2u(first, min(last, params.line_count - 1u)), samples, than);
    if GRID != SCANNER || least == 0.0 {
        return least;
    }
    // A scanner's lines wrap around.
    var rest = HUGE;
    if last >= params.line_count {
        rest = least_inverse(vec2u(0u, min(last - params.line_count, params.line_count - 1u)), samples, than);
    }
    if reach.first == 0u && rest > 0.0 {
        rest = min(rest, least_inverse(vec2u(params.line_count - 1u), samples, than));
    }
    return min(least, rest);
}

// Relative rounding error of an inverse depth, 64 * 2^-24, times the ratio of a point's distance to the plane's.
const ROUNDING: f32 = 3.8e-6;

// Lines and samples that a polygon may cover, and a lower bound of its depth: 0 if unknown.
struct Reach {
    first: u32,
    // 0 if it covers no ray.
    count: u32,
    first_sample: u32,
    sample_count: u32,
    nearest: f32,
}

fn no_reach() -> Reach {
    return Reach(0u, 0u, 0u, 0u, 0.0);
}

fn whole_reach() -> Reach {
    return Reach(0u, params.line_count, 0u, params.sample_count, 0.0);
}
