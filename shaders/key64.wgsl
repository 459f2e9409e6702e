// The nearest surface by one 64-bit maximum: inverse depth above, inverted slot below, so that the lower id wins a tie.

@group(0) @binding(5) var<storage, read_write> keys: array<atomic<u64>>;

fn offer(pixel: u32, k: f32, slot: u32) {
    // Only hits in front. This also excludes the antipode of a cone thinner than its rounding.
    if k > 0.0 {
        let key = (u64(bitcast<u32>(k)) << 32u) | u64(~slot);
        atomicMax(&keys[pixel], key);
    }
}

fn first_of(wave_begins_at: u32) -> u32 {
    return wave_begins_at;
}
