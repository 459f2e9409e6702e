// What all stages share. Layouts here have Rust twins in src/gpu/layout.rs; a test compares every offset.

// How the rays lie (PixelGrid): image rows of a pinhole camera, image columns of a scanner, or a table.
const CAMERA: u32 = 0u;
const SCANNER: u32 = 1u;
const RAYS: u32 = 2u;
override GRID: u32 = 0u;

// Work of one frame. Fields that end in _at are word offsets into a buffer.
struct Params {
    // Lines and samples of a line grid; height and width of a ray grid.
    line_count: u32,
    sample_count: u32,
    width: u32,
    height: u32,
    // Into `grid`: lines (c0, c1, column), weights (w0, w1), positions t, bucket tables; ray grids: tiles and rays.
    lines_at: u32,
    weights_at: u32,
    positions_at: u32,
    line_buckets_at: u32,
    sample_buckets_at: u32,
    line_buckets: u32,
    sample_buckets: u32,
    tiles_at: u32,
    rays_at: u32,
    tile_columns: u32,
    tile_count: u32,
    // Into `work`: units of the waves, facings by material.
    units_at: u32,
    facings_at: u32,
    // The runs of this wave.
    first_run: u32,
    end_run: u32,
    // Room in buffers that are appended to.
    record_words: u32,
    item_room: u32,
    // Into `outputs`.
    range_at: u32,
    depth_at: u32,
    polygon_at: u32,
    object_at: u32,
    cos_at: u32,
    // 1: polygon ids are numbers of source triangles.
    source_ids: u32,
    // Camera: first and last line and sample, pixels from the principal point.
    first_line: f32,
    last_line: f32,
    first_sample: f32,
    last_sample: f32,
    // Camera: focal lengths; 1 for everything else. line frame = (fy y, z, fx x) of the image frame.
    fx: f32,
    fy: f32,
    // Metres.
    range_min: f32,
    range_max: f32,
    // Number of this frame, with the highest bit set: no place of a record is as large.
    stamp: u32,
    // Into `grid`, behind the sensor's tables: blocks of coarse depth, and blocks along a line.
    coarse_at: u32,
    coarse_columns: u32,
    // 1: earlier waves have drawn, and may hide what this one holds.
    hiding: u32,
    // Into `grid`: where rays that all look ahead lie (cull_rays.wgsl); 0 for all others.
    ahead_at: u32,
    // Into `grid`: the map of directions (direction_map.wgsl), and its levels; none without one.
    map_at: u32,
    map_levels: u32,
    // Into `grid`: where directions lie (pixel_fit.wgsl); 0 for all but ray tables.
    fit_at: u32,
}

// One object. v = linear * ((p - center_high) - center_low) keeps the digits of what is near.
struct Instance {
    linear_x: vec3f,
    // -1 if the linear part mirrors.
    handedness: f32,
    linear_y: vec3f,
    first_slot: u32,
    linear_z: vec3f,
    first_source: u32,
    normal_x: vec3f,
    object_id: u32,
    normal_y: vec3f,
    polygons_at: u32,
    normal_z: vec3f,
    corners_at: u32,
    center_high: vec3f,
    vertices_at: u32,
    center_low: vec3f,
    padding: u32,
}

// Counters that stages add to; read back with the images.
struct Counters {
    survivors: atomic<u32>,
    record_words: atomic<u32>,
    items: atomic<u32>,
    // Polygons whose side f32 cannot prove: edge-on.
    edge_on: atomic<u32>,
    // Workgroups of the next stages, as indirect dispatches take them.
    setup_groups: atomic<u32>,
    setup_y: u32,
    setup_z: u32,
    records: atomic<u32>,
    raster_groups: atomic<u32>,
    raster_y: u32,
    raster_z: u32,
    // Internal errors: a hit without an id.
    lost_ids: atomic<u32>,
    cull_groups: atomic<u32>,
    cull_y: u32,
    cull_z: u32,
    units: atomic<u32>,
    // For the items of all waves.
    all_raster_groups: atomic<u32>,
    all_raster_y: u32,
    all_raster_z: u32,
    // Where this wave's units, survivors and items begin.
    units_before: u32,
    survivors_before: u32,
    items_before: u32,
    // Workgroups that earlier waves dispatched by counters.
    groups_before: u32,
    // What earlier waves hide.
    runs_hidden: atomic<u32>,
    polygons_hidden: atomic<u32>,
    // Polygons that the hardware rasterizer draws.
    shapes: atomic<u32>,
    // Draws of the survivors of this wave, and of all waves, as indirect draws take them.
    draw_vertices: u32,
    draw_instances: u32,
    draw_first_vertex: u32,
    draw_first_instance: u32,
    all_draw_vertices: u32,
    all_draw_instances: u32,
    all_draw_first_vertex: u32,
    all_draw_first_instance: u32,
}

