//! What happens where the system gives less than is asked for.

#[path = "../common/mod.rs"]
mod common;
mod pool;
