//! Explorations of real logs and of simulated rooms, against rays that parry casts.

mod corridor;
mod livingroom;
mod occupancy;
mod rooms;
