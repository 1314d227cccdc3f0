//! The integration tests of this crate, in one program, since each program links all
//! libraries again. `cargo test -p robot --test all NAME::` runs those of one file.

mod alignment;
mod can;
mod conform;
#[path = "../examples/estimated/dice.rs"]
mod dice;
mod driven;
mod estimate;
#[path = "../examples/can/frames.rs"]
mod frames;
mod hallway;
#[path = "../examples/serial/link.rs"]
mod link;
mod machine;
#[path = "../examples/corridor/report.rs"]
mod report;
mod serial;
#[path = "../examples/estimated/walls.rs"]
mod walls;
