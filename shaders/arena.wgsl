// Access to resident geometry: meshes in their own frame, one copy for all instances. Functions take a loaded Instance,
// because not every driver hoists loads out of loops.

// True if the instances fit a uniform buffer, which software adapters read several times faster.
override FEW: bool = false;
const FEW_INSTANCES: u32 = 512u;

fn instance_at(index: u32) -> Instance {
    if FEW {
        return few_instances[index];
    }
    return instances[index];
}

fn polygon_word(instance: Instance, polygon: u32, word: u32) -> u32 {
    return arena[instance.polygons_at + polygon * POLYGON_WORDS + word];
}

fn polygon_normal(instance: Instance, polygon: u32) -> vec3f {
    let at = instance.polygons_at + polygon * POLYGON_WORDS + POLYGON_NORMAL;
    return vec3f(bitcast<f32>(arena[at]), bitcast<f32>(arena[at + 1u]), bitcast<f32>(arena[at + 2u]));
}

fn vertex(instance: Instance, index: u32) -> vec3f {
    let at = instance.vertices_at + index * VERTEX_WORDS;
    return vec3f(bitcast<f32>(arena[at]), bitcast<f32>(arena[at + 1u]), bitcast<f32>(arena[at + 2u]));
}

// A vertex relative to the sensor, in the mesh frame: relative accuracy of about 2^-23 at any distance.
fn from_center(instance: Instance, p: vec3f) -> vec3f {
    return (p - instance.center_high) - instance.center_low;
}

// Rotates and scales a direction from the mesh frame into the image frame.
fn to_image(instance: Instance, q: vec3f) -> vec3f {
    return instance.linear_x * q.x + instance.linear_y * q.y + instance.linear_z * q.z;
}

fn normal_to_image(instance: Instance, n: vec3f) -> vec3f {
    return instance.normal_x * n.x + instance.normal_y * n.y + instance.normal_z * n.z;
}
