//! The raw histograms of a run as `timing.csv`, for tables and plots of other programs.

use std::fmt::Write as _;

use shm_config::message::Measure;
use shm_config::services::Process;

use crate::telemetry::tally::Tally;

/// The name of the file in the run's folder.
pub const FILE: &str = "timing.csv";

/// One line for each non-empty bucket, over all restarts: the count of durations in
/// `from_ns..below_ns`. `max_ns` is the exact maximum of the whole measure, the same in
/// each of its lines.
pub fn csv(tally: &Tally) -> String {
    let mut text = String::from("process,measure,from_ns,below_ns,count,max_ns\n");
    for process in Process::ALL {
        let Some(counted) = tally.process(*process) else {
            continue;
        };
        let timing = counted.timing();
        for measure in Measure::ALL {
            let histogram = timing.of(*measure);
            for (from_ns, below_ns, count) in histogram.filled() {
                // Writing to a string cannot fail.
                let _ = writeln!(
                    text,
                    "{process},{measure},{from_ns},{below_ns},{count},{}",
                    histogram.max_ns
                );
            }
        }
    }
    text
}
