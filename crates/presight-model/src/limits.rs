//! Limits on all inputs, so that none can take unbounded memory or time.

/// Longest image side, in pixels.
pub const MAX_IMAGE_SIDE: u32 = 16_384;
/// Most rays of a table of one row, which is a list of rays rather than an image.
pub const MAX_LISTED_RAYS: u32 = 1_000_000;
/// Most pixels of one image.
pub const MAX_PIXELS: u64 = 1 << 26;
/// Most polygons of one environment; ids are 32 bits and 0 means none.
pub const MAX_POLYGONS: u64 = 1 << 28;
/// Most objects of one environment.
pub const MAX_OBJECTS: usize = 1 << 22;
/// Most corners of one polygon.
pub const MAX_CORNERS: usize = 64;
/// Most worker threads of one pool, or twice the cores if that is more.
pub const MAX_THREADS: usize = 64;
/// Largest file read into memory, in bytes.
pub const MAX_FILE_BYTES: u64 = 4 << 30;
/// Most bytes of memory, as estimated in advance, for importing a scene file (with its buffers) or reading JSON.
pub const MAX_IMPORT_BYTES: u64 = 4 << 30;
/// Largest settings file (sensor, robot or materials), in bytes: parsed TOML takes about a dozen times as much.
pub const MAX_SETTINGS_BYTES: u64 = 32 << 20;
/// Polygons of one mesh cluster, the unit that selection keeps or drops.
pub const CLUSTER_POLYGONS: usize = 64;
/// Largest finite coordinate or range accepted, in metres; squares of larger ones overflow f32.
pub const MAX_COORDINATE: f64 = 1e12;
/// Most triangles stored in one scene file, instances counted once.
pub const MAX_STORED_TRIANGLES: u64 = 1 << 25;
/// Most elements of an accessor without data (zeros, replaced by a sparse part).
pub const MAX_ZERO_FILLED: u64 = 1 << 16;
/// Deepest nesting of nodes.
pub const MAX_NODE_DEPTH: usize = 1024;
/// Longest full node path, in bytes.
pub const MAX_NAME_BYTES: usize = 4096;
/// Problems of one kind that are listed with their place; further ones are only counted.
pub const LISTED_PROBLEMS: usize = 20;
/// Largest tolerance for merging triangles, relative to the size of the mesh.
pub const MAX_MERGE_TOLERANCE: f64 = 1e-3;
/// Most steps of generating features where polygons overlap, each about ten nanoseconds of one core: some seconds.
pub const MAX_FEATURE_STEPS: u64 = 1 << 29;
/// Most corners examined near sides of polygons, to find where smooth surfaces continue: a second or two.
pub const MAX_CONTOUR_STEPS: u64 = 1 << 27;
/// Most polygons of all contours of a feature layer together.
pub const MAX_CONTOUR_FACETS: u64 = 1 << 22;
/// Most polygons within a layer's tolerance of its features, summed over the features: a minute or two.
pub const MAX_PLACING_PAIRS: u64 = 1 << 28;
/// Most grid places at which a layer is rated.
pub const MAX_WORTH_PLACES: u64 = 1 << 20;
/// Most facets around a round solid, or steps of stairs.
pub const MAX_FACETS: u32 = 1024;
/// Most points of an extruded outline.
pub const MAX_OUTLINE: usize = 512;
/// Largest scene script or script module, in bytes.
pub const MAX_SCRIPT_BYTES: u64 = 1 << 20;
/// Most bytes of a script and all its modules together.
pub const MAX_SCRIPT_TEXT: usize = 4 << 20;
/// Most operations of a script and its modules: some seconds. Large values count by size, which also bounds maps.
pub const MAX_SCRIPT_OPERATIONS: u64 = 5_000_000;
/// Most seconds of a script, without importing and building: a last resort that a valid script should not reach.
pub const MAX_SCRIPT_SECONDS: u64 = 30;
/// Largest value of a module's variable, in elements, including elements of nested arrays (16 bytes of text count as
/// one): it is copied at every use.
pub const MAX_SCRIPT_EXPORT: usize = 64;
/// Longest string literal in a script, in bytes.
pub const MAX_SCRIPT_LITERAL: usize = 4096;
/// Deepest nesting of calls in a script.
pub const MAX_SCRIPT_CALLS: usize = 32;
/// Deepest nesting of expressions and statements in a script.
pub const MAX_SCRIPT_NESTING: usize = 128;
/// Most variables of one call in a script.
pub const MAX_SCRIPT_VARIABLES: usize = 256;
/// Most arguments of a call in a script, and parameters of a function.
pub const MAX_SCRIPT_ARGUMENTS: usize = 12;
/// Most functions of a script or script module.
pub const MAX_SCRIPT_FUNCTIONS: usize = 256;
/// Longest name of a variable or function in a script, in bytes.
pub const MAX_SCRIPT_NAME: usize = 256;
/// Most elements of an array in a script, including elements of nested arrays.
pub const MAX_SCRIPT_ARRAY: usize = 4096;
/// Most copies of a shape that `repeat` makes.
pub const MAX_SCRIPT_REPEAT: u32 = 16_384;
/// Most entries of an object map in a script.
pub const MAX_SCRIPT_MAP: usize = 1024;
/// Longest string in a script, in bytes.
pub const MAX_SCRIPT_STRING: usize = 16_384;
/// Most modules of a script.
pub const MAX_SCRIPT_MODULES: usize = 64;
/// Lines that a script may print; further ones are dropped.
pub const MAX_SCRIPT_MESSAGES: u64 = 1000;
/// Most objects that a script may place.
pub const MAX_SCRIPT_OBJECTS: u64 = 1 << 18;
/// Most polygons that a script may place, counting each instance.
pub const MAX_SCRIPT_POLYGONS: u64 = 1 << 26;
/// Most polygon corners that shapes and placed objects of a script may hold at a time; names and features count by
/// their size. Under a gigabyte.
pub const MAX_SCRIPT_CORNERS: u64 = 1 << 24;
/// Most polygon corners that a script may make in total, including dropped shapes: some seconds.
pub const MAX_SCRIPT_WORK: u64 = 1 << 27;
/// Most features that a script may place.
pub const MAX_SCRIPT_FEATURES: u64 = 1 << 18;
/// Deepest nesting of assemblies in a script.
pub const MAX_SCRIPT_ASSEMBLIES: u32 = 64;
/// Most sensors of a robot. Without it, a small file could name a large ray table any number of times.
pub const MAX_ROBOT_SENSORS: usize = 256;
/// Most poses of one series of predictions.
pub const MAX_SERIES: usize = 1 << 20;
/// Longest line of a file of changes, in bytes.
pub const MAX_LINE_BYTES: u64 = 64 << 20;
/// Most characters of one part of a message (file, place, fault, remedy); the rest is cut.
pub const MAX_SHOWN: usize = 1000;
