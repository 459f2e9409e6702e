//! What happens where the system gives less than is asked for, and where too much is asked of it.

#[cfg(all(target_os = "linux", feature = "script", feature = "store", feature = "report"))]
mod matrix;
#[cfg(all(target_os = "linux", feature = "script", feature = "store", feature = "report"))]
mod process;
#[cfg(all(target_os = "linux", feature = "script", feature = "store", feature = "report"))]
mod rows;
mod usage;
#[cfg(all(target_os = "linux", feature = "script", feature = "store", feature = "report"))]
mod whole;
