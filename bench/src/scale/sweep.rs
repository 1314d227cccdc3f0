//! A cost over its work.

use clap::ValueEnum;
use lab::statistics::quantile;
use lab::stop::Stop;
use serde::{Deserialize, Serialize};

use super::{beams, bodies, episodes, plans, recording, sets, worlds};
use crate::gauges::Gauges;

/// Fewest turns of a row.
const TURNS_MIN: usize = 5;

/// What all sweeps share.
pub struct Bench {
    /// The clocks.
    pub gauges: Gauges,
    /// Seconds for each row.
    pub seconds: f64,
    /// Most sets beside each other.
    pub sets_max: u64,
    /// Stop requests.
    pub stop: Stop,
    /// Folder for temporary files.
    pub scratch: tempfile::TempDir,
}

/// The costs that are measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Sweep {
    /// An observation over the beams of the scanner.
    Beams,
    /// A tick of the world over the cars and obstacles in it.
    Bodies,
    /// A plan over the iterations of RRT*.
    Plans,
    /// A step of a batch over its worlds.
    Worlds,
    /// Memory of a batch over its worlds.
    Memory,
    /// An evaluation over its episodes.
    Episodes,
    /// Bytes of a recording over its ticks.
    Bytes,
    /// Time to write a recording over its ticks.
    Writing,
    /// Response of sets beside each other at 10 Hz.
    #[value(name = "sets-10")]
    Sets10,
    /// Response of sets beside each other at 100 Hz.
    #[value(name = "sets-100")]
    Sets100,
}

/// Late ticks of sets beside each other, and of an idle thread in the same time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Late {
    /// Late and skipped ticks of world, planner and controller of all sets.
    pub sets: u64,
    /// Wake-ups that an idle thread of the same priority and period missed.
    pub floor: u64,
    /// Ticks of all controllers.
    pub ticks: u64,
}

/// A measured cost.
#[derive(Clone, Debug, Default)]
pub struct Cost {
    /// The work as it was: of bodies the mean number.
    pub work: f64,
    /// The cost in each turn.
    pub turns: Vec<f64>,
    /// Late ticks, of sets alone.
    pub late: Option<Late>,
}

impl Cost {
    /// Median and quartiles of the turns.
    pub fn quartiles(&self) -> [f64; 3] {
        [0.5, 0.25, 0.75].map(|share| quantile(&self.turns, share))
    }
}

impl Sweep {
    /// Name as in `--sweep`.
    pub fn word(self) -> &'static str {
        match self {
            Sweep::Beams => "beams",
            Sweep::Bodies => "bodies",
            Sweep::Plans => "plans",
            Sweep::Worlds => "worlds",
            Sweep::Memory => "memory",
            Sweep::Episodes => "episodes",
            Sweep::Bytes => "bytes",
            Sweep::Writing => "writing",
            Sweep::Sets10 => "sets-10",
            Sweep::Sets100 => "sets-100",
        }
    }

    /// What grows.
    pub fn work(self) -> &'static str {
        match self {
            Sweep::Beams => "beams",
            Sweep::Bodies => "bodies",
            Sweep::Plans => "iterations",
            Sweep::Worlds | Sweep::Memory => "worlds",
            Sweep::Episodes => "episodes",
            Sweep::Bytes | Sweep::Writing => "ticks",
            Sweep::Sets10 | Sweep::Sets100 => "sets",
        }
    }

    /// The cost with its unit.
    pub fn cost(self) -> &'static str {
        match self {
            Sweep::Beams => "observation, us of processor",
            Sweep::Bodies => "tick of the world, us of processor",
            Sweep::Plans => "plan, us of processor",
            Sweep::Worlds => "step of the batch, us of processor",
            Sweep::Memory => "memory of the batch, kB",
            Sweep::Episodes => "evaluation, ms of processor",
            Sweep::Bytes => "recording, kB",
            Sweep::Writing => "writing, us of processor",
            Sweep::Sets10 | Sweep::Sets100 => "response p99, us",
        }
    }

    /// The amounts of work, growing; of bodies the density of traffic in thousandths.
    pub fn values(self, bench: &Bench) -> Vec<u64> {
        match self {
            Sweep::Beams => beams::VALUES.to_vec(),
            Sweep::Bodies => bodies::VALUES.to_vec(),
            Sweep::Plans => plans::VALUES.to_vec(),
            Sweep::Worlds | Sweep::Memory => worlds::VALUES.to_vec(),
            Sweep::Episodes => episodes::VALUES.to_vec(),
            Sweep::Bytes | Sweep::Writing => recording::VALUES.to_vec(),
            Sweep::Sets10 | Sweep::Sets100 => sets::values(bench.sets_max),
        }
    }

    /// Measures one amount of work; `None` if a stop is requested meanwhile.
    ///
    /// # Errors
    /// If it cannot be measured.
    pub fn measure(self, value: u64, bench: &Bench) -> anyhow::Result<Option<Cost>> {
        match self {
            Sweep::Beams => beams::measure(value, bench),
            Sweep::Bodies => bodies::measure(value, bench),
            Sweep::Plans => plans::measure(value, bench),
            Sweep::Worlds => worlds::steps(value, bench),
            Sweep::Memory => worlds::memory(value, bench),
            Sweep::Episodes => episodes::measure(value, bench),
            Sweep::Bytes => recording::bytes(value, bench),
            Sweep::Writing => recording::writing(value, bench),
            Sweep::Sets10 => sets::measure(value, 10.0, bench),
            Sweep::Sets100 => sets::measure(value, 100.0, bench),
        }
    }
}

impl Bench {
    /// Repeats a turn until the row's time is over; `None` if a stop is requested
    /// meanwhile.
    ///
    /// # Errors
    /// The first error of a turn.
    pub fn turns(
        &self,
        mut turn: impl FnMut() -> anyhow::Result<f64>,
    ) -> anyhow::Result<Option<Vec<f64>>> {
        let begun = self.gauges.now();
        let mut turns = Vec::new();
        while turns.len() < TURNS_MIN
            || (self.gauges.now().since_ns(begun) as f64) < self.seconds * 1e9
        {
            if self.stop.is_asked() {
                return Ok(None);
            }
            turns.push(turn()?);
        }
        Ok(Some(turns))
    }

    /// Processor time of this thread in `work`, s.
    pub fn core_s(&self, work: impl FnOnce()) -> f64 {
        let begun = self.gauges.core();
        work();
        (self.gauges.core() - begun).as_secs_f64()
    }
}
