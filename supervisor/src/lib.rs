//! The process set: started in order, watched, restarted, stopped; never waited on.
//!
//! # The process table
//!
//! | process | binary | core | priority | when it dies | starts after |
//! |---|---|---|---|---|---|
//! | planner | `vlaps-planner` | last but one | 45 | restarted | |
//! | controller | `vlaps-controller` | last | 48 | restarted | planner |
//! | gate | `vlaps-gate` | any | 0 | restarted | controller |
//! | learner | `vlaps-learner` | any | 0 | restarted; goes on where it was | gate |
//! | world | `vlaps-world` | last but two | 50 | restarted at the episode it died in; exit 0 ends the run | learner |
//!
//! The world starts last: it owns the clock, and when its first tick comes
//! everybody who answers is ready. [`set::table::TABLE`] is this table; a test
//! compares the two. Cores are in the order of [`machine::cores::own_cores`]; with fewer than
//! [`set::table::CORES_MIN`] of them the three share the last, with one nobody asks. Cores
//! and priorities are asked for only in real time, since lockstep has no deadline, and
//! cores only by who got the priority: others could keep the rest from theirs. The gate
//! is absent when the configured gate has no process.
//!
//! # What ends a process, and what then
//!
//! | what the supervisor sees | what it does |
//! |---|---|
//! | exit code 2 at the first start | shows the process's last line and gives the run up: the same set-up would fail again |
//! | exit code 2 later, any other exit, or a signal | restarts it after a pause that doubles, up to `supervisor.restarts_max` times |
//! | no health for `supervisor.silence_s` | SIGKILL, which also ends a stopped process; then as above |
//! | not ready within [`set::member::READY_LIMIT_NS`] ([`set::member::SCRIPT_READY_LIMIT_NS`] for a script) | gives up at the first start; SIGKILL and restart later |
//! | the run's files are gone from the disk or /dev/shm | brakes the car and gives up: whoever is restarted could not join the others |
//! | the world's exit 0 | the run is driven to its end |
//!
//! # What the car does meanwhile
//!
//! | dead or silent | the car |
//! |---|---|
//! | planner | follows the last plan up to `limits.plan_age_ms`, then the controller brakes (*unplanned*) |
//! | controller | the world obeys the last command up to `limits.command_age_ms`, then brakes |
//! | gate | goes on; when the last advice has expired, the expert drives (*expired*) |
//! | learner | goes on; the weights in charge stay. In lockstep the controller waits for its successor, `learner.lockstep_wait_s` at most |
//! | world | is gone with it; the controller brakes (*blind*) until the world is back, at the beginning of its episode |
//! | supervisor | all processes end at once with it; the next `up` or `clean` removes what they left |
//!
//! The loop runs at 20 Hz, or at once when a child dies or a signal comes. It
//! only ever looks: at ports, at exit statuses, at the clock it is given.
//! Output goes through a thread of its own, so that a terminal that takes no
//! more text cannot hold the loop. With `--gate human` it also reads the keys and
//! says what the person wants ([`takeover::input`]); should it hang, its last word gets old
//! (`limits.takeover_age_ms`) and nobody has taken over.

pub mod arguments;
pub mod cli;
pub mod commands;
pub mod machine;
pub mod run;
pub mod set;
pub mod setup;
pub mod show;
pub mod takeover;
pub mod telemetry;

/// How a library function of this crate reads the clock: it is handed one by
/// `main.rs`.
pub type Clock = fn() -> shm_config::Instant;
