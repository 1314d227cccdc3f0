//! The stack in one process: planner and controller with the code that their processes
//! run, the built-in world, and the policies. Evaluation, the learner's expert, the fuzz
//! doors and the pictures drive it; it opens no port and starts no thread.
//!
//! | module | holds |
//! |---|---|
//! | [`Stack`] | one tick: observation, plan, command |
//! | [`oracle`] | the expert's action at any observation |
//! | [`driver`] | the drivers of an episode: the expert, a lane keeper, MetaDrive's IDM, a policy |
//! | [`lane_keeper`] | the lane keeper |
//! | [`episode`] | one episode in lockstep order |
//! | `scene` | recorded observations, and their files (feature `wire`) |
//!
//! ```
//! use shm_config::config::Config;
//! use shm_config::message::Observation;
//! use stack::Stack;
//!
//! let mut observation = Observation::default();
//! observation.beam_count = 240;
//! observation.ranges_m.fill(observation.lidar_max_m);
//! (observation.road.left_m, observation.road.right_m) = (5.0, 5.0);
//! observation.checkpoints[0].x_body_m = 30.0;
//!
//! let mut stack = Stack::new(&Config::default())?;
//! stack.plan(&observation);
//! let step = stack.control(&observation);
//! assert!(step.command.pedal > 0.0, "the road is free");
//! # Ok::<(), shm_config::config::OutOfRange>(())
//! ```

pub mod driver;
pub mod episode;
pub mod lane_keeper;
pub mod oracle;
#[cfg(feature = "wire")]
pub mod scene;
mod tick;

pub use tick::Stack;

/// A clock, which the program's `main` passes as an argument.
pub type Clock = fn() -> shm_config::Instant;
