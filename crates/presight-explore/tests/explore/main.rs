//! Explorations of real logs and of simulated rooms, against rays that parry casts.
#![allow(clippy::print_stdout, reason = "tests print their figures on request")]

mod corridor;
mod livingroom;
mod lost;
mod mirrors;
mod noise;
mod occupancy;
mod office;
mod rooms;
mod street;
