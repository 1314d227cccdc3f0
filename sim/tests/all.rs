//! The integration tests of this crate, in one program, since each program links all
//! libraries again. `cargo test -p sim --test all NAME::` runs those of one file.

mod drivers;
mod lane_surface;
mod lidar;
mod map_digest;
mod map_properties;
mod render;
mod render_thread;
mod vehicle;
mod world;
