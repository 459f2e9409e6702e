// Cross products accurate to about 34 bits. No fma: WGSL does not guarantee its single rounding.

struct Halves {
    high: vec3f,
    low: vec3f,
}

// Splits exactly into 12 leading bits and the rest. Products of halves are exact, with or without fused operations.
fn halves(v: vec3f) -> Halves {
    let high = bitcast<vec3f>(bitcast<vec3u>(v) & vec3u(0xfffff000u));
    return Halves(high, v - high);
}

// a x b. Swapping both arguments or negating one gives exactly the negative.
fn cross_exact(a: vec3f, b: vec3f) -> vec3f {
    let p = halves(a);
    let q = halves(b);
    let big = p.high.yzx * q.high.zxy - p.high.zxy * q.high.yzx;
    let mixed = (p.high.yzx * q.low.zxy - p.low.zxy * q.high.yzx) + (p.low.yzx * q.high.zxy - p.high.zxy * q.low.yzx);
    let small = p.low.yzx * q.low.zxy - p.low.zxy * q.low.yzx;
    return big + (mixed + small);
}
