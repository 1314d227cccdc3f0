//! `vlaps-bench`: `./vlaps bench`.

use std::alloc::System;
use std::process::ExitCode;

use bench::Command;
use shm_config::time::monotonic;
use stats_alloc::{INSTRUMENTED_SYSTEM, StatsAlloc};
use supervisor::subcommand;

/// Counts bytes and allocations, for [`bench::gauges`].
#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

fn main() -> ExitCode {
    // A process entry point: only entry points read the clock.
    #[allow(clippy::disallowed_methods)]
    subcommand::main::<Command>(monotonic)
}
