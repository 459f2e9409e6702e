//! The properties of glTF 2.0 that presight uses, as the specification's schema describes them.

/// What a property may hold.
pub(super) enum Kind {
    /// A whole number up to `u32::MAX`: the number of an entry, or a code.
    Index,
    /// A whole number.
    Count,
    Number,
    Text,
    Flag,
    /// Any JSON; it is copied.
    Raw,
    /// This number of numbers.
    Numbers(usize),
    List(&'static Kind),
    /// An object whose properties have any names.
    Map(&'static Kind),
    Object(&'static [Property]),
    /// An object of extensions. The names of extensions that are not listed are kept, with null in place of their data.
    Extensions(&'static [Property]),
}

/// A property of an object.
pub(super) struct Property {
    pub name: &'static str,
    pub kind: Kind,
    pub presence: Presence,
}

/// If an object must have a property.
pub(super) enum Presence {
    Required,
    Optional,
    /// Optional in the schema, but not for the crate `gltf`: this JSON stands for an absent one.
    Default(&'static str),
}

const fn required(name: &'static str, kind: Kind) -> Property {
    Property { name, kind, presence: Presence::Required }
}

const fn optional(name: &'static str, kind: Kind) -> Property {
    Property { name, kind, presence: Presence::Optional }
}

const fn extensions(known: &'static [Property]) -> Property {
    optional("extensions", Kind::Extensions(known))
}

/// A whole scene file.
pub(super) static ROOT: Kind = Kind::Object(&[
    required("asset", Kind::Object(&[required("version", Kind::Text), optional("minVersion", Kind::Text)])),
    optional("extensionsUsed", Kind::List(&Kind::Text)),
    optional("extensionsRequired", Kind::List(&Kind::Text)),
    extensions(&[optional("CESIUM_RTC", Kind::Object(&[optional("center", Kind::Numbers(3))]))]),
    optional("scene", Kind::Index),
    optional("scenes", Kind::List(&SCENE)),
    optional("nodes", Kind::List(&NODE)),
    optional("skins", Kind::List(&SKIN)),
    optional("meshes", Kind::List(&MESH)),
    optional("materials", Kind::List(&MATERIAL)),
    optional("accessors", Kind::List(&ACCESSOR)),
    optional("bufferViews", Kind::List(&VIEW)),
    optional("buffers", Kind::List(&BUFFER)),
    optional("images", Kind::List(&Kind::Object(&[optional("uri", Kind::Text)]))),
]);

static SCENE: Kind =
    Kind::Object(&[Property { name: "nodes", kind: Kind::List(&Kind::Index), presence: Presence::Default("[]") }]);

static NODE: Kind = Kind::Object(&[
    optional("name", Kind::Text),
    optional("mesh", Kind::Index),
    optional("skin", Kind::Index),
    optional("children", Kind::List(&Kind::Index)),
    optional("matrix", Kind::Numbers(16)),
    optional("translation", Kind::Numbers(3)),
    optional("rotation", Kind::Numbers(4)),
    optional("scale", Kind::Numbers(3)),
    extensions(&[
        optional("KHR_node_visibility", Kind::Object(&[optional("visible", Kind::Flag)])),
        optional("EXT_mesh_gpu_instancing", Kind::Object(&[required("attributes", INSTANCES)])),
    ]),
    optional("extras", Kind::Raw),
]);

const INSTANCES: Kind = Kind::Object(&[
    optional("TRANSLATION", Kind::Index),
    optional("ROTATION", Kind::Index),
    optional("SCALE", Kind::Index),
]);

static SKIN: Kind =
    Kind::Object(&[required("joints", Kind::List(&Kind::Index)), optional("inverseBindMatrices", Kind::Index)]);

static MESH: Kind = Kind::Object(&[
    optional("name", Kind::Text),
    required("primitives", Kind::List(&PRIMITIVE)),
    extensions(&[]),
    optional("extras", Kind::Raw),
]);

static PRIMITIVE: Kind = Kind::Object(&[
    required("attributes", Kind::Map(&Kind::Index)),
    optional("indices", Kind::Index),
    optional("material", Kind::Index),
    optional("mode", Kind::Index),
    optional("targets", Kind::List(&Kind::Map(&Kind::Index))),
    extensions(&[]),
]);

static MATERIAL: Kind = Kind::Object(&[
    optional("name", Kind::Text),
    optional("pbrMetallicRoughness", Kind::Object(&[optional("baseColorFactor", Kind::Numbers(4))])),
    optional("alphaMode", Kind::Text),
    extensions(&[optional(
        "KHR_materials_transmission",
        Kind::Object(&[optional("transmissionFactor", Kind::Number)]),
    )]),
    optional("extras", Kind::Raw),
]);

static ACCESSOR: Kind = Kind::Object(&[
    optional("bufferView", Kind::Index),
    optional("byteOffset", Kind::Count),
    required("componentType", Kind::Index),
    optional("normalized", Kind::Flag),
    required("count", Kind::Count),
    required("type", Kind::Text),
    optional("sparse", SPARSE),
]);

const SPARSE: Kind = Kind::Object(&[
    required("count", Kind::Count),
    required(
        "indices",
        Kind::Object(&[
            required("bufferView", Kind::Index),
            optional("byteOffset", Kind::Count),
            required("componentType", Kind::Index),
        ]),
    ),
    required("values", Kind::Object(&[required("bufferView", Kind::Index), optional("byteOffset", Kind::Count)])),
]);

static VIEW: Kind = Kind::Object(&[
    required("buffer", Kind::Index),
    optional("byteOffset", Kind::Count),
    required("byteLength", Kind::Count),
    optional("byteStride", Kind::Count),
]);

static BUFFER: Kind = Kind::Object(&[required("byteLength", Kind::Count), optional("uri", Kind::Text)]);
