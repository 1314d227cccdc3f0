//! What every process of a run does.
//!
//! | module | holds |
//! |---|---|
//! | `member` | arguments, configuration, membership, logs, stop signal, exit code |
//! | `tick_loop` | the loop of every process with a fixed rate: heartbeat, connections, waiting, stop |
//! | `schedule` | the grid of its ticks: due, skipped, missed |
//! | `plan_ticks` | the ticks of a planner: its turns, late plans, the account |
//! | `telemetry` | what a process reports: health, timing, deadlines, budgets |
//! | `privileges` | real-time priority, own core, locked memory |
//! | `contest` | detects two living producers of one state |
//! | `fault` | failures on order, installed with `run.faults` alone |
//! | `kernel` | system calls that no library wraps |
//! | `log` | the log file of a process, for the program that starts it |
//!
//! A process with a fixed rate is a [`FixedRate`], and [`TickLoop::run`] drives it.
//!
//! The schedule accounts for every tick that was due:
//!
//! ```
//! use runtime::TickSchedule;
//! use shm_config::Instant;
//!
//! let mut schedule = TickSchedule::following(100);
//! schedule.take(Instant(1_000));
//! // The next observation is three periods later: two ticks were skipped.
//! assert_eq!(schedule.take(Instant(1_300)), 2);
//! assert_eq!((schedule.ticks(), schedule.skipped()), (2, 2));
//! ```

mod contest;
mod fault;
mod kernel;
mod log;
mod member;
mod plan_ticks;
mod privileges;
mod schedule;
mod telemetry;
mod tick_loop;

pub use contest::Contest;
pub use kernel::{Usage, set_fifo};
pub use log::LogFile;
pub use member::{Arguments, Member, SET_UP_FAILED, SetUpError, exit_code, join_as};
pub use plan_ticks::PlanTicks;
pub use privileges::{Ask, Privileges};
pub use schedule::{DueTick, Release, TickSchedule};
pub use telemetry::{Deadline, Skipped, Telemetry, Tick};
pub use tick_loop::{FixedRate, Flow, HEARTBEAT_MAX, TickLoop};
