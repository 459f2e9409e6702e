// The nearest surface in two passes of 32-bit maxima, in the layout of the 64-bit key: word 1 the inverse depth, word 0
// the inverted slot. The compiler may round differently in the second pass, so it accepts depths within a few ulp.

override SECOND: bool = false;

@group(0) @binding(5) var<storage, read_write> keys: array<atomic<u32>>;

const CONTRACTION_ULP: u32 = 4u;

fn offer(pixel: u32, k: f32, slot: u32) {
    if k > 0.0 {
        let bits = bitcast<u32>(k);
        if SECOND {
            if bits + CONTRACTION_ULP >= atomicLoad(&keys[2u * pixel + 1u]) {
                atomicMax(&keys[2u * pixel], ~slot);
            }
        } else {
            atomicMax(&keys[2u * pixel + 1u], bits);
        }
    }
}

// Start of a wave. The second pass covers all waves.
fn first_of(wave_begins_at: u32) -> u32 {
    return select(wave_begins_at, 0u, SECOND);
}
