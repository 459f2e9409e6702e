// Stage 3 for ray tables: one invocation per polygon and supertile; tiles by their cones, then ray by ray.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> records: array<u32>;
@group(0) @binding(2) var<storage, read> items: array<u32>;
@group(0) @binding(3) var<storage, read> grid: array<u32>;
@group(0) @binding(4) var<storage, read> counted: array<u32>;

const TILE: u32 = 8u;
const TILES_PER_SUPERTILE: u32 = 8u;

@compute @workgroup_size(64)
fn raster(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let count = min(counted[2], params.item_room);
    for (var i = id.x; i < count; i += groups.x * GROUP) {
        supertile(items[i * ITEM_WORDS], items[i * ITEM_WORDS + 1u]);
    }
}

fn float_of(at: u32) -> f32 {
    return bitcast<f32>(records[at]);
}

fn words_of_grid(at: u32) -> vec3f {
    return vec3f(bitcast<f32>(grid[at]), bitcast<f32>(grid[at + 1u]), bitcast<f32>(grid[at + 2u]));
}

fn supertile(record: u32, index: u32) {
    let across = (params.tile_columns + TILES_PER_SUPERTILE - 1u) / TILES_PER_SUPERTILE;
    let first_column = (index % across) * TILES_PER_SUPERTILE;
    let first_row = (index / across) * TILES_PER_SUPERTILE;
    let tile_rows = params.tile_count / params.tile_columns;
    let axis = vec3f(float_of(record + 5u), float_of(record + 6u), float_of(record + 7u));
    let chord = float_of(record + 8u);
    let cosine = cosine_of(chord);
    for (var row = first_row; row < min(first_row + TILES_PER_SUPERTILE, tile_rows); row++) {
        for (var column = first_column; column < min(first_column + TILES_PER_SUPERTILE, params.tile_columns); column++) {
            let at = params.tiles_at + (row * params.tile_columns + column) * 4u;
            let tile_cosine = bitcast<f32>(grid[at + 3u]);
            if tile_cosine <= 1.0 && cones_meet(axis, cosine, words_of_grid(at), tile_cosine) {
                tile(record, axis, chord, column * TILE, row * TILE);
            }
        }
    }
}

// Rays outside the cap around the polygon's corners are left out, too: towards the vanishing point of a sliver's long sides all edge
// planes meet, and rounded to f32 may hold rays there, far from the polygon.
fn tile(record: u32, axis: vec3f, chord: f32, first_column: u32, first_row: u32) {
    let m = vec3f(float_of(record), float_of(record + 1u), float_of(record + 2u));
    let slot = records[record + 3u];
    let edge_count = records[record + 4u];
    let edges = record + RECORD_WORDS;
    for (var row = first_row; row < min(first_row + TILE, params.height); row++) {
        for (var column = first_column; column < min(first_column + TILE, params.width); column++) {
            let pixel = row * params.width + column;
            // No ray is stored as zero: its inverse range is not above zero.
            let ray = words_of_grid(params.rays_at + pixel * 3u);
            let k = dot(m, ray);
            let apart = ray - axis;
            var inside = k > 0.0 && (chord < 0.0 || dot(apart, apart) <= chord);
            for (var e = 0u; inside && e < edge_count; e++) {
                let at = edges + e * EDGE_WORDS;
                inside = dot(vec3f(float_of(at), float_of(at + 1u), float_of(at + 2u)), ray) >= 0.0;
            }
            if inside {
                offer(pixel, k, slot);
            }
        }
    }
}
