//! A robot behind a serial line, in a straight corridor six metres wide. `VLAPS_SERIAL`
//! names the line, such as /dev/ttyUSB0; `link.rs` is what the machine has to speak.
//!
//! Its lidar is described in `[scanner]`.
//!
//! cargo build --release -p robot --example serial
//! VLAPS_SERIAL=/dev/ttyUSB0 ./vlaps up --world ./target/release/examples/serial

mod car;
mod link;
#[path = "../corridor/report.rs"]
mod report;

use std::process::ExitCode;

use car::Car;

fn main() -> ExitCode {
    robot::drive(|config| Car::open(config.scanner.beams as usize))
}
