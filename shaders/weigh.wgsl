// After resolve, in batches without images: sums the log-densities of a measured range image given the predicted one
// (docs/batches.md). One workgroup handles a part of the beams at one heading; the CPU adds the parts.

@group(0) @binding(0) var<uniform> model: WeighParams;
@group(0) @binding(1) var<storage, read> sensed: array<u32>;
// Range and cosine images at their offsets; behind all images the sums, by heading and part.
@group(0) @binding(2) var<storage, read_write> outputs: array<u32>;

// As in src/plan/weighing.rs.
struct BeamNumbers {
    range_sigma: f32,
    quadratic: f32,
    turn: f32,
    place: f32,
    range_min: f32,
    range_max: f32,
    short: f32,
    ln_short: f32,
    below: f32,
    near_there: f32,
    ln_any: f32,
    ln_hit: f32,
    ln_none: f32,
    ln_nothing: f32,
}

struct WeighParams {
    // Number of beams: in total, of a measured row, of a predicted row.
    count: u32,
    sensed_beams: u32,
    predicted_beams: u32,
    // Columns from one heading to the next.
    stride: u32,
    parts: u32,
    // Into `outputs`.
    range_at: u32,
    cos_at: u32,
    sums_at: u32,
    beam: BeamNumbers,
}

// The limits of src/batch/likelihood.rs.
const LEAST_COS: f32 = 0.05;
const LEAST_RANGE: f32 = 1e-6;
const LEAST: f32 = 1e-30;
// A logarithm whose exponential is 0.
const NEVER: f32 = -2000.0;
// A hit's density is negligible beyond this many standard deviations.
const FAR_OFF: f32 = 100.0;
// A variance so large that a hit has no information: a standard deviation of a million kilometres.
const ANYWHERE: f32 = 1e18;

const INFINITE: u32 = 0x7f800000u;
const SIGN: u32 = 0x80000000u;

var<workgroup> partial: array<f32, GROUP>;

@compute @workgroup_size(64)
fn weigh(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let first = group.y * model.stride % model.predicted_beams;
    var sum = 0.0;
    for (var beam = group.x * GROUP + lane; beam < model.count; beam += model.parts * GROUP) {
        let row = beam / model.sensed_beams;
        let column = (first + beam % model.sensed_beams) % model.predicted_beams;
        let pixel = row * model.predicted_beams + column;
        sum += ln_density(sensed[beam], outputs[model.range_at + pixel], outputs[model.cos_at + pixel]);
    }
    partial[lane] = sum;
    for (var half = GROUP / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            partial[lane] += partial[lane + half];
        }
    }
    if lane == 0u {
        outputs[model.sums_at + group.y * model.parts + group.x] = bitcast<u32>(partial[0]);
    }
}

fn is_nan(bits: u32) -> bool {
    return (bits & ~SIGN) > INFINITE;
}

// Infinities are compared as bits: WGSL does not require support for them.
fn ln_density(sensed_bits: u32, range_bits: u32, cos_bits: u32) -> f32 {
    let beam = model.beam;
    if is_nan(sensed_bits) || is_nan(range_bits) {
        return 0.0;
    }
    let nothing = range_bits == INFINITE;
    let too_near = range_bits == (SIGN | INFINITE);
    if sensed_bits == INFINITE {
        return select(beam.ln_none, beam.ln_nothing, nothing);
    }
    var range = beam.range_max;
    if !nothing && !too_near {
        range = bitcast<f32>(range_bits);
    }
    let far = clamp(range, LEAST_RANGE, beam.range_max);
    if sensed_bits == (SIGN | INFINITE) {
        let near = beam.below + beam.short / far * beam.range_min;
        return log(max(select(near, beam.near_there, too_near), LEAST));
    }
    if too_near {
        return beam.ln_any;
    }
    let away = bitcast<f32>(sensed_bits) - range;
    let ln_short = select(NEVER, beam.ln_short - log(far), nothing || away < 0.0);
    var ln_hit = NEVER;
    if !nothing {
        let cosine = max(bitcast<f32>(cos_bits), LEAST_COS);
        let squared = cosine * cosine;
        let own = beam.range_sigma + beam.quadratic * range * range;
        let turned = range * range * beam.turn * (1.0 - squared);
        let spread = min(own * own * squared + turned + beam.place, ANYWHERE);
        let inverse = squared / spread;
        let deviations = min(abs(away) * sqrt(inverse), FAR_OFF);
        ln_hit = beam.ln_hit + 0.5 * log(inverse) - 0.5 * deviations * deviations;
    }
    let most = max(beam.ln_any, max(ln_short, ln_hit));
    return most + log(exp(beam.ln_any - most) + exp(ln_short - most) + exp(ln_hit - most));
}
