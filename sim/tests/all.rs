//! The integration tests of this crate, one program: each program is linked anew.

mod drivers;
mod lane_surface;
mod lidar;
mod map_digest;
mod map_properties;
mod render;
mod render_thread;
mod vehicle;
mod world;
