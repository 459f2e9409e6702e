//! Structures shared with the shaders. A test compares every offset with the WGSL, parsed by naga.

use bytemuck::{Pod, Zeroable};

/// Arrangement of the rays; `GRID` in the shaders.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u32)]
pub(super) enum GridKind {
    Camera = 0,
    Scanner = 1,
    Rays = 2,
}

impl GridKind {
    /// The constant that selects this kind in the shaders.
    pub fn constant(self) -> (&'static str, f64) {
        ("GRID", f64::from(self as u32))
    }
}

/// `Params` in common.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Params {
    pub line_count: u32,
    pub sample_count: u32,
    pub width: u32,
    pub height: u32,
    pub lines_at: u32,
    pub weights_at: u32,
    pub positions_at: u32,
    pub line_buckets_at: u32,
    pub sample_buckets_at: u32,
    pub line_buckets: u32,
    pub sample_buckets: u32,
    pub tiles_at: u32,
    pub rays_at: u32,
    pub tile_columns: u32,
    pub tile_count: u32,
    pub units_at: u32,
    pub facings_at: u32,
    pub first_run: u32,
    pub end_run: u32,
    pub record_words: u32,
    pub item_room: u32,
    pub range_at: u32,
    pub depth_at: u32,
    pub polygon_at: u32,
    pub object_at: u32,
    pub cos_at: u32,
    pub source_ids: u32,
    pub first_line: f32,
    pub last_line: f32,
    pub first_sample: f32,
    pub last_sample: f32,
    pub fx: f32,
    pub fy: f32,
    pub range_min: f32,
    pub range_max: f32,
    pub stamp: u32,
    pub coarse_at: u32,
    pub coarse_columns: u32,
    pub hiding: u32,
    pub ahead_at: u32,
    pub map_at: u32,
    pub map_levels: u32,
    pub fit_at: u32,
}

/// `Instance` in common.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Instance {
    pub linear_x: [f32; 3],
    pub handedness: f32,
    pub linear_y: [f32; 3],
    pub first_slot: u32,
    pub linear_z: [f32; 3],
    pub first_source: u32,
    pub normal_x: [f32; 3],
    pub object_id: u32,
    pub normal_y: [f32; 3],
    pub polygons_at: u32,
    pub normal_z: [f32; 3],
    pub corners_at: u32,
    pub center_high: [f32; 3],
    pub vertices_at: u32,
    pub center_low: [f32; 3],
    pub padding: u32,
}

/// `Counters` in common.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Counters {
    pub survivors: u32,
    pub record_words: u32,
    pub items: u32,
    pub edge_on: u32,
    pub setup_groups: u32,
    pub setup_y: u32,
    pub setup_z: u32,
    pub records: u32,
    pub raster_groups: u32,
    pub raster_y: u32,
    pub raster_z: u32,
    pub lost_ids: u32,
    pub cull_groups: u32,
    pub cull_y: u32,
    pub cull_z: u32,
    pub units: u32,
    pub all_raster_groups: u32,
    pub all_raster_y: u32,
    pub all_raster_z: u32,
    pub units_before: u32,
    pub survivors_before: u32,
    pub items_before: u32,
    pub groups_before: u32,
    pub runs_hidden: u32,
    pub polygons_hidden: u32,
    pub shapes: u32,
    pub draw_vertices: u32,
    pub draw_instances: u32,
    pub draw_first_vertex: u32,
    pub draw_first_instance: u32,
    pub all_draw_vertices: u32,
    pub all_draw_instances: u32,
    pub all_draw_first_vertex: u32,
    pub all_draw_first_instance: u32,
}

/// `Survivor` in common.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Survivor {
    pub polygon: u32,
    pub instance: u32,
    pub lines: u32,
    pub samples: u32,
    pub flags: u32,
    pub record: u32,
    pub direction: [f32; 2],
    pub least: [f32; 2],
    pub greatest: [f32; 2],
}

/// A polygon in the arena; `POLYGON_` in common.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct ArenaPolygon {
    pub first_corner: u32,
    /// Number of corners in the lower 8 bits, material in the higher 24 bits.
    pub corners: u32,
    pub source: u32,
    pub normal: [f32; 3],
    pub spread: f32,
}

/// A polygon after setup, without its edges; `RECORD_` in common.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Record {
    pub m: [f32; 3],
    pub slot: u32,
    pub edge_count: u32,
    pub cap_axis: [f32; 3],
    /// Squared chord of the cap; negative without a cap.
    pub cap_chord: f32,
}

/// A slot that has a record; `SLOT_` in common.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Slot {
    pub distance: f32,
    pub object: u32,
    pub source: u32,
    /// Offset of its record, or a stamp.
    pub record: u32,
}

/// A run of polygons in the work table; `RUN_` in runs.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct WorkRun {
    pub instance: u32,
    pub polygon: u32,
    /// Number of polygons; may include [`RUN_NEAR`].
    pub count: u32,
    /// Offset of its cluster's box in the arena.
    pub r#box: u32,
}

