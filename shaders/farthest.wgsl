// Between waves: one workgroup per block of tiles computes the farthest depth drawn so far, which hides polygons of the
// next wave. Also sets where the next wave's lists begin.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> keys: array<vec2u>;
@group(0) @binding(2) var<storage, read_write> grid: array<u32>;
@group(0) @binding(3) var<storage, read_write> counters: Counters;
@group(0) @binding(4) var<uniform> short_grid: array<vec4u, SHORT_GRID>;

// A planted fault for tests: makes a tile's depth nearer by the allowed rounding.
override TOO_NEAR: f32 = 0.0;

var<workgroup> tiles: array<f32, 64>;

@compute @workgroup_size(64)
fn farthest(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    if group.x + group.y + lane == 0u {
        begin_wave();
    }
    tiles[lane] = least_of_tile(group.y * 8u + lane / 8u, group.x * 8u + lane % 8u) * (1.0 + TOO_NEAR);
    workgroupBarrier();
    let block = params.coarse_at + (group.y * params.coarse_columns + group.x) * BLOCK_WORDS;
    grid[block + lane] = bitcast<u32>(tiles[lane]);
    if lane < 16u {
        grid[block + 64u + lane] = least_of_square(lane / 4u, lane % 4u, 2u);
    } else if lane < 20u {
        grid[block + 64u + lane] = least_of_square((lane - 16u) / 2u, lane % 2u, 4u);
    } else if lane == 20u {
        grid[block + 84u] = least_of_square(0u, 0u, 8u);
    }
}

fn begin_wave() {
    let rasters = atomicLoad(&counters.raster_groups);
    counters.groups_before += atomicLoad(&counters.cull_groups) + atomicLoad(&counters.setup_groups) + rasters;
    counters.units_before = atomicLoad(&counters.units);
    counters.survivors_before = atomicLoad(&counters.survivors);
    counters.items_before = atomicLoad(&counters.items);
    atomicStore(&counters.cull_groups, 0u);
    atomicStore(&counters.setup_groups, 0u);
    atomicStore(&counters.raster_groups, 0u);
    counters.draw_vertices = 0u;
}

// The least inverse depth of a tile's rays; pixels without a ray do not count.
fn least_of_tile(row: u32, column: u32) -> f32 {
    var least = HUGE;
    let end = min((column + 1u) * TILE_SIDE, params.sample_count);
    for (var line = row * TILE_SIDE; line < min((row + 1u) * TILE_SIDE, params.line_count); line++) {
        let base = line_at(line).place * params.sample_count;
        for (var s = column * TILE_SIDE; s < end; s++) {
            let inverse = bitcast<f32>(keys[base + s].y);
            if inverse < least && !(inverse == 0.0 && is_gap(base + s)) {
                least = inverse;
            }
        }
    }
    return least;
}

// A pixel of a ray table without a ray.
fn is_gap(pixel: u32) -> bool {
    if GRID != RAYS {
        return false;
    }
    let at = params.rays_at + pixel * 3u;
    return (grid[at] | grid[at + 1u] | grid[at + 2u]) == 0u;
}

fn least_of_square(row: u32, column: u32, side: u32) -> u32 {
    var least = HUGE;
    for (var i = 0u; i < side * side; i++) {
        least = min(least, tiles[(row * side + i / side) * 8u + column * side + i % side]);
    }
    return bitcast<u32>(least);
}
