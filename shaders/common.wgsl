// Declarations shared by all stages. The layouts have Rust twins in src/gpu/layout.rs; a test compares every offset.

// Arrangement of the rays (PixelGrid): image rows of a pinhole camera, image columns of a scanner, or a table.
const CAMERA: u32 = 0u;
const SCANNER: u32 = 1u;
const RAYS: u32 = 2u;
override GRID: u32 = 0u;

// Parameters of one wave. Fields that end in _at are word offsets into a buffer.
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
    // Room in buffers that shaders append to.
    record_words: u32,
    item_room: u32,
    // Into `outputs`.
    range_at: u32,
    depth_at: u32,
    polygon_at: u32,
    object_at: u32,
    cos_at: u32,
    // 1: polygon ids are source triangle numbers.
    source_ids: u32,
    // Camera: first and last line and sample, pixels from the principal point.
    first_line: f32,
    last_line: f32,
    first_sample: f32,
    last_sample: f32,
    // Camera: focal lengths; 1 for other sensors. line frame = (fy y, z, fx x) of the image frame.
    fx: f32,
    fy: f32,
    // Metres.
    range_min: f32,
    range_max: f32,
    // Frame number with the highest bit set, so that it differs from every record offset.
    stamp: u32,
    // Into `grid`, behind the sensor's tables: blocks of coarse depth, and blocks along a line.
    coarse_at: u32,
    coarse_columns: u32,
    // 1: earlier waves have drawn, and may hide polygons of this one.
    hiding: u32,
    // Into `grid`: bounds of forward-looking rays (cull_rays.wgsl); 0 for all others.
    ahead_at: u32,
    // Into `grid`: the direction map (direction_map.wgsl) and its number of levels; 0 without a map.
    map_at: u32,
    map_levels: u32,
    // Into `grid`: fitted quadratics from direction to pixel (pixel_fit.wgsl); 0 except for ray tables.
    fit_at: u32,
}

// One object. v = linear * ((p - center_high) - center_low) keeps precision for points near the sensor.
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
    // Edge-on polygons: f32 cannot decide their side.
    edge_on: atomic<u32>,
    // Workgroups of the next stages, in the layout of indirect dispatches.
    setup_groups: atomic<u32>,
    setup_y: u32,
    setup_z: u32,
    records: atomic<u32>,
    raster_groups: atomic<u32>,
    raster_y: u32,
    raster_z: u32,
    // Internal error: hits without an id.
    lost_ids: atomic<u32>,
    cull_groups: atomic<u32>,
    cull_y: u32,
    cull_z: u32,
    units: atomic<u32>,
    // The counts for the items of all waves.
    all_raster_groups: atomic<u32>,
    all_raster_y: u32,
    all_raster_z: u32,
    // Start of this wave's units, survivors and items.
    units_before: u32,
    survivors_before: u32,
    items_before: u32,
    // Workgroups that earlier waves dispatched indirectly.
    groups_before: u32,
    // Runs and polygons hidden by earlier waves.
    runs_hidden: atomic<u32>,
    polygons_hidden: atomic<u32>,
    // Polygons that the hardware rasterizer draws.
    shapes: atomic<u32>,
    // Draws of the survivors of this wave, and of all waves, in the layout of indirect draws.
    draw_vertices: u32,
    draw_instances: u32,
    draw_first_vertex: u32,
    draw_first_instance: u32,
    all_draw_vertices: u32,
    all_draw_instances: u32,
    all_draw_first_vertex: u32,
    all_draw_first_instance: u32,
}

// A polygon that passed the cull stage.
struct Survivor {
    polygon: u32,
    instance: u32,
    // First line and number of lines, 16 bits each; then the same for samples.
    lines: u32,
    samples: u32,
    // Bits NEAR and ONE_SIDED.
    flags: u32,
    // Written by setup for the hardware rasterizer: offset of the record or NO_RECORD, and the rectangle to draw as the
    // direction of a side, then bounds along and across it, in pixels from the image's upper left corner.
    record: u32,
    direction: vec2f,
    least: vec2f,
    greatest: vec2f,
}

const NO_RECORD: u32 = 0xffffffffu;
// Two triangles.
const SHAPE_VERTICES: u32 = 6u;

// The polygon's run is around the sensor: the CPU sets up its edge-on polygons, in f64.
const NEAR: u32 = 1u;
const ONE_SIDED: u32 = 2u;

const GROUP: u32 = 64u;
const MAX_GROUPS: u32 = 65535u;

// Words of a polygon in the arena. CORNERS: count | material << 8. NORMAL: three words. SPREAD: extent of its corners
// along the normal, metres.
const POLYGON_FIRST_CORNER: u32 = 0u;
const POLYGON_CORNERS: u32 = 1u;
const POLYGON_SOURCE: u32 = 2u;
const POLYGON_NORMAL: u32 = 3u;
const POLYGON_SPREAD: u32 = 6u;
const POLYGON_WORDS: u32 = 7u;
// A corner is the index of a vertex.
const CORNER_WORDS: u32 = 1u;
const VERTEX_WORDS: u32 = 3u;
// Words of a record, before edges of 3 words. M and CAP_AXIS: three words. CAP_CHORD: squared; negative without a cap.
const RECORD_M: u32 = 0u;
const RECORD_SLOT: u32 = 3u;
const RECORD_EDGE_COUNT: u32 = 4u;
const RECORD_CAP_AXIS: u32 = 5u;
const RECORD_CAP_CHORD: u32 = 8u;
const RECORD_WORDS: u32 = 9u;
const EDGE_WORDS: u32 = 3u;
// Words of an item. PART: first line | count << 16 (line grids) or first row | first column << 16 (ray grids).
// WITHIN: first sample | end << 16 (line grids) or end row | end column << 16 (ray grids).
const ITEM_RECORD: u32 = 0u;
const ITEM_PART: u32 = 1u;
const ITEM_WITHIN: u32 = 2u;
const ITEM_WORDS: u32 = 3u;
// Limits for items: most groups of lines of a polygon, fewest lines of a group, and samples of a wide polygon's item.
const ITEMS_PER_POLYGON: u32 = 256u;
const LINES_PER_ITEM: u32 = 4u;
const SAMPLES_PER_ITEM: u32 = 64u;

// Words of a slot that has a record. DISTANCE: plane distance, metres. SOURCE: source triangle number + 1. RECORD:
// offset of the record or, with the highest bit set, the stamp of the last frame in which the CPU set it up.
const SLOT_DISTANCE: u32 = 0u;
const SLOT_OBJECT: u32 = 1u;
const SLOT_SOURCE: u32 = 2u;
const SLOT_RECORD: u32 = 3u;
const SLOT_WORDS: u32 = 4u;

// Word indices of `items`, `items_before` and `survivors_before`, for stages that read Counters as plain words.
const COUNTED_ITEMS: u32 = 2u;
const COUNTED_ITEMS_BEFORE: u32 = 21u;
const COUNTED_SURVIVORS_BEFORE: u32 = 20u;

// Replaces infinity, so that comparisons stay well-defined. Vulkan states no precision for divisors over 2^126 =
// 8.5e37: NVIDIA's quotient is 0 there, so greater numbers are not used.
const HUGE: f32 = 1.0e37;
