//! Draws the faults of a campaign from its seed and the fault's number.

use clap::ValueEnum;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use shm_config::services::Process;

/// Kind of a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
pub enum Kind {
    /// SIGKILL.
    Kill,
    /// SIGSTOP, and SIGCONT a while later.
    Stop,
    /// The process lives, but its loop waits for ever.
    Hang,
    /// The loop spins for ever and blocks all processes of lower priority on its core.
    Spin,
    /// The loop pauses for a while.
    Slow,
    /// A panic.
    Panic,
    /// An allocation fails, which aborts the process.
    Allocation,
    /// The process cannot allocate memory for a while (`RLIMIT_AS`).
    Memory,
    /// The disk of the run is full for a while.
    Disk,
    /// /dev/shm is full for a while.
    Shm,
    /// The wall clock jumps forward by an hour and back.
    Clock,
    /// A process with write access publishes malformed messages.
    Hostile,
    /// A process outside the run sends commands of the current episode.
    ForeignCommand,
    /// It sends commands of another episode.
    OtherEpisode,
    /// It sends observations between two instants of the grid.
    ForeignObservation,
    /// It sends plans and advice.
    ForeignPlan,
    /// It sends health reports, progress and finished episodes.
    ForgedHealth,
    /// It takes all ports of the services, so that a restarted process finds none.
    Slots,
    /// It holds messages that it has received.
    Loans,
    /// The run's files are removed while it drives.
    Files,
    /// SIGKILL to all processes but the supervisor, at once.
    All,
}

impl Kind {
    /// Relative frequency if all kinds are requested; the sum is 104.
    fn weight(self) -> u64 {
        match self {
            Kind::Kill => 29,
            Kind::Stop => 12,
            Kind::Hang => 3,
            Kind::Spin => 3,
            Kind::Slow => 12,
            Kind::Panic => 10,
            Kind::Allocation => 6,
            Kind::Memory => 4,
            Kind::Disk => 3,
            Kind::Shm => 3,
            Kind::Clock => 1,
            Kind::Hostile => 6,
            Kind::ForeignCommand | Kind::ForeignObservation => 2,
            Kind::OtherEpisode | Kind::ForeignPlan | Kind::ForgedHealth => 1,
            Kind::Slots | Kind::Loans => 1,
            Kind::Files => 1,
            Kind::All => 2,
        }
    }

    /// Possible targets, dangerous ones repeated; empty if the target is the machine.
    fn targets(self) -> &'static [Process] {
        use Process::{Controller, Gate, Learner, Planner, Supervisor, World};
        match self {
            Kind::Kill => &[
                Controller, Controller, Controller, Planner, Planner, World, World, Gate, Learner,
                Supervisor,
            ],
            Kind::Stop => &[
                Controller, Controller, Planner, World, Gate, Learner, Supervisor,
            ],
            Kind::Hang | Kind::Spin | Kind::Slow | Kind::Panic | Kind::Allocation => &[
                Controller, Controller, Planner, Planner, World, Gate, Learner,
            ],
            Kind::Memory => &[Controller, Planner, World, Gate],
            // The disk space is needed when a process restarts.
            Kind::Disk | Kind::Shm => &[Controller, Planner, World, Gate],
            Kind::Files => &[Controller, Planner],
            Kind::Slots => &[Controller, Planner, World],
            Kind::Clock | Kind::Hostile | Kind::All | Kind::Loans => &[],
            Kind::ForeignCommand
            | Kind::OtherEpisode
            | Kind::ForeignObservation
            | Kind::ForeignPlan
            | Kind::ForgedHealth => &[],
        }
    }

    /// Whether it ends a process at once, so that another process has to act.
    pub fn is_a_death(self) -> bool {
        matches!(
            self,
            Kind::Kill | Kind::Panic | Kind::Allocation | Kind::All
        )
    }

    /// Whether the process lives but does nothing until it is killed.
    pub fn is_a_hang(self) -> bool {
        matches!(self, Kind::Hang | Kind::Spin)
    }

    /// The name on the command line.
    pub fn word(self) -> &'static str {
        match self {
            Kind::Kill => "kill",
            Kind::Stop => "stop",
            Kind::Hang => "hang",
            Kind::Spin => "spin",
            Kind::Slow => "slow",
            Kind::Panic => "panic",
            Kind::Allocation => "allocation",
            Kind::Memory => "memory",
            Kind::Disk => "disk",
            Kind::Shm => "shm",
            Kind::Clock => "clock",
            Kind::Hostile => "hostile",
            Kind::ForeignCommand => "foreign-command",
            Kind::OtherEpisode => "other-episode",
            Kind::ForeignObservation => "foreign-observation",
            Kind::ForeignPlan => "foreign-plan",
            Kind::ForgedHealth => "forged-health",
            Kind::Slots => "slots",
            Kind::Loans => "loans",
            Kind::Files => "files",
            Kind::All => "all",
        }
    }
}

