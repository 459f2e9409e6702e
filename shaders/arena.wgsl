// Reading resident geometry: meshes in their own frame, one copy for all instances.

fn polygon_word(instance: u32, polygon: u32, word: u32) -> u32 {
    return arena[instances[instance].polygons_at + polygon * POLYGON_WORDS + word];
}

fn polygon_normal(instance: u32, polygon: u32) -> vec3f {
    let at = instances[instance].polygons_at + polygon * POLYGON_WORDS + 3u;
    return vec3f(bitcast<f32>(arena[at]), bitcast<f32>(arena[at + 1u]), bitcast<f32>(arena[at + 2u]));
}

fn vertex(instance: u32, index: u32) -> vec3f {
    let at = instances[instance].vertices_at + index * VERTEX_WORDS;
    return vec3f(bitcast<f32>(arena[at]), bitcast<f32>(arena[at + 1u]), bitcast<f32>(arena[at + 2u]));
}

// A vertex relative to the sensor, mesh frame: relative accuracy of about 2^-23 at any distance.
fn from_center(instance: u32, p: vec3f) -> vec3f {
    return (p - instances[instance].center_high) - instances[instance].center_low;
}

// A direction of the mesh frame in the image frame.
fn to_image(instance: u32, q: vec3f) -> vec3f {
    return instances[instance].linear_x * q.x + instances[instance].linear_y * q.y + instances[instance].linear_z * q.z;
}

fn normal_to_image(instance: u32, n: vec3f) -> vec3f {
    return instances[instance].normal_x * n.x + instances[instance].normal_y * n.y + instances[instance].normal_z * n.z;
}
