// Stage 1: one invocation per selected polygon. Keeps what may cover a ray, with the lines that it may reach.

override PLAIN: bool = false;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> work: array<u32>;
@group(0) @binding(3) var<storage, read> arena: array<u32>;
@group(0) @binding(4) var<storage, read> grid: array<u32>;
@group(0) @binding(5) var<storage, read_write> survivors: array<Survivor>;
@group(0) @binding(6) var<storage, read_write> counters: Counters;
@group(0) @binding(7) var<uniform> few_instances: array<Instance, FEW_INSTANCES>;

// A run in `work`: start, instance, first polygon, near.
const RUN_START: u32 = 0u;
const RUN_INSTANCE: u32 = 1u;
const RUN_POLYGON: u32 = 2u;
const RUN_NEAR: u32 = 3u;
const RUN_WORDS: u32 = 4u;

// Lines that a polygon may reach, as first | count << 16; 0 if it covers no ray.
struct Reach {
    first: u32,
    count: u32,
}

@compute @workgroup_size(64)
fn cull(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let g = group.y * groups.x + group.x;
    let i = g * GROUP + lane;
    if i >= params.polygon_count {
        return;
    }
    var run = work[params.groups_at + g];
    while i >= work[(run + 1u) * RUN_WORDS + RUN_START] {
        run++;
    }
    let instance = work[run * RUN_WORDS + RUN_INSTANCE];
    let polygon = work[run * RUN_WORDS + RUN_POLYGON] + (i - work[run * RUN_WORDS + RUN_START]);
    let near = work[run * RUN_WORDS + RUN_NEAR] != 0u;
    examine(instance, polygon, near);
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
    let place = atomicAdd(&counters.survivors, 1u);
    if place % GROUP == 0u {
        atomicMax(&counters.setup_groups, min(place / GROUP + 1u, MAX_GROUPS));
    }
    survivors[place] = Survivor(polygon, index, reach.first | (reach.count << 16u), flags);
}
