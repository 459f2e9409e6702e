//! Commands under too little of a system resource, and with arguments beyond every limit.

#[cfg(all(target_os = "linux", feature = "script", feature = "store", feature = "report"))]
mod matrix;
#[cfg(all(target_os = "linux", feature = "script", feature = "store", feature = "report"))]
mod process;
#[cfg(all(target_os = "linux", feature = "script", feature = "store", feature = "report"))]
mod rows;
mod usage;
#[cfg(all(target_os = "linux", feature = "script", feature = "store", feature = "report"))]
mod whole;
