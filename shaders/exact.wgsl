// Cross products to about 34 bits. No fma: WGSL does not promise that it rounds once.

struct Halves {
    high: vec3f,
    low: vec3f,
}

// 12 bits and the rest, exactly: products of halves are exact, so contraction cannot change them.
fn halves(v: vec3f) -> Halves {
    let high = bitcast<vec3f>(bitcast<vec3u>(v) & vec3u(0xfffff000u));
    return Halves(high, v - high);
}

// a x b; with both swapped or one negated the answer is exactly the negative.
fn cross_exact(a: vec3f, b: vec3f) -> vec3f {
    let p = halves(a);
    let q = halves(b);
    let big = p.high.yzx * q.high.zxy - p.high.zxy * q.high.yzx;
    let mixed = (p.high.yzx * q.low.zxy - p.low.zxy * q.high.yzx) + (p.low.yzx * q.high.zxy - p.high.zxy * q.low.yzx);
    let small = p.low.yzx * q.low.zxy - p.low.zxy * q.low.yzx;
    return big + (mixed + small);
}
