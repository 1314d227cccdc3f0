//! A world of your own: a robot, or a simulator, as the world process of a run.
//!
//! | module | holds |
//! |---|---|
//! | [`robot`](mod@robot) | the trait that a robot implements: obey, brake, read, status |
//! | [`entry`] | [`drive`], the whole `main` of its program |
//! | [`driven`] | a robot as a plant, with the account of its episode |
//! | [`plant`] | what the process moves and observes; the built-in world is one too |
//! | [`clock`] | the run's clock: grid, which command is obeyed, age limit, brake, reports |
//! | [`process`] | the loop of a plant between its ports |
//! | [`bicycle`] | a simulated car |
//! | [`scan`](mod@scan) | fills the lidar of an observation |
//! | [`route`] | road and checkpoints of a map and a pose, or of the scan alone |
//! | [`estimate`] | the car's motion from wheels, IMU and scan, where nothing knows the truth |
//! | [`door`] | the checks of commands |
//! | [`ports`] | its ports |
//! | [`account`] | the commands that moved a car in one episode |
//!
//! The process publishes on the run's grid, obeys only commands of the controller that
//! the roster names, brakes when the newest is older than `limits.command_age_ms` and
//! while another process sends commands, publishes `progress`, `health/world`,
//! `timing/world` and `episode`, and exits with 0 at the end of the run, in real time
//! and in lockstep. `robot/examples/template.rs` is a robot that drives.
//!
//! ```no_run
//! use robot::{Action, Observation, Reading, Robot, Status, scan};
//!
//! struct Sled;
//!
//! impl Robot for Sled {
//!     fn begin(&mut self, _seed: u64) -> Result<(), String> {
//!         Ok(())
//!     }
//!     fn obey(&mut self, _action: Action, _step_s: f64) {}
//!     fn read(&mut self, observation: &mut Observation) -> Reading {
//!         scan(observation, |_direction_rad| f64::INFINITY);
//!         Reading::Fresh
//!     }
//!     fn status(&self) -> Status {
//!         Status::default()
//!     }
//! }
//!
//! fn main() -> std::process::ExitCode {
//!     robot::drive(|_config| Ok(Sled))
//! }
//! ```

pub mod account;
#[cfg(feature = "process")]
pub mod bicycle;
#[cfg(feature = "process")]
pub mod clock;
#[cfg(feature = "process")]
pub mod door;
#[cfg(feature = "process")]
pub mod driven;
#[cfg(feature = "process")]
pub mod entry;
#[cfg(feature = "estimate")]
pub mod estimate;
#[cfg(feature = "process")]
pub mod plant;
#[cfg(feature = "process")]
pub mod ports;
#[cfg(feature = "process")]
pub mod process;
#[cfg(feature = "process")]
pub mod robot;
#[cfg(feature = "route")]
pub mod route;
#[cfg(feature = "process")]
pub mod scan;

#[cfg(feature = "process")]
pub use bicycle::Bicycle;
#[cfg(feature = "process")]
pub use entry::drive;
#[cfg(feature = "process")]
pub use robot::{Contact, Reading, Robot, Status};
#[cfg(feature = "process")]
pub use scan::scan;
#[cfg(feature = "process")]
pub use shm_config::config::Config;
#[cfg(feature = "process")]
pub use shm_config::message::{Bend, Checkpoint, Ego, Observation, Outcome, Road};
#[cfg(feature = "process")]
pub use vehicle::{Action, Point, Vehicle, wrap_rad};
