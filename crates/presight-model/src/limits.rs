//! Limits on all inputs, so that none can take unbounded memory or time.

/// Maximum length of an image side, pixels.
pub const MAX_IMAGE_SIDE: u32 = 16_384;
/// Maximum number of rays in a table of one row, which is a list of rays rather than an image.
pub const MAX_LISTED_RAYS: u32 = 1_000_000;
/// Maximum number of pixels in one image.
pub const MAX_PIXELS: u64 = 1 << 26;
/// Maximum number of polygons in one environment: ids have 32 bits, and 0 stands for no polygon.
pub const MAX_POLYGONS: u64 = 1 << 28;
/// Maximum number of objects in one environment.
pub const MAX_OBJECTS: usize = 1 << 22;
/// Maximum number of corners of one polygon.
pub const MAX_CORNERS: usize = 64;
/// Maximum number of worker threads in one pool, or twice the number of cores if that is more.
pub const MAX_THREADS: usize = 64;
/// Maximum size of a file that is read into memory, bytes.
pub const MAX_FILE_BYTES: u64 = 4 << 30;
/// Maximum memory for importing a scene file with its buffers or for reading JSON, bytes. It is estimated in advance.
pub const MAX_IMPORT_BYTES: u64 = 4 << 30;
/// Maximum size of a settings file (sensor, robot or materials), bytes. Parsed TOML takes about a dozen times as much.
pub const MAX_SETTINGS_BYTES: u64 = 32 << 20;
/// Maximum number of polygons in one mesh cluster, the unit that selection keeps or drops.
pub const CLUSTER_POLYGONS: usize = 64;
/// Maximum absolute value of a coordinate or finite range, metres. Squares of larger values overflow f32.
pub const MAX_COORDINATE: f64 = 1e12;
/// Maximum number of triangles in one scene file, where a mesh counts once, however many objects have it.
pub const MAX_STORED_TRIANGLES: u64 = 1 << 25;
/// Maximum number of elements in an accessor without data, all zero but for its sparse part.
pub const MAX_ZERO_FILLED: u64 = 1 << 16;
/// Maximum depth of nested nodes.
pub const MAX_NODE_DEPTH: usize = 1024;
/// Maximum length of a full node path, bytes.
pub const MAX_NAME_BYTES: usize = 4096;
/// Maximum number of problems of one kind that are listed with their place. Further ones are only counted.
pub const LISTED_PROBLEMS: usize = 20;
/// Maximum tolerance for merging triangles, relative to the size of the mesh.
pub const MAX_MERGE_TOLERANCE: f64 = 1e-3;
/// Maximum number of steps of feature generation where polygons overlap. At about 10 ns each they take 5 s of one core.
pub const MAX_FEATURE_STEPS: u64 = 1 << 29;
/// Maximum number of corners examined near sides of polygons to find where smooth surfaces continue: 1 to 2 s.
pub const MAX_CONTOUR_STEPS: u64 = 1 << 27;
/// Maximum number of polygons in all contours of a feature layer.
pub const MAX_CONTOUR_FACETS: u64 = 1 << 22;
/// Maximum number of pairs of a feature and a polygon within the layer's tolerance of it: 1 to 2 minutes.
pub const MAX_PLACING_PAIRS: u64 = 1 << 28;
/// Maximum number of grid positions at which a layer is rated.
pub const MAX_WORTH_PLACES: u64 = 1 << 20;
/// Maximum number of facets around a round solid, and of steps of a staircase.
pub const MAX_FACETS: u32 = 1024;
/// Maximum number of points in an extruded outline.
pub const MAX_OUTLINE: usize = 512;
/// Maximum size of a scene script or script module, bytes.
pub const MAX_SCRIPT_BYTES: u64 = 1 << 20;
/// Maximum size of a script and all its modules together, bytes.
pub const MAX_SCRIPT_TEXT: usize = 4 << 20;
/// Maximum number of operations of a script and its modules: some seconds. Large values count by size, which also
/// bounds maps.
pub const MAX_SCRIPT_OPERATIONS: u64 = 5_000_000;
/// Maximum run time of a script without imports and construction, seconds: a last resort that a valid script should not
/// reach.
pub const MAX_SCRIPT_SECONDS: u64 = 30;
/// Maximum size of a module's variable, in elements, with nested arrays included; 16 bytes of text count as one
/// element. Each use copies the value.
pub const MAX_SCRIPT_EXPORT: usize = 64;
/// Maximum length of a string literal in a script, bytes.
pub const MAX_SCRIPT_LITERAL: usize = 4096;
/// Maximum depth of nested calls in a script.
pub const MAX_SCRIPT_CALLS: usize = 32;
/// Maximum depth of nested expressions and statements in a script.
pub const MAX_SCRIPT_NESTING: usize = 128;
/// Maximum number of variables in one call of a script function.
pub const MAX_SCRIPT_VARIABLES: usize = 256;
/// Maximum number of parameters of a script function.
pub const MAX_SCRIPT_ARGUMENTS: usize = 12;
/// Maximum number of functions in a script or script module.
pub const MAX_SCRIPT_FUNCTIONS: usize = 256;
/// Maximum length of the name of a variable or function in a script, bytes.
pub const MAX_SCRIPT_NAME: usize = 256;
/// Maximum number of elements in a script's array, including elements of nested arrays.
pub const MAX_SCRIPT_ARRAY: usize = 4096;
/// Maximum number of copies of a shape that `repeat` makes.
pub const MAX_SCRIPT_REPEAT: u32 = 16_384;
/// Maximum number of entries in an object map of a script.
pub const MAX_SCRIPT_MAP: usize = 1024;
/// Maximum length of a string in a script, bytes.
pub const MAX_SCRIPT_STRING: usize = 16_384;
/// Maximum number of modules of a script.
pub const MAX_SCRIPT_MODULES: usize = 64;
/// Maximum number of lines that a script may print. Further ones are dropped.
pub const MAX_SCRIPT_MESSAGES: u64 = 1000;
/// Maximum number of objects that a script may place.
pub const MAX_SCRIPT_OBJECTS: u64 = 1 << 18;
/// Maximum number of polygons that a script may place, counting each instance.
pub const MAX_SCRIPT_POLYGONS: u64 = 1 << 26;
/// Maximum number of polygon corners that shapes and placed objects of a script may hold at a time, under 1 GB. Names
/// and features count by their size.
pub const MAX_SCRIPT_CORNERS: u64 = 1 << 24;
/// Maximum number of polygon corners that a script may make in total, with dropped shapes included: some seconds.
pub const MAX_SCRIPT_WORK: u64 = 1 << 27;
/// Maximum number of features that a script may place.
pub const MAX_SCRIPT_FEATURES: u64 = 1 << 18;
/// Maximum depth of nested assemblies in a script.
pub const MAX_SCRIPT_ASSEMBLIES: u32 = 64;
/// Maximum number of sensors on a robot. Without this limit a small file could name a large ray table any number of
/// times.
pub const MAX_ROBOT_SENSORS: usize = 256;
/// Maximum number of poses in one series of predictions.
pub const MAX_SERIES: usize = 1 << 20;
/// Maximum length of a line in a file of changes, bytes.
pub const MAX_LINE_BYTES: u64 = 64 << 20;
/// Maximum number of characters in one part of a message (file, place, fault, remedy). The rest is cut.
pub const MAX_SHOWN: usize = 1000;
