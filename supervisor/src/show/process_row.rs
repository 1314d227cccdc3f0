//! The summary of a run for one process.

use std::collections::BTreeMap;

use serde::Serialize;
use shm_config::config::Config;
use shm_config::message::{Grant, Measure, Scheduling};
use shm_config::services::Process;

use crate::machine::memory::Memory;
use crate::machine::threads::Thread;
use crate::telemetry::process_tally::Totals;
use crate::telemetry::quantiles::Quantiles;
use crate::telemetry::tally::Tally;

/// One process over all its restarts. A measure without values is left out.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProcessRow {
    /// How often it was restarted.
    pub restarts: u32,
    /// Its rate: of the world's ticks, of plans, of commands. `None` for a process without a
    /// rate.
    pub rate_hz: Option<f64>,
    /// Ticks done; of the planner, plans made; of the world, those of the run.
    pub ticks: u64,
    /// Ticks of the grid skipped.
    pub skipped: u64,
    /// Ticks of the grid between the end of one of its lives and the start of the next.
    pub absent: u64,
    /// Time from tick to tick, s; `None` of a process without a grid.
    pub period_s: Option<f64>,
    /// From its first tick due to its next one due, over all its lives, s on the
    /// run's clock:
    /// `elapsed_s / period_s == ticks + skipped`.
    pub elapsed_s: Option<f64>,
    /// Ticks completed after their deadline.
    pub late: u64,
    /// Ticks in which a part took longer than its budget, by part.
    pub overruns: BTreeMap<&'static str, u64>,
    /// Messages lost on queues that it reads; of the recorder, all that its recording lacks.
    pub lost: u64,
    /// Messages that it refused.
    pub refused: u64,
    /// Messages that it refused, by reason.
    pub refusals: BTreeMap<&'static str, u64>,
    /// From the scheduled instant to the begin of the tick.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub release_lateness_us: Option<Quantiles>,
    /// From the event that released the tick to its begin (world, planner,
    /// controller).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wake_up_us: Option<Quantiles>,
    /// From begin to end of the tick.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub execution_us: Option<Quantiles>,
    /// From the world's release of an observation to the command for it (controller).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub response_us: Option<Quantiles>,
    /// Age of the observation at the tick that answers it (planner, controller).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub observation_age_us: Option<Quantiles>,
    /// Age of the plan's observation at the tick (controller).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plan_age_us: Option<Quantiles>,
    /// Age of the advice's observation at the tick (controller).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub advice_age_us: Option<Quantiles>,
    /// Page faults of the tick's thread that needed no disk, since it was ready.
    pub minor_faults: u64,
    /// Page faults of the tick's thread that waited for the disk.
    pub major_faults: u64,
    /// Involuntary context switches of the tick's thread.
    pub involuntary_switches: u64,
    /// Resident memory at its peak, MB of 10^6 bytes.
    pub resident_mb: f64,
    /// Its memory by kind.
    pub memory_mb: MemoryRow,
    /// Its threads at the last reading, with the privileges that each asked for and got.
    pub threads: Vec<Thread>,
    /// The real-time privileges that it asked for and was granted.
    pub realtime: RealTime,
}

/// Resident memory of one process by kind, MB of 10^6 bytes; each at its own peak.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MemoryRow {
    /// Heap and stacks.
    pub anonymous: f64,
    /// Programs and libraries, shared with other processes.
    pub file: f64,
    /// Messages in shared memory.
    pub shared: f64,
}

impl MemoryRow {
    fn of(memory: &Memory) -> Self {
        Self {
            anonymous: megabytes(memory.anonymous),
            file: megabytes(memory.file),
            shared: megabytes(memory.shared),
        }
    }
}

fn megabytes(bytes: u64) -> f64 {
    bytes as f64 / 1e6
}

/// Real-time privileges of one process.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RealTime {
    /// Real-time scheduling: not asked, granted or refused.
    pub priority: &'static str,
    /// The scheduling asked for: ordinary or fifo.
    pub scheduling_asked: &'static str,
    /// The scheduling in force.
    pub scheduling_got: &'static str,
    /// The priority asked for; 0 for none.
    pub priority_asked: u32,
    /// The priority in force; 0 for none.
    pub priority_got: u32,
    /// Its own core.
    pub core: &'static str,
    /// Memory locked.
    pub memory: &'static str,
}

impl ProcessRow {
    /// The row of one process from the tally.
    pub fn of(process: Process, restarts: u32, config: &Config, tally: &Tally) -> Self {
        let counted = tally.process(process);
        let totals = counted.map_or_else(Totals::default, |counted| counted.totals());
        let timing = counted.map(|counted| counted.timing()).unwrap_or_default();
        let health = counted
            .and_then(|counted| counted.newest())
            .copied()
            .unwrap_or_default();
        let memory = counted.map_or_else(Memory::default, |counted| counted.memory());
        let grant = |code| Grant::from_code(code).unwrap_or(Grant::Refused).word();
        let scheduling = |code| {
            Scheduling::from_code(code)
                .unwrap_or(Scheduling::Ordinary)
                .word()
        };
        let us = |measure| Quantiles::of(timing.of(measure));
        let period_s = config.tick_ns(process).map(|ns| ns as f64 / 1e9);
        Self {
            restarts,
            rate_hz: config.rate_hz(process),
            ticks: totals.ticks,
            skipped: totals.skipped,
            absent: match config.tick_ns(process) {
                Some(period_ns) => totals.absent_ns / period_ns.max(1),
                None => 0,
            },
            period_s,
            elapsed_s: period_s.map(|_| totals.elapsed_ns as f64 / 1e9),
            late: totals.late,
            overruns: totals
                .overruns()
                .map(|(part, count)| (part.word(), count))
                .collect(),
            lost: totals.lost,
            refused: totals.refused.total(),
            refusals: totals
                .refused
                .occurred()
                .map(|(kind, count)| (kind.word(), count))
                .collect(),
            release_lateness_us: us(Measure::ReleaseLateness),
            wake_up_us: us(Measure::WakeUp),
            execution_us: us(Measure::Execution),
            response_us: us(Measure::Response),
            observation_age_us: us(Measure::ObservationAge),
            plan_age_us: us(Measure::PlanAge),
            advice_age_us: us(Measure::AdviceAge),
            minor_faults: totals.minor_faults,
            major_faults: totals.major_faults,
            involuntary_switches: totals.involuntary_switches,
            resident_mb: megabytes(memory.resident),
            memory_mb: MemoryRow::of(&memory),
            threads: counted.map_or_else(Vec::new, |counted| counted.threads().to_vec()),
            realtime: RealTime {
                priority: grant(health.priority),
                scheduling_asked: scheduling(health.scheduling_asked),
                scheduling_got: scheduling(health.scheduling_got),
                priority_asked: health.priority_asked,
                priority_got: health.priority_got,
                core: grant(health.core),
                memory: grant(health.memory),
            },
        }
    }
}
