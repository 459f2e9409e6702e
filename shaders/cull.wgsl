// Stage 1: one invocation per selected polygon. Keeps polygons that may cover a ray and are not hidden by earlier
// waves, with the lines and samples that they may cover.

override PLAIN: bool = false;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> work: array<u32>;
@group(0) @binding(3) var<storage, read> arena: array<u32>;
@group(0) @binding(4) var<storage, read> grid: array<u32>;
@group(0) @binding(5) var<storage, read_write> survivors: array<Survivor>;
@group(0) @binding(6) var<storage, read_write> counters: Counters;
@group(0) @binding(7) var<uniform> few_instances: array<Instance, FEW_INSTANCES>;
@group(0) @binding(8) var<uniform> short_grid: array<vec4u, SHORT_GRID>;

@compute @workgroup_size(64)
fn cull(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let begin = counters.units_before;
    let end = atomicLoad(&counters.units);
    for (var i = id.x; i < (end - begin) * UNIT; i += groups.x * GROUP) {
        let unit = work[params.units_at + begin + i / UNIT];
        let run = (unit >> UNIT_SHIFT) * RUN_WORDS;
        let place = (unit & ((1u << UNIT_SHIFT) - 1u)) * UNIT + i % UNIT;
        let count = work[run + RUN_COUNT];
        if place < (count & ~RUN_NEAR_BIT) {
            examine(work[run + RUN_INSTANCE], work[run + RUN_POLYGON] + place, (count & RUN_NEAR_BIT) != 0u);
        }
    }
}

fn examine(index: u32, polygon: u32, near: bool) {
    let instance = instance_at(index);
    let first_corner = instance.corners_at + polygon_word(instance, polygon, POLYGON_FIRST_CORNER) * CORNER_WORDS;
    let packed = polygon_word(instance, polygon, POLYGON_CORNERS);
    let corner_count = packed & 0xffu;
    var flags = select(0u, NEAR, near);
    if !PLAIN {
        let facing = work[params.facings_at + (packed >> 8u)];
        if (facing & 1u) == 0u {
            return;
        }
        flags |= facing & ONE_SIDED;
    }
    var bounds = bounds_start();
    var start = vec3f();
    var previous = vec3f();
    for (var k = 0u; k < corner_count; k++) {
        let p = vertex(instance, arena[first_corner + k * CORNER_WORDS]);
        let v = to_image(instance, from_center(instance, p));
        bounds_add(&bounds, v, previous, k == 0u);
        start = select(start, v, k == 0u);
        previous = v;
    }
    bounds_close(&bounds, start, previous);
    let reach = bounds_reach(bounds);
    if reach.count == 0u {
        return;
    }
    if params.hiding != 0u && !near && is_hidden(instance, polygon, first_corner, corner_count, reach) {
        atomicAdd(&counters.polygons_hidden, 1u);
        return;
    }
    let place = atomicAdd(&counters.survivors, 1u);
    let own = place - counters.survivors_before;
    if own % GROUP == 0u {
        atomicMax(&counters.setup_groups, min(own / GROUP + 1u, MAX_GROUPS));
    }
    let samples = reach.first_sample | (reach.sample_count << 16u);
    survivors[place].polygon = polygon;
    survivors[place].instance = index;
    survivors[place].lines = reach.first | (reach.count << 16u);
    survivors[place].samples = samples;
    survivors[place].flags = flags;
}

// Maximum ratio of a polygon's distance to its plane's distance: rounding moves flatter polygons too much.
const CLEAR: f32 = 4096.0;

// True if the polygon is behind the depth drawn by earlier waves by more than the rounding of both.
fn is_hidden(instance: Instance, polygon: u32, first_corner: u32, corner_count: u32, reach: Reach) -> bool {
    if !(reach.nearest > 0.0) {
        return false;
    }
    let inverse = 1.0 / reach.nearest;
    let least = least_around(reach, inverse);
    if least == 0.0 {
        return false;
    }
    // Few polygons get here, so the costly plane test runs for them only.
    let normal = polygon_normal(instance, polygon);
    let stretch = length(normal_to_image(instance, normal));
    var nearest = HUGE;
    var distance = 0.0;
    var reached = 0.0;
    for (var k = 0u; k < corner_count; k++) {
        let q = from_center(instance, vertex(instance, arena[first_corner + k * CORNER_WORDS]));
        let length2 = dot(q, q);
        distance = select(distance, dot(normal, q), length2 < nearest);
        nearest = min(nearest, length2);
        reached = max(reached, length(to_image(instance, q)));
    }
    let times = (sqrt(nearest) + stretch * reached) / abs(distance);
    // NaN fails these comparisons, so it hides nothing.
    return times < CLEAR && least > inverse * (1.0 + ROUNDING * (4.0 + times));
}
