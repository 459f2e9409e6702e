//! Supervision and queries, with truths worked out by hand, by brute force, or by the test kit's ray caster.

mod answers;
mod buildings;
mod corridor;
mod intruders;
mod queries;
