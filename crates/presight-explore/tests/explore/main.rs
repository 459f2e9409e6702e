//! Explorations of real logs and of simulated rooms, against rays that parry casts.
#![allow(clippy::print_stdout, reason = "tests print their figures on request")]

mod bad;
mod buildings;
mod corners;
mod corridor;
mod factory;
mod factory_drive;
mod livingroom;
mod lost;
mod mirrors;
mod noise;
mod occupancy;
mod office;
mod parts;
mod rooms;
mod rough;
mod street;
mod walls;