/// One fault of a campaign.
#[derive(Debug, Clone)]
pub struct PlannedFault {
    /// Kind.
    pub kind: Kind,
    /// Target process; `None` for the machine, or for all processes.
    pub target: Option<Process>,
    /// Delay after the set has been seen to drive, as a share of a period.
    pub phase: f64,
    /// Duration, periods; used by the kinds that last.
    pub periods: f64,
    /// Whether the target is killed meanwhile.
    pub kills: bool,
    /// Random generator for everything else.
    pub dice: Xoshiro256PlusPlus,
}

impl PlannedFault {
    /// Draws the fault of a number. It depends only on the seed, the number and the
    /// requested kinds, so that it can be repeated alone.
    pub fn draw(seed: u64, number: u64, kinds: &[Kind]) -> Self {
        let mixed = (number + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let mut dice = Xoshiro256PlusPlus::seed_from_u64(seed ^ mixed);
        let total: u64 = kinds.iter().map(|kind| kind.weight()).sum();
        let mut left = dice.next_u64() % total.max(1);
        let mut chosen = Kind::Kill;
        for &kind in kinds {
            chosen = kind;
            match left.checked_sub(kind.weight()) {
                Some(rest) => left = rest,
                None => break,
            }
        }
        let targets = chosen.targets();
        let target = match targets.len() as u64 {
            0 => None,
            count => Some(targets[(dice.next_u64() % count) as usize]),
        };
        Self {
            kind: chosen,
            target,
            phase: share(&mut dice),
            periods: 0.5 + 19.5 * share(&mut dice),
            kills: dice.next_u64().is_multiple_of(2),
            dice,
        }
    }

    /// Whether a process may die of it. A full file system alone ends none.
    pub fn may_kill(&self) -> bool {
        self.kills || !matches!(self.kind, Kind::Disk | Kind::Shm)
    }

    /// The target's name; empty for the machine, or for all processes.
    pub fn target_name(&self) -> &'static str {
        self.target.map_or("", Process::word)
    }
}

/// Uniform in [0, 1).
pub fn share(dice: &mut Xoshiro256PlusPlus) -> f64 {
    (dice.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn a_fault_is_repeated_by_its_seed_and_number_alone() {
        let all = Kind::value_variants();
        let faults = |seed| (0..2000).map(move |k| PlannedFault::draw(seed, k, all));
        let mut counts = BTreeMap::new();
        for (one, other) in faults(1).zip(faults(1)) {
            assert_eq!(format!("{one:?}"), format!("{other:?}"));
            *counts
                .entry((one.kind, one.target.map(Process::code)))
                .or_insert(0) += 1;
        }
        let kinds: Vec<Kind> = counts.keys().map(|key| key.0).collect();
        assert!(all.iter().all(|kind| kinds.contains(kind)), "{counts:?}");
        let differ = faults(1)
            .zip(faults(2))
            .filter(|(one, other)| one.kind != other.kind);
        assert!(differ.count() > 1000, "another seed is another campaign");
        let killed = Kind::Kill.targets();
        for target in killed {
            let count = counts.get(&(Kind::Kill, Some(target.code())));
            assert!(count > Some(&20), "{target}: {counts:?}");
        }
    }

    #[test]
    fn only_requested_kinds_are_drawn() {
        let wished = [Kind::Stop, Kind::Hostile];
        let drawn = (0..500).map(|k| PlannedFault::draw(7, k, &wished).kind);
        assert!(drawn.clone().all(|kind| wished.contains(&kind)));
        assert!(
            wished
                .iter()
                .all(|kind| drawn.clone().any(|one| one == *kind))
        );
    }
}
