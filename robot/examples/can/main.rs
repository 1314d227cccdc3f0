//! A robot behind a CAN bus, in a straight corridor six metres wide. `VLAPS_CAN` names the
//! interface, such as can0; `frames.rs` is what the machine has to speak. A name with a `/`
//! is a Unix socket on which a simulated machine listens.
//!
//! Its lidar is described in `[scanner]`.
//!
//! cargo build --release -p robot --example can
//! ip link set can0 up type can bitrate 500000
//! VLAPS_CAN=can0 ./vlaps up --world ./target/release/examples/can

mod bus;
mod car;
mod frames;
#[path = "../corridor/report.rs"]
mod report;

use std::process::ExitCode;

use car::Car;

fn main() -> ExitCode {
    robot::drive(|config| Car::open(config.scanner.beams as usize))
}