// A polygon that passed the cull.
struct Survivor {
    polygon: u32,
    instance: u32,
    // First line and number of lines, 16 bits each; the same of samples.
    lines: u32,
    samples: u32,
    // NEAR, ONE_SIDED.
    flags: u32,
    // Set by setup: where the record is that the hardware rasterizer draws, or NO_RECORD, and the rectangle to draw: the direction of a
    // side, its least and greatest place along and across it, pixels of the image from its upper left corner.
    record: u32,
    direction: vec2f,
    least: vec2f,
    greatest: vec2f,
}

const NO_RECORD: u32 = 0xffffffffu;
// Two triangles.
const SHAPE_VERTICES: u32 = 6u;

// Its run is around the sensor: the CPU sets up what is flat, in f64.
const NEAR: u32 = 1u;
const ONE_SIDED: u32 = 2u;

const GROUP: u32 = 64u;
const MAX_GROUPS: u32 = 65535u;

// Words of a polygon in the arena. CORNERS: count | material << 8. NORMAL: three words. SPREAD: how far its corners are
// apart along the normal, metres.
const POLYGON_FIRST_CORNER: u32 = 0u;
const POLYGON_CORNERS: u32 = 1u;
const POLYGON_SOURCE: u32 = 2u;
const POLYGON_NORMAL: u32 = 3u;
const POLYGON_SPREAD: u32 = 6u;
const POLYGON_WORDS: u32 = 7u;
// A corner: its vertex.
const CORNER_WORDS: u32 = 1u;
const VERTEX_WORDS: u32 = 3u;
// Words of a record, then edges of 3 words. M and CAP_AXIS: three words. CAP_CHORD: squared; negative is no cap.
const RECORD_M: u32 = 0u;
const RECORD_SLOT: u32 = 3u;
const RECORD_EDGE_COUNT: u32 = 4u;
const RECORD_CAP_AXIS: u32 = 5u;
const RECORD_CAP_CHORD: u32 = 8u;
const RECORD_WORDS: u32 = 9u;
const EDGE_WORDS: u32 = 3u;
// Words of an item. PART: first line | count << 16 (line grids) or first row | first column << 16 (ray grids). WITHIN: first sample |
// end << 16 (line grids) or end of rows | end of columns << 16 (ray grids).
const ITEM_RECORD: u32 = 0u;
const ITEM_PART: u32 = 1u;
const ITEM_WITHIN: u32 = 2u;
const ITEM_WORDS: u32 = 3u;
// The most stretches of lines that one polygon is cut into, the fewest lines of one, and the samples of a line in an item of a wide one.
const ITEMS_PER_POLYGON: u32 = 256u;
const LINES_PER_ITEM: u32 = 4u;
const SAMPLES_PER_ITEM: u32 = 64u;

// Words of a slot that has a record. DISTANCE: |d| of the unit normal. SOURCE: number of the source triangle + 1. RECORD:
// where the record is, or, with the highest bit set, the stamp of the last frame in which the CPU set it up.
const SLOT_DISTANCE: u32 = 0u;
const SLOT_OBJECT: u32 = 1u;
const SLOT_SOURCE: u32 = 2u;
const SLOT_RECORD: u32 = 3u;
const SLOT_WORDS: u32 = 4u;

// Where stages that read Counters as plain words find `items`, `items_before` and `survivors_before`.
const COUNTED_ITEMS: u32 = 2u;
const COUNTED_ITEMS_BEFORE: u32 = 21u;
const COUNTED_SURVIVORS_BEFORE: u32 = 20u;

// Stands for infinity where comparisons must stay well-defined.
const HUGE: f32 = 3.0e38;
