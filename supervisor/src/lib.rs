//! The process set, started in order, watched, restarted and stopped, and the command line.
//! The supervisor never waits for a process.
//!
//! # Folders
//!
//! | folder | holds |
//! |---|---|
//! | [`cli`] | failures, parsers, output files |
//! | [`machine`] | cores, memory, threads, signals |
//! | [`set`] | the process table, and each process from start to end |
//! | [`run`] | the run's lock, folder, shared memory and roster |
//! | [`telemetry`] | what the messages of a run add up to |
//! | [`show`] | the live view and the summary |
//! | [`takeover`] | keys of a human driver to takeover messages |
//! | [`setup`] | foreign worlds, ONNX Runtime, ROS 2, other machines, programs of a user |
//! | [`commands`] | one file or folder a command |
//! | [`subcommand`] | what the programs of `eval`, `train`, `draw` and `bench` share |
//!
//! A folder imports only folders above it in this table; `tests/folders.rs` checks it.
//! [`arguments`] lists the commands.
//!
//! # The process table
//!
//! | process | binary | core | priority | when it dies | starts after | part of a run |
//! |---|---|---|---|---|---|---|
//! | recorder | `vlaps-recorder` | those left | 0 | restarted, at last given up; goes on in a new file | | `record.keep` |
//! | planner | `vlaps-planner` | last but one | 45 | restarted | recorder | always |
//! | controller | `vlaps-controller` | last | 48 | restarted | planner | always |
//! | gate | `vlaps-gate` | any | 0 | restarted | controller | `gate.mode` needs a process |
//! | learner | `vlaps-learner` | any | 0 | restarted; continues from its saved state | gate | `learner.enabled` |
//! | world | `vlaps-world` | last but two | 50 | restarted at the episode it died in; exit 0 ends the run | learner | always |
//!
//! The recorder starts first, so that it misses no message. The world starts last: it
//! owns the clock, and at its first tick all processes that answer it are ready.
//! [`set::table::TABLE`] is this table; a test compares the two. *Those left* are the cores
//! that no row asks for. Cores are counted in the order of [`machine::cores::own_cores`].
//! With fewer than [`set::privileges::CORES_MIN`] cores, world, planner and controller
//! share the last one; with a single core no process asks for one. Cores and priorities are
//! asked for only in real time, since lockstep has no deadline. A process asks for its core
//! only after its priority was granted: without a priority, a pinned process could be kept
//! from its core.
//!
//! # What ends a process, and the response
//!
//! | what the supervisor observes | what it does |
//! |---|---|
//! | exit code 2 at the first start: the process could not be set up | shows the process's last log line and gives the run up: the same set-up would fail again |
//! | any exit of a user's program (`[programs]`) before it was ready | shows its last log lines and gives the run up |
//! | exit code 2 later, any other exit (101: a panic; 1: an exception of the MetaDrive world; 0: not the world), or a signal | restarts it after a pause that doubles, up to `supervisor.restarts_max` times; then gives the run up, or goes on without a recorder |
//! | no health message for `supervisor.silence_s` | SIGKILL, which also ends a stopped process; then as above |
//! | not ready within [`set::member::READY_LIMIT_NS`] ([`set::member::SCRIPT_READY_LIMIT_NS`] for a script) | gives up at the first start; SIGKILL and restart later |
//! | the run's files are gone from the disk or /dev/shm | brakes the car and gives up: a restarted process could not join the others |
//! | the world's exit 0 | the run is finished |
//!
//! # What the car does meanwhile
//!
//! | dead or silent | the car |
//! |---|---|
//! | planner | follows the last plan up to `limits.plan_age_ms`, then the controller brakes (*unplanned*) |
//! | controller | the world applies the last command up to `limits.command_age_ms`, then brakes |
//! | gate | continues; when the last advice has expired, the expert drives (*expired*) |
//! | learner | continues with the weights in use. In lockstep the controller waits for the restarted learner, 120 s at most |
//! | world | is gone with the world; the controller brakes (*blind*) until the world is back, at the start of its episode |
//! | supervisor | all processes end with it; the next `up` or `clean` removes their files |
//!
//! The supervision loop runs at 20 Hz, and immediately when a child exits or a signal
//! arrives. It reads ports, exit statuses and the clock it is given, and never blocks.
//! Output goes through a thread of its own, so that a terminal that accepts no more text
//! cannot block the loop. With `--gate human` the loop also reads the keys and publishes
//! takeover messages ([`takeover::input`]); if it hangs, the last takeover message expires
//! (`limits.takeover_age_ms`), and the takeover ends.
//!
//! # Example
//!
//! ```
//! use shm_config::config::Config;
//! use supervisor::set::table::rows;
//!
//! let names: Vec<_> = rows(&Config::default()).map(|row| row.process.word()).collect();
//! assert!(names.contains(&"controller") && !names.contains(&"learner"));
//! ```

pub mod arguments;
pub mod cli;
pub mod commands;
pub mod dispatch;
pub mod machine;
pub mod run;
pub mod set;
pub mod setup;
pub mod show;
pub mod subcommand;
pub mod takeover;
pub mod telemetry;

/// The clock of this crate's functions: `main.rs` passes it in.
pub type Clock = fn() -> shm_config::Instant;
