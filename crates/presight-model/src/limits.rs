//! A limit on everything: no input may ask for unbounded memory or time.

/// Longest image side, in pixels.
pub const MAX_IMAGE_SIDE: u32 = 16_384;
/// Most pixels of one image.
pub const MAX_PIXELS: u64 = 1 << 26;
/// Most polygons of one environment; ids are 32 bits and 0 is nothing.
pub const MAX_POLYGONS: u64 = 1 << 28;
/// Most objects of one environment.
pub const MAX_OBJECTS: usize = 1 << 22;
/// Most corners of one polygon.
pub const MAX_CORNERS: usize = 64;
/// Most worker threads of one pool, or twice the cores where that is more.
pub const MAX_THREADS: usize = 64;
/// Largest file read into memory, in bytes.
pub const MAX_FILE_BYTES: u64 = 4 << 30;
/// Most bytes of memory that importing a scene file may take, its buffers included, or reading JSON, as far as they are
/// known before.
pub const MAX_IMPORT_BYTES: u64 = 4 << 30;
/// Largest file of settings, of a sensor, a robot or materials, in bytes: what is made of TOML takes some dozen times as much.
pub const MAX_SETTINGS_BYTES: u64 = 32 << 20;
/// Polygons of one mesh cluster: the unit that selection keeps or drops.
pub const CLUSTER_POLYGONS: usize = 64;
/// Largest finite coordinate or range accepted, in metres: beyond it squares overflow f32.
pub const MAX_COORDINATE: f64 = 1e12;
/// Most triangles stored in one scene file, instances counted once.
pub const MAX_STORED_TRIANGLES: u64 = 1 << 25;
/// Most elements of an accessor that has no data behind it (zeros, replaced by a sparse part).
pub const MAX_ZERO_FILLED: u64 = 1 << 16;
/// Deepest nesting of nodes.
pub const MAX_NODE_DEPTH: usize = 1024;
/// Longest full node path, in bytes.
pub const MAX_NAME_BYTES: usize = 4096;
/// Problems of one kind that are listed with their place; the others are counted.
pub const LISTED_PROBLEMS: usize = 20;
/// Largest tolerance for merging triangles, relative to the size of the mesh.
pub const MAX_MERGE_TOLERANCE: f64 = 1e-3;
/// Most steps of generating features where polygons lie upon each other, each of about ten nanoseconds of one core: some seconds.
pub const MAX_FEATURE_STEPS: u64 = 1 << 29;
/// Most corners looked at beside sides of polygons, to find where smooth surfaces go on: a second or two.
pub const MAX_CONTOUR_STEPS: u64 = 1 << 27;
/// Most polygons of all contours of a feature layer together.
pub const MAX_CONTOUR_FACETS: u64 = 1 << 22;
/// Most polygons within a layer's tolerance of its features, counted for each feature: a minute or two.
pub const MAX_PLACING_PAIRS: u64 = 1 << 28;
/// Most places of a grid at which a layer's worth is asked for.
pub const MAX_WORTH_PLACES: u64 = 1 << 20;
/// Most facets around a round solid, or steps of stairs.
pub const MAX_FACETS: u32 = 1024;
/// Most points of an outline that is drawn out.
pub const MAX_OUTLINE: usize = 512;
/// Largest scene script or module of one, in bytes.
pub const MAX_SCRIPT_BYTES: u64 = 1 << 20;
/// Most bytes of a script and all its modules together.
pub const MAX_SCRIPT_TEXT: usize = 4 << 20;
/// Most operations of a script, its modules included: some seconds. Reading a large value counts by its size. They also bound
/// what maps can grow to by index.
pub const MAX_SCRIPT_OPERATIONS: u64 = 5_000_000;
/// Most seconds of a script, importing and building not counted: the last resort, which no sound script should meet before
/// another limit.
pub const MAX_SCRIPT_SECONDS: u64 = 30;
/// Largest value of a variable of a module, in elements (16 bytes of text are one), those of arrays in it included: it is copied
/// wherever it is named.
pub const MAX_SCRIPT_EXPORT: usize = 64;
/// Longest string that the text of a script may hold, in bytes.
pub const MAX_SCRIPT_LITERAL: usize = 4096;
/// Deepest nesting of calls in a script.
pub const MAX_SCRIPT_CALLS: usize = 32;
/// Deepest nesting of expressions and statements in a script.
pub const MAX_SCRIPT_NESTING: usize = 128;
/// Most variables of one call in a script.
pub const MAX_SCRIPT_VARIABLES: usize = 256;
/// Most arguments of a call in a script, and parameters of a function.
pub const MAX_SCRIPT_ARGUMENTS: usize = 12;
/// Most functions of a script or module of one.
pub const MAX_SCRIPT_FUNCTIONS: usize = 256;
/// Longest name of a variable or function in a script, in bytes.
pub const MAX_SCRIPT_NAME: usize = 256;
/// Most elements of an array in a script, those of arrays in it included.
pub const MAX_SCRIPT_ARRAY: usize = 4096;
/// Most copies of a shape that `repeat` makes.
pub const MAX_SCRIPT_REPEAT: u32 = 16_384;
/// Most entries of an object map in a script.
pub const MAX_SCRIPT_MAP: usize = 1024;
/// Longest string in a script, in bytes.
pub const MAX_SCRIPT_STRING: usize = 16_384;
/// Most modules of a script.
pub const MAX_SCRIPT_MODULES: usize = 64;
/// Lines that a script may print; what follows is left out.
pub const MAX_SCRIPT_MESSAGES: u64 = 1000;
/// Most objects that a script may place.
pub const MAX_SCRIPT_OBJECTS: u64 = 1 << 18;
/// Most polygons that a script may place, instances counted each.
pub const MAX_SCRIPT_POLYGONS: u64 = 1 << 26;
/// Most corners of polygons that shapes and placed objects of a script may hold at a time, names and features counted by their
/// size: under a gigabyte.
pub const MAX_SCRIPT_CORNERS: u64 = 1 << 24;
/// Most corners of polygons that a script may make in all, those of shapes given up again included: some seconds.
pub const MAX_SCRIPT_WORK: u64 = 1 << 27;
/// Most features that a script may place.
pub const MAX_SCRIPT_FEATURES: u64 = 1 << 18;
/// Deepest nesting of assemblies in a script.
pub const MAX_SCRIPT_ASSEMBLIES: u32 = 64;
/// Most sensors of a robot: a small file could otherwise name a large ray table any number of times.
pub const MAX_ROBOT_SENSORS: usize = 256;
/// Most poses of one series of predictions.
pub const MAX_SERIES: usize = 1 << 20;
/// Longest line of a file of changes, in bytes.
pub const MAX_LINE_BYTES: u64 = 64 << 20;
/// Most characters of one part of a message (file, place, what is wrong, remedy); what follows is left out.
pub const MAX_SHOWN: usize = 1000;
