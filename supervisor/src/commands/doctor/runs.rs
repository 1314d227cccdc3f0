//! The threads of running sets.

use super::checks::read;
use crate::Clock;
use crate::cli::print::say;
use crate::run::selection::living_runs;
use crate::set::table::rows;
use crate::telemetry::observe::observe;

/// What the threads of running sets asked for, and what they have.
pub(super) fn tell_of_sets(clock: Clock) {
    let all_cores = cores_list();
    for paths in living_runs() {
        let name = paths.name();
        let Some(supervisor) = paths.supervisor_pid() else {
            continue;
        };
        let (config, tally) = match observe(&paths, supervisor, clock) {
            Ok(seen) => seen,
            Err(error) => {
                say(format_args!("\nrun '{name}' cannot be observed: {error}"));
                continue;
            }
        };
        say(format_args!(
            "\nrun '{name}': thread, scheduling and priority asked / got, own core, cores, slack"
        ));
        for process in rows(&config).map(|row| row.process) {
            let threads = tally
                .process(process)
                .map_or(&[][..], |tally| tally.threads());
            let tick_cores = threads.first().map_or("", |thread| thread.cores.as_str());
            for thread in threads {
                let grade = match thread.is_as_asked(tick_cores, &all_cores) {
                    true => "OK",
                    false => "MISSING",
                };
                let slack = thread
                    .slack_ns
                    .map_or("unknown".into(), |ns| format!("{ns} ns"));
                say(format_args!(
                    "{grade:<8} {process:<11}{:<17}{} {} / {} {}, {}, {}, {slack}",
                    thread.name,
                    thread.scheduling_asked,
                    thread.priority_asked,
                    thread.scheduling_got,
                    thread.priority_got,
                    thread.core,
                    thread.cores
                ));
            }
        }
    }
}

/// The cores that a thread may use that asked for none, as the kernel writes them.
fn cores_list() -> String {
    let status = read("/proc/self/status").unwrap_or_default();
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("Cpus_allowed_list:"));
    line.unwrap_or_default().trim().into()
}
