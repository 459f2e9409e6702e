// Stage 2: one invocation per survivor. Writes edge planes, the inverse depth plane m, and items or a shape.

// The hardware rasterizer draws the polygons that it can draw exactly.
override RENDER: bool = false;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> arena: array<u32>;
@group(0) @binding(3) var<storage, read_write> survivors: array<Survivor>;
@group(0) @binding(4) var<storage, read> grid: array<u32>;
@group(0) @binding(5) var<storage, read_write> counters: Counters;
@group(0) @binding(6) var<storage, read_write> records: array<u32>;
@group(0) @binding(7) var<storage, read_write> items: array<u32>;
@group(0) @binding(8) var<storage, read_write> seen_slots: array<u32>;
@group(0) @binding(9) var<uniform> few_instances: array<Instance, FEW_INSTANCES>;

@compute @workgroup_size(64)
fn setup(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let count = atomicLoad(&counters.survivors);
    if RENDER && id.x == 0u {
        counters.draw_vertices = SHAPE_VERTICES * (count - counters.survivors_before);
        counters.all_draw_vertices = SHAPE_VERTICES * count;
    }
    for (var i = counters.survivors_before + id.x; i < count; i += groups.x * GROUP) {
        if RENDER {
            survivors[i].record = NO_RECORD;
        }
        set_up(i, survivors[i]);
    }
}

// Ratio |d| / |v| below which f32 cannot decide the side: rounding of two subtractions, a dot product and the normal.
const EDGE_ON: f32 = 9.6e-7; // 16 * 2^-24
// This ratio for |d| / |c|, because of the centre's own rounding, 2^-48 of its coordinates.
const EDGE_ON_CENTER: f32 = 2.9e-14; // 2^-45

fn set_up(index: u32, survivor: Survivor) {
    let instance = instance_at(survivor.instance);
    let first_corner =
        instance.corners_at + polygon_word(instance, survivor.polygon, POLYGON_FIRST_CORNER) * CORNER_WORDS;
    let corner_count = polygon_word(instance, survivor.polygon, POLYGON_CORNERS) & 0xffu;
    let normal = polygon_normal(instance, survivor.polygon);

    // Side and plane distance from the nearest vertex, in the mesh frame: this needs the fewest roundings.
    var nearest = HUGE;
    var distance = 0.0;
    for (var k = 0u; k < corner_count; k++) {
        let corner = first_corner + k * CORNER_WORDS;
        let q = from_center(instance, vertex(instance, arena[corner]));
        let length2 = dot(q, q);
        if length2 < nearest {
            nearest = length2;
            distance = dot(normal, q);
        }
    }
    let image_normal = normal_to_image(instance, normal);
    // No point is nearer than the plane. One-sided polygons show the side of their mesh's normal only, mirrored or not.
    let too_far = abs(distance) > params.range_max * length(image_normal) * 1.00001;
    if too_far || (survivor.flags & ONE_SIDED) != 0u && distance > 0.0 {
        return;
    }
    let near = (survivor.flags & NEAR) != 0u;
    let stamp = (instance.first_slot + survivor.polygon) * SLOT_WORDS + SLOT_RECORD;
    if near && seen_slots[stamp] == params.stamp {
        // Edge-on and around the sensor: the CPU has set it up in f64.
        return;
    }
    // If the sensor is within the corners' spread, the edges do not span a cone.
    let spread = bitcast<f32>(polygon_word(instance, survivor.polygon, POLYGON_SPREAD));
    let doubt = sqrt(nearest) * EDGE_ON + length(instance.center_high) * EDGE_ON_CENTER + spread;
    // The negated comparison treats NaN as doubtful.
    if !(abs(distance) > doubt) {
        // The CPU counts near polygons that are edge-on in f64.
        if !near {
            atomicAdd(&counters.edge_on, 1u);
        }
        return;
    }
    let words = RECORD_WORDS + corner_count * EDGE_WORDS;
    let at = atomicAdd(&counters.record_words, words);
    if at + words > params.record_words {
        // The engine reads the count, grows the buffer and runs the frame again.
        return;
    }
    atomicAdd(&counters.records, 1u);
    write_head(at, instance, survivor.polygon, corner_count, image_normal, distance);
    // Inside means every e . u >= 0; the sign combines winding, mirroring and side.
    let sign = select(-1.0, 1.0, instance.handedness * distance > 0.0);
    write_edges(at + RECORD_WORDS, instance, first_corner, corner_count, sign);
    add_items(at, index, instance, survivor, first_corner, corner_count);
}

