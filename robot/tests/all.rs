//! The integration tests of this crate, one program: each program is linked anew.

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
