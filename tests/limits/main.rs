//! What the library does where the system has no more threads, and what `tests/run` says of tests that lack something.

#[cfg(feature = "script")]
mod pool;
mod skipped;

use presight_testkit as common;
