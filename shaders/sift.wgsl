// Stage 0, from the second wave on: one invocation per run. Drops runs that are hidden by earlier waves, and splits the
// others into units for the cull stage.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read_write> work: array<u32>;
@group(0) @binding(3) var<storage, read> arena: array<u32>;
@group(0) @binding(4) var<storage, read> grid: array<u32>;
@group(0) @binding(5) var<storage, read_write> counters: Counters;
@group(0) @binding(6) var<uniform> few_instances: array<Instance, FEW_INSTANCES>;
@group(0) @binding(7) var<uniform> short_grid: array<vec4u, SHORT_GRID>;

// A hidden box must be farther than the hiding surface by this share. It covers the rounding of polygons seen at an
// angle of 4 mrad or more; flatter polygons of a hidden run could only show through rounding.
const BOX_SLACK: f32 = 1.0e-3;

@compute @workgroup_size(64)
fn sift(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let run = params.first_run + (group.y * groups.x + group.x) * GROUP + lane;
    if run >= params.end_run {
        return;
    }
    let at = run * RUN_WORDS;
    let count = work[at + RUN_COUNT];
    if (count & RUN_NEAR_BIT) == 0u && is_hidden(work[at + RUN_INSTANCE], work[at + RUN_BOX]) {
        atomicAdd(&counters.runs_hidden, 1u);
        return;
    }
    let wanted = ((count & ~RUN_NEAR_BIT) + UNIT - 1u) / UNIT;
    let first = atomicAdd(&counters.units, wanted);
    let own = first - counters.units_before + wanted;
    atomicMax(&counters.cull_groups, min((own * UNIT + GROUP - 1u) / GROUP, MAX_GROUPS));
    for (var i = 0u; i < wanted; i++) {
        work[params.units_at + first + i] = run << UNIT_SHIFT | i;
    }
}

fn is_hidden(index: u32, box: u32) -> bool {
    let instance = instance_at(index);
    let least = vec3f(bitcast<f32>(arena[box]), bitcast<f32>(arena[box + 1u]), bitcast<f32>(arena[box + 2u]));
    let greatest = vec3f(bitcast<f32>(arena[box + 3u]), bitcast<f32>(arena[box + 4u]), bitcast<f32>(arena[box + 5u]));
    var bounds = bounds_start();
    for (var i = 0u; i < 8u; i++) {
        let p = select(least, greatest, (vec3u(i) & vec3u(1u, 2u, 4u)) != vec3u());
        let v = to_image(instance, from_center(instance, p));
        bounds_add(&bounds, v, v, i == 0u);
    }
    bounds_of_box(&bounds);
    let reach = bounds_reach(bounds);
    if reach.count == 0u || !(reach.nearest > 0.0) {
        // The cull stage drops polygons out of view.
        return false;
    }
    return least_around(reach, (1.0 + BOX_SLACK) / reach.nearest) > 0.0;
}
