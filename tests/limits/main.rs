//! What happens where the system gives less than is asked for, and where too much is asked of it.

#[path = "../common/mod.rs"]
mod common;
#[cfg(feature = "script")]
mod pool;
mod skipped;
mod usage;
