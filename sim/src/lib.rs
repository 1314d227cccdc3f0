//! The built-in world: MetaDrive's maps and traffic, seed by seed, without
//! MetaDrive. Command in, observation out.
//!
//! | module | holds |
//! |---|---|
//! | [`lane`] | one lane: centre line, lane coordinates, surface, painted lines |
//! | [`road`] | the network: nodes, roads, lanes in flat arrays; routes |
//! | [`map`] | seed to map, block by block |
//! | [`spawn`] | seed to scenario: a map with ego, obstacles and traffic |
//! | [`model`] | the kinds of car and their measures |
//! | [`rng`] | the simulator's random streams, draw for draw |
//! | [`dynamics`] | how a car moves |
//! | [`contact`], [`bodies`] | shapes, collisions, and everything that has a place |
//! | [`lidar`] | what the beams meet |
//! | [`navigation`] | where a car is on its route |
//! | [`idm`], [`traffic`] | how the other cars drive, and when |
//! | [`rules`] | what ends an episode; sidewalks |
//! | [`observe`] | state to observation |
//! | [`reward`] | what a tick is worth, and what it costs |
//! | [`score`] | the account of one episode |
//! | [`world`], [`config`] | episodes by seed, tick by tick |
//! | [`render`] | the world as a picture, with the camera that took it |
//! | `render_thread` | draws pictures on request outside the tick, and foresees the result of holding an action |
//! | [`batch`] | many worlds at once |
//!
//! The feature `process` (default) adds the world process and its render thread.
//!
//! ```
//! use sim::{World, WorldConfig};
//! use vehicle::Action;
//!
//! let mut world = World::new(WorldConfig::default())?;
//! world.reset(1000)?;
//! let mut observation = Box::default();
//! world.step(Action { steer: 0.0, pedal: 1.0 });
//! world.observe(&mut observation);
//! assert!(observation.ego.speed_mps > 0.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod batch;
mod block;
pub mod bodies;
pub mod config;
pub mod contact;
mod delay;
pub mod dynamics;
pub mod idm;
pub mod lane;
pub mod lidar;
pub mod map;
pub mod model;
pub mod navigation;
mod nearby;
pub mod observe;
mod places;
#[cfg(feature = "process")]
pub mod ports;
mod prefetch;
#[cfg(feature = "process")]
mod process;
pub mod render;
#[cfg(feature = "process")]
pub mod render_thread;
pub mod reward;
pub mod rng;
pub mod road;
pub mod rules;
pub mod score;
mod settings;
mod simd;
pub mod spawn;
pub mod substeps;
mod surface;
pub mod traffic;
pub mod world;

pub use batch::{AfterEnd, Batch, BatchConfig};
pub use block::Parameters;
pub use config::{OutOfRoute, WorldConfig, WorldError};
#[cfg(feature = "process")]
pub use process::run;
pub use reward::{Reward, RewardConfig};
pub use surface::Bounds;
pub use world::{StepOutcome, World};
