//! The extensions of glTF that presight knows.

/// Extensions that change the appearance of a surface or describe it, but not its shape; and motions, which do not
/// change the scene at rest.
const HARMLESS: [&str; 13] = [
    "KHR_materials_",
    "ADOBE_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "MSFT_texture_",
    "KHR_lights_punctual",
    "EXT_lights_",
    "KHR_xmp",
    "KHR_mesh_quantization",
    "KHR_animation_pointer",
    "EXT_structural_metadata",
    "EXT_mesh_features",
    "EXT_instance_features",
];

pub(super) const INSTANCING: &str = "EXT_mesh_gpu_instancing";
pub(super) const VISIBILITY: &str = "KHR_node_visibility";
pub(super) const RTC: &str = "CESIUM_RTC";

/// True for an extension that presight follows, or whose data do not change the shape of the scene at rest.
pub(super) fn is_known(extension: &str) -> bool {
    [INSTANCING, VISIBILITY].contains(&extension) || HARMLESS.iter().any(|known| extension.starts_with(known))
}
