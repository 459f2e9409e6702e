// A pinhole camera by the hardware rasterizer: corners are placed by it, inverse depth and id are ours.

struct Camera {
    // Pixels.
    focal: vec2f,
    center: vec2f,
    size: vec2f,
}

// v = linear * ((p - center_high) - center_low), as in the engine's shaders.
struct Instance {
    linear_x: vec3f,
    first_slot: u32,
    linear_y: vec3f,
    linear_z: vec3f,
    normal_x: vec3f,
    normal_y: vec3f,
    normal_z: vec3f,
    center_high: vec3f,
    center_low: vec3f,
}

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;

// Metres: what is nearer is clipped. A power of two: inverse depth times it keeps every digit and is the depth.
const NEAR: f32 = 0.0009765625;

struct Corner {
    @builtin(position) position: vec4f,
    // n / d of the polygon's plane, image frame.
    @location(0) @interpolate(flat, first) m: vec3f,
    // |d| of the unit normal.
    @location(1) @interpolate(flat, first) distance: f32,
    @location(2) @interpolate(flat, first) id: u32,
}

@vertex
fn corner(
    @builtin(instance_index) index: u32,
    @location(0) p: vec3f,
    @location(1) normal: vec3f,
    @location(2) polygon: u32,
) -> Corner {
    let i = instances[index];
    let q = (p - i.center_high) - i.center_low;
    let v = i.linear_x * q.x + i.linear_y * q.y + i.linear_z * q.z;
    let n = i.normal_x * normal.x + i.normal_y * normal.y + i.normal_z * normal.z;
    let d = dot(normal, q);
    let at = camera.focal * v.xy + (camera.center + 0.5) * v.z;
    let clip = 2.0 * at / camera.size - v.z;
    return Corner(vec4f(clip.x, -clip.y, NEAR, v.z), n / d, abs(d) / length(n), i.first_slot + polygon + 1u);
}

struct Pixel {
    @location(0) id: u32,
    @location(1) cosine: f32,
    @builtin(frag_depth) depth: f32,
}

@fragment
fn pixel(at: Corner) -> Pixel {
    let ray = vec3f((at.position.xy - 0.5 - camera.center) / camera.focal, 1.0);
    let k = dot(at.m, ray);
    if !(k > 0.0) {
        discard;
    }
    return Pixel(at.id, min(1.0, k * at.distance / length(ray)), k * NEAR);
}
