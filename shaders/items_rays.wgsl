// Work items of a ray table: a polygon and a supertile whose cone its own cone meets.

fn add_items(at: u32, instance: Instance, survivor: Survivor, first_corner: u32, corner_count: u32) {
    var axis = vec3f();
    for (var k = 0u; k < corner_count; k++) {
        let p = vertex(instance, arena[first_corner + k * CORNER_WORDS]);
        axis += normalize(to_image(instance, from_center(instance, p)));
    }
    axis = normalize(axis + vec3f(1.0e-12, 0.0, 0.0));
    var chord = 0.0;
    for (var k = 0u; k < corner_count; k++) {
        let p = vertex(instance, arena[first_corner + k * CORNER_WORDS]);
        let apart = normalize(to_image(instance, from_center(instance, p))) - axis;
        chord = max(chord, dot(apart, apart));
    }
    // A cap of less than a quarter turn around the vertices is convex and holds the polygon; a wider one is not.
    chord = select(-1.0, chord * 1.00001 + 1.0e-11, chord < 1.9);
    put(at + 5u, axis);
    records[at + 8u] = bitcast<u32>(chord);
    let cosine = cosine_of(chord);

    var wanted = 0u;
    for (var s = 0u; s < params.line_count; s++) {
        wanted += select(0u, 1u, meets_supertile(axis, cosine, s));
    }
    if wanted == 0u {
        return;
    }
    var index = reserve_items(wanted);
    for (var s = 0u; s < params.line_count; s++) {
        if meets_supertile(axis, cosine, s) {
            put_item(index, at, s);
            index++;
        }
    }
}

// A cone of 4 words in `grid`: axis, cosine of the half angle; a cosine of 2 holds no ray.
fn meets_supertile(axis: vec3f, cosine: f32, s: u32) -> bool {
    let t = params.lines_at + s * 4u;
    let cone = vec4f(
        bitcast<f32>(grid[t]), bitcast<f32>(grid[t + 1u]), bitcast<f32>(grid[t + 2u]), bitcast<f32>(grid[t + 3u]),
    );
    return cone.w <= 1.0 && cones_meet(axis, cosine, cone.xyz, cone.w);
}
