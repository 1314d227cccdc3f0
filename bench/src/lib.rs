//! Evaluation, comparison with other systems, and pictures: the program
//! `vlaps-bench`, to which `./vlaps eval`, `bench` and `draw` hand over.
//!
//! | module | holds |
//! |---|---|
//! | [`arguments`] | the command line |
//! | [`outputs`], [`stop`] | files that cannot be written, and Ctrl-C |
//! | [`settings`] | the run's configuration, as `./vlaps up` would make it |
//! | [`seat`] | the drivers: the stack's expert, a lane keeper, MetaDrive's IDM |
//! | [`episode`] | one episode in lockstep order |
//! | [`eval`], [`evaluation`] | many episodes, and their table |
//! | [`outside`] | the same in the real MetaDrive |
//! | [`metric`] | keys and names of the figures |
//! | [`statistics`] | means with 95 % intervals |
//! | [`report`] | rows of a table, on the screen and as JSON |
//! | [`parity`] | the world against recordings of MetaDrive |
//! | [`speed`], [`metadrive`] | ticks per second, ours and MetaDrive's |
//! | [`photography`] | what a picture of the world costs |
//! | [`scene`] | recorded scenes and their files |
//! | [`mpc`] | the model-predictive expert, disturbed for long |
//! | [`planning`] | planners on recorded scenes, beside OMPL's |
//! | [`inference`] | how long a policy takes to answer, by back end |
//! | [`judging`] | how often a judge is right where the simulator knows |
//! | [`learning`] | gradient steps per second, beside PyTorch |
//! | [`driven`] | a whole process set, driven for a measurement |
//! | [`faults`] | a campaign of faults on live sets |
//! | [`floor`] | how late the machine wakes a thread that does nothing else |
//! | [`stalls`] | when the machine stood still, core by core |
//! | [`latency`] | how punctual the set is, whatever happens beside it |
//! | [`chart`], [`bitmap`] | what charts have in common, and their letters in a PNG |
//! | [`ipc`] | what the wire adds to the library beneath it, beside Cyclone DDS and Zenoh |
//! | [`soak`] | a set that drives for millions of ticks: does it grow? |
//! | [`swapping`] | a running set whose weights are swapped |
//! | [`sweep`] | what a judge that is wrong, silent or late costs |
//! | [`train`] | the paper's experiment, its curves and tables |
//! | [`draw`] | pictures of maps, episodes and plans |

pub mod arguments;
pub mod bitmap;
pub mod chart;
pub mod draw;
pub mod driven;
pub mod episode;
pub mod eval;
pub mod evaluation;
pub mod faults;
pub mod floor;
pub mod inference;
pub mod ipc;
pub mod judging;
pub mod latency;
pub mod learning;
pub mod metadrive;
pub mod metric;
pub mod mpc;
pub mod outputs;
pub mod outside;
pub mod parity;
pub mod photography;
pub mod planning;
mod products;
pub mod report;
pub mod scene;
pub mod seat;
pub mod settings;
pub mod soak;
pub mod speed;
pub mod stalls;
pub mod statistics;
pub mod stop;
pub mod swapping;
pub mod sweep;
pub mod train;

/// How a library function of this crate reads the clock: it is handed one by
/// `main.rs`.
pub type Clock = fn() -> shm_config::Instant;