/// A level of the direction map; `LEVEL_` in direction_map.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct MapLevel {
    /// Squared sine of the largest half angle of its cones.
    pub sine2: f32,
    pub across: u32,
    /// The six sides of a cube.
    pub sides: [MapSide; 6],
}

/// A direction cell with its quadratics; `FIT_` in pixel_fit.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct PackedFit {
    pub off: [f32; 2],
    pub bend: [f32; 2],
    pub column: [f32; 6],
    pub row: [f32; 6],
}

/// A side of a level; `SIDE_` in direction_map.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct MapSide {
    pub first: [u32; 2],
    pub count: [u32; 2],
    /// Offset of its first box in the grid, words.
    pub boxes_at: u32,
}

/// A part of a polygon's image; `ITEM_` in common.wgsl.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Item {
    pub record: u32,
    /// Line grids: first line, number of lines in the higher 16 bits. Ray grids: first row and column.
    pub part: u32,
    /// Line grids: first sample, end in the higher 16 bits. Ray grids: end row and column.
    pub within: u32,
}

/// Size in words of a type that shaders read word by word.
pub(super) const fn words_of<T>() -> u32 {
    (size_of::<T>() / size_of::<u32>()) as u32
}

/// Invocations of a workgroup; `GROUP` in the shaders.
pub(super) const GROUP: u32 = 64;
/// Maximum size of one dispatch dimension.
pub(super) const MAX_GROUPS: u32 = 65_535;
/// Words of a polygon in the arena.
pub(super) const POLYGON_WORDS: u32 = words_of::<ArenaPolygon>();
/// Words of a corner in the arena.
pub(super) const CORNER_WORDS: u32 = 1;
/// Words of a vertex in the arena.
pub(super) const VERTEX_WORDS: u32 = 3;
/// Words of a run in the work table.
pub(super) const RUN_WORDS: usize = words_of::<WorkRun>() as usize;
/// Flag in a run's count: the run is around the sensor.
pub(super) const RUN_NEAR: u32 = 1 << 31;
/// Polygons of a unit; runs are culled by units.
pub(super) const UNIT: u32 = 8;
/// Bits of a unit's number within its run.
pub(super) const UNIT_SHIFT: u32 = 3;
/// Words of a cluster's box in the arena.
pub(super) const BOX_WORDS: u32 = 6;
/// Side of the tiles of coarse depth.
pub(super) const TILE_SIDE: u32 = 8;
/// Tiles along a side of a block of coarse depth.
pub(super) const TILES_PER_BLOCK: u32 = 8;
/// Words of a block of coarse depth.
pub(super) const BLOCK_WORDS: u32 = 85;
/// Maximum number of waves of a frame.
pub(super) const MAX_WAVES: usize = 4;
/// Bytes between the parameters of waves; satisfies every device's alignment of uniform offsets.
pub(super) const WAVE_BYTES: u64 = 256;
/// Words of a record before its edges.
pub(super) const RECORD_WORDS: u32 = words_of::<Record>();
/// Words of a slot that has a record.
pub(super) const SLOT_WORDS: u32 = words_of::<Slot>();
/// Maximum number of instances that fit the uniform buffer.
pub(super) const FEW_INSTANCES: u32 = 512;
/// Maximum size of ray tables in the uniform buffer, in groups of four words.
pub(super) const SHORT_GRID: u32 = 4096;
/// Words of an edge.
pub(super) const EDGE_WORDS: u32 = 3;
/// Words of an item.
pub(super) const ITEM_WORDS: u32 = words_of::<Item>();
/// Maximum number of items of one polygon on a line grid.
pub(super) const ITEMS_PER_POLYGON: u32 = 256;
/// Minimum number of lines of an item.
pub(super) const LINES_PER_ITEM: u32 = 4;
/// Samples of a line in an item of a wide polygon.
pub(super) const SAMPLES_PER_ITEM: u32 = 64;
/// Words of a level of the direction map.
pub(super) const LEVEL_WORDS: u32 = words_of::<MapLevel>();
/// Words of a pixel box in the direction map.
pub(super) const PIXEL_BOX_WORDS: u32 = 2;
/// Tiles along a side of a supertile.
pub(super) const TILES_PER_SUPERTILE: u32 = 8;

/// Workgroups in two dimensions for this many invocations.
pub(super) fn groups_for(invocations: u32) -> [u32; 2] {
    let groups = invocations.div_ceil(GROUP);
    let rows = groups.div_ceil(MAX_GROUPS);
    if rows == 0 { [0, 0] } else { [groups.div_ceil(rows), rows] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_cover_all_invocations() {
        for n in [0, 1, 64, 65, 64 * MAX_GROUPS, 64 * MAX_GROUPS + 1, 1 << 26] {
            let [x, y] = groups_for(n);
            assert!(x <= MAX_GROUPS && u64::from(x) * u64::from(y) * 64 >= u64::from(n));
        }
    }
}
