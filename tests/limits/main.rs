//! What happens where the system gives less than is asked for, and where too much is asked of it.

#[path = "../common/mod.rs"]
mod common;
#[cfg(all(target_os = "linux", feature = "script", feature = "store", feature = "report"))]
mod matrix;
#[cfg(feature = "script")]
mod pool;
#[cfg(all(target_os = "linux", feature = "script", feature = "store", feature = "report"))]
mod process;
#[cfg(all(target_os = "linux", feature = "script", feature = "store", feature = "report"))]
mod rows;
mod skipped;
mod usage;
#[cfg(all(target_os = "linux", feature = "script", feature = "store", feature = "report"))]
mod whole;
