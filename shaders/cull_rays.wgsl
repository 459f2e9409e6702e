// Ray tables: the selection has tested boxes; single polygons meet the tiles' cones in the setup stage.

struct Bounds {
    unused: u32,
}

fn bounds_start() -> Bounds {
    return Bounds(0u);
}

fn bounds_add(b: ptr<function, Bounds>, v: vec3f, previous: vec3f, first: bool) {}

fn bounds_close(b: ptr<function, Bounds>, start: vec3f, previous: vec3f) {}

fn bounds_reach(b: Bounds) -> Reach {
    return Reach(0u, 1u);
}