// Transforms a covector from the image frame to the line frame.
fn to_line(e: vec3f) -> vec3f {
    if GRID == CAMERA {
        return vec3f(e.y / params.fy, e.z, e.x / params.fx);
    }
    if GRID == SCANNER {
        return vec3f(e.x, e.y, -e.z);
    }
    return e;
}

fn put(at: u32, v: vec3f) {
    records[at] = bitcast<u32>(v.x);
    records[at + 1u] = bitcast<u32>(v.y);
    records[at + 2u] = bitcast<u32>(v.z);
}

fn write_head(at: u32, instance: Instance, polygon: u32, corner_count: u32, normal: vec3f, distance: f32) {
    let slot = instance.first_slot + polygon;
    put(at + RECORD_M, to_line(normal / distance));
    records[at + RECORD_SLOT] = slot;
    records[at + RECORD_EDGE_COUNT] = corner_count;
    // For the resolve stage, and the record's offset for the visible stage.
    let seen = slot * SLOT_WORDS;
    seen_slots[seen + SLOT_DISTANCE] = bitcast<u32>(abs(distance) / length(normal));
    seen_slots[seen + SLOT_OBJECT] = instance.object_id;
    seen_slots[seen + SLOT_RECORD] = at;
    if params.source_ids != 0u {
        seen_slots[seen + SLOT_SOURCE] = instance.first_source + polygon_word(instance, polygon, POLYGON_SOURCE) + 1u;
    }
}

// An order of points on which both polygons of an edge agree.
fn before(p: vec3f, q: vec3f) -> bool {
    return p.x < q.x || p.x == q.x && (p.y < q.y || p.y == q.y && p.z < q.z);
}

fn write_edges(at: u32, instance: Instance, first_corner: u32, corner_count: u32, sign: f32) {
    var p = vertex(instance, arena[first_corner + (corner_count - 1u) * CORNER_WORDS]);
    var v = to_image(instance, from_center(instance, p));
    for (var k = 0u; k < corner_count; k++) {
        let p_next = vertex(instance, arena[first_corner + k * CORNER_WORDS]);
        let v_next = to_image(instance, from_center(instance, p_next));
        // The edge direction is rounded once, in the mesh frame. The nearer end is the anchor: its rounding moves no
        // point of the edge by more than 2^-22 rad. p - q = -(q - p) exactly, so neighbours agree.
        let direction = to_image(instance, p_next - p);
        let d = dot(v, v);
        let d_next = dot(v_next, v_next);
        let from_next = d_next < d || d_next == d && before(p_next, p);
        let anchor = select(v, v_next, from_next);
        put(at + k * EDGE_WORDS, to_line(sign * cross_exact(anchor, direction)));
        p = p_next;
        v = v_next;
    }
}

fn reserve_items(wanted: u32) -> u32 {
    let first = atomicAdd(&counters.items, wanted);
    let end = first + wanted;
    atomicMax(&counters.raster_groups, min((end - counters.items_before + GROUP - 1u) / GROUP, MAX_GROUPS));
    atomicMax(&counters.all_raster_groups, min((end + GROUP - 1u) / GROUP, MAX_GROUPS));
    return first;
}

fn put_item(index: u32, record: u32, part: u32, within: u32) {
    if index < params.item_room {
        items[index * ITEM_WORDS + ITEM_RECORD] = record;
        items[index * ITEM_WORDS + ITEM_PART] = part;
        items[index * ITEM_WORDS + ITEM_WITHIN] = within;
    }
}
