//! The criteria by which a process counts as flat, fixed before the measurement.

use anyhow::{Context, bail};
use serde::Serialize;
use shm_config::counted;

use super::SoakResults;
use super::sample::{Held, SHARED_MEMORY, Sample};
use lab::report::table;
use supervisor::subcommand::say;

/// Share of ticks that is warm-up: buffers fill and pages are touched for the first time.
const WARM_UP: f64 = 0.2;
/// Minimum warm-up, ticks: the world's memory follows the largest map so far, and stops
/// growing within about 100 episodes.
pub const WARM_UP_TICKS_MIN: u64 = 60_000;
/// Minimum number of samples after the warm-up.
const SAMPLES_MIN: usize = 10;
/// Limit of the growth per million ticks, kB: one byte per 16 ticks. At 10 Hz, 28 hours
/// add 64 kB, 16 pages.
const SLOPE_KB: f64 = 64.0;
/// Shorter soaks have no limit of the slope: a single page would exceed it.
const SLOPE_TICKS_MIN: u64 = 1_000_000;
/// Limit of the growth from the first tenth to the last, kB.
const GROWTH_KB: f64 = 256.0;
/// Tenths of the judged ticks in which shared memory may reach a new maximum when it grows
/// beyond `GROWTH_KB`: lag makes 0.5 of ten in the mean in a soak of 100,000 ticks (sum of 1/k,
/// k = 16 to 25), a leak all ten.
const RISES_MAX: usize = 5;
/// Memory that the supervisor may use per episode, kB: its row in the summary.
const EPISODE_KB: f64 = 0.25;
/// The only process that keeps a list of episodes.
const LISTER: &str = "vlaps-supervisor";

/// The criteria for flat.
#[derive(Clone, Debug, Serialize)]
pub struct Rule {
    /// Ticks of the warm-up.
    pub warm_up_ticks: u64,
    /// Limit of the Theil-Sen slope, kB per million ticks; `None` if the soak is too short
    /// for it.
    pub slope_max_kb_per_million: Option<f64>,
    /// Limit of the last tenth's median minus the first tenth's, kB.
    pub growth_max_kb: f64,
    /// Additional growth allowed to the supervisor for its list of episodes, kB in total.
    pub episodes_kb: f64,
    /// Ticks driven.
    pub ticks: u64,
}

/// Measurements of one process after the warm-up.
#[derive(Clone, Debug, Serialize)]
pub struct Flatness {
    /// The program, or the run's shared memory.
    pub name: String,
    /// Anonymous memory at the end: median of the last tenth, kB.
    pub memory_kb: f64,
    /// Maximum anonymous memory, warm-up included, kB.
    pub memory_max_kb: u64,
    /// Maximum resident memory, warm-up included, kB.
    pub resident_max_kb: u64,
    /// Theil-Sen slope, kB per million ticks.
    pub slope_kb_per_million: f64,
    /// The last tenth's median minus the first tenth's, kB.
    pub growth_kb: f64,
    /// Tenths in which memory reached a new maximum, of ten.
    pub rises: usize,
    /// Fewest open files in the first tenth and in the last: a leaked file is in every
    /// later sample, a file that is open for a moment is not.
    pub files: [u64; 2],
    /// Fewest threads in the first tenth and in the last.
    pub threads: [u64; 2],
    /// Least length of the files in shared memory in the first tenth and in the last, kB; 0
    /// for a process.
    pub reserved_kb: [u64; 2],
    /// Number of process ids that it had.
    pub incarnations: usize,
    /// Whether it met the criteria.
    pub is_flat: bool,
}

impl Rule {
    /// The criteria for a soak of this length.
    pub fn of(ticks: u64, episodes: u64) -> Self {
        Self {
            warm_up_ticks: ((ticks as f64 * WARM_UP) as u64).max(WARM_UP_TICKS_MIN),
            slope_max_kb_per_million: (ticks >= SLOPE_TICKS_MIN).then_some(SLOPE_KB),
            growth_max_kb: GROWTH_KB,
            episodes_kb: EPISODE_KB * episodes as f64,
            ticks,
        }
    }

    fn keeps(&self, row: &Flatness) -> bool {
        let listed_kb = match row.name == LISTER {
            true => self.episodes_kb,
            false => 0.0,
        };
        let per_million_kb = listed_kb / (self.ticks as f64 * 1e-6);
        let slope_keeps = self
            .slope_max_kb_per_million
            .is_none_or(|limit| row.slope_kb_per_million <= limit + per_million_kb);
        // A reader that falls behind on a busy machine touches places of a pool that were
        // never used before, up to the pool's length: 11 kB for each step. It falls further
        // behind than ever before only a few times; a leak rises all the time. The length
        // itself never grows.
        let is_small = row.growth_kb <= self.growth_max_kb + listed_kb;
        let growth_keeps = match row.name == SHARED_MEMORY {
            true => {
                row.reserved_kb[1] <= row.reserved_kb[0] && (is_small || row.rises <= RISES_MAX)
            }
            false => is_small,
        };
        slope_keeps
            && growth_keeps
            && row.files[1] <= row.files[0]
            && row.threads[1] <= row.threads[0]
            && row.incarnations == 1
    }
}

/// The row of each sampled process.
///
/// # Errors
/// If there are too few samples for a verdict.
pub fn rows(samples: &[Sample], rule: &Rule) -> anyhow::Result<Vec<Flatness>> {
    let from = rule.warm_up_ticks;
    let counted = samples.iter().filter(|sample| sample.tick >= from).count();
    if counted < SAMPLES_MIN {
        bail!("{counted} samples after the warm-up are too few; raise --ticks");
    }
    let last = samples.last().context("no samples")?;
    let rows = last.held.iter().map(|held| {
        let all: Vec<(u64, &Held)> = samples
            .iter()
            .flat_map(|sample| sample.held.iter().map(|held| (sample.tick, held)))
            .filter(|(_, other)| other.name == held.name)
            .collect();
        let mut row = row(&held.name, &all, from);
        row.is_flat = rule.keeps(&row);
        row
    });
    Ok(rows.collect())
}

fn row(name: &str, all: &[(u64, &Held)], from: u64) -> Flatness {
    let warm: Vec<(u64, &Held)> = all.iter().copied().filter(|(t, _)| *t >= from).collect();
    let tenth = (warm.len() / 10).max(1);
    let (first, last) = (&warm[..tenth], &warm[warm.len() - tenth..]);
    let memory = |part: &[(u64, &Held)]| {
        let mut kb: Vec<f64> = part.iter().map(|(_, held)| held.memory_kb as f64).collect();
        median(&mut kb)
    };
    let fewest = |of: fn(&Held) -> u64| {
        let fewest = |part: &[(u64, &Held)]| part.iter().map(|(_, held)| of(held)).min();
        [first, last].map(|part| fewest(part).unwrap_or(0))
    };
    let used = |part: &[(u64, &Held)]| part.iter().map(|(_, held)| held.memory_kb).max();
    let mut most = used(&all[..all.len() - warm.len()]).unwrap_or(0);
    let mut rises = 0;
    for part in warm.chunks(warm.len().div_ceil(10).max(1)) {
        let top = used(part).unwrap_or(0);
        rises += usize::from(top > most);
        most = most.max(top);
    }
    let points: Vec<(f64, f64)> = warm
        .iter()
        .map(|(tick, held)| (*tick as f64 * 1e-6, held.memory_kb as f64))
        .collect();
    let mut pids: Vec<u32> = all.iter().map(|(_, held)| held.pid).collect();
    pids.sort_unstable();
    pids.dedup();
    let max = |of: fn(&Held) -> u64| all.iter().map(|(_, held)| of(held)).max().unwrap_or(0);
    Flatness {
        name: name.into(),
        memory_kb: memory(last),
        memory_max_kb: max(|held| held.memory_kb),
        resident_max_kb: max(|held| held.resident_kb),
        slope_kb_per_million: theil_sen(&points),
        growth_kb: memory(last) - memory(first),
        rises,
        files: fewest(|held| held.files),
        threads: fewest(|held| held.threads),
        reserved_kb: fewest(|held| held.reserved_kb),
        incarnations: pids.len(),
        is_flat: false,
    }
}

/// Median of the slopes of all pairs: robust against outliers in up to 29 % of the points.
fn theil_sen(points: &[(f64, f64)]) -> f64 {
    let mut slopes = Vec::with_capacity(points.len() * points.len() / 2);
    for (k, (x, y)) in points.iter().enumerate() {
        let later = points[k + 1..].iter().filter(|(other, _)| other > x);
        slopes.extend(later.map(|(other_x, other_y)| (other_y - y) / (other_x - x)));
    }
    median(&mut slopes)
}

/// The upper median; 0 for an empty slice.
fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Prints the table, the criteria, and the conditions.
pub fn print(results: &SoakResults) {
    let mut table = table(&[
        "",
        "memory kB",
        "max",
        "resident max",
        "slope kB/10^6",
        "growth kB",
        "rises",
        "files",
        "threads",
        "",
    ]);
    for row in &results.rows {
        table.add_row([
            row.name.clone(),
            format!("{:.0}", row.memory_kb),
            row.memory_max_kb.to_string(),
            row.resident_max_kb.to_string(),
            format!("{:.2}", row.slope_kb_per_million),
            format!("{:.0}", row.growth_kb),
            row.rises.to_string(),
            format!("{} -> {}", row.files[0], row.files[1]),
            format!("{} -> {}", row.threads[0], row.threads[1]),
            if row.is_flat { "flat" } else { "NOT FLAT" }.into(),
        ]);
    }
    say(table);
    let rule = &results.rule;
    let slope = match rule.slope_max_kb_per_million {
        Some(limit) => format!("slope at most {limit} kB per million ticks (Theil-Sen)"),
        None => "too short for a limit on the slope".into(),
    };
    say(format_args!(
        "flat, after the first {} ticks: {slope}; growth at most {} kB, or, of shared memory, a \
         new maximum (a rise) in at most {RISES_MAX} tenths of the ticks and no growth of its \
         files' length; no more files or threads; no restart; the supervisor's list of episodes \
         may add {:.0} kB",
        rule.warm_up_ticks, rule.growth_max_kb, rule.episodes_kb
    ));
    say(format_args!(
        "{} in {} in {:.0} s, {} skipped, {}, {}; {}",
        counted(results.ticks, "tick"),
        counted(results.episodes, "episode"),
        results.wall_s,
        results.skipped,
        counted(results.restarts, "restart"),
        counted(results.samples, "sample"),
        results.conditions
    ));
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICKS: u64 = 10_000_000;

    /// A sample every 10,000 ticks of one process that holds `memory_kb(tick)`.
    fn samples(held: impl Fn(u64) -> Held) -> Vec<Sample> {
        let ticks = (0..1_000).map(|k| k * 10_000);
        ticks
            .map(|tick| Sample {
                tick,
                held: vec![held(tick)],
            })
            .collect()
    }

    fn held(memory_kb: u64) -> Held {
        Held {
            name: "vlaps-planner".into(),
            pid: 7,
            memory_kb,
            resident_kb: memory_kb,
            reserved_kb: 0,
            files: 20,
            threads: 2,
        }
    }

    fn verdict(samples: &[Sample]) -> Flatness {
        let rows = rows(samples, &Rule::of(TICKS, 30_000)).expect("samples");
        rows[0].clone()
    }

    #[test]
    fn a_byte_per_tick_is_a_leak_and_noise_is_not() {
        let noise = |tick: u64| 8_000 + (tick / 10_000) * 7_919 % 97;
        let flat = verdict(&samples(|tick| held(noise(tick))));
        assert!(flat.is_flat, "{flat:?}");
        let leak = verdict(&samples(|tick| held(noise(tick) + tick / 1_024)));
        assert!(!leak.is_flat, "{leak:?}");
        assert!((leak.slope_kb_per_million - 976.6).abs() < 10.0, "{leak:?}");
    }

    #[test]
    fn what_happens_in_the_warm_up_is_no_leak_and_a_step_after_it_is_one() {
        let step = |at: u64| verdict(&samples(|tick| held(8_000 + 500 * u64::from(tick > at))));
        assert!(step(TICKS / 10).is_flat);
        assert!(!step(TICKS / 2).is_flat);
    }

    #[test]
    fn files_threads_and_restarts_count() {
        let late = |tick: u64| tick > TICKS / 2;
        type Spoil = fn(&mut Held);
        let spoils: [Spoil; 3] = [|h| h.files += 1, |h| h.threads += 1, |h| h.pid += 1];
        for spoil in spoils {
            let row = verdict(&samples(|tick| {
                let mut one = held(8_000);
                if late(tick) {
                    spoil(&mut one);
                }
                one
            }));
            assert!(!row.is_flat, "{row:?}");
        }
    }

    #[test]
    fn shared_memory_may_be_used_up_to_its_length_and_the_length_may_not_grow() {
        let shared = |used_kb: u64, reserved_kb: u64| Held {
            name: SHARED_MEMORY.into(),
            reserved_kb,
            ..held(used_kb)
        };
        let late = |tick: u64| u64::from(tick > TICKS / 2);
        let used = verdict(&samples(|tick| shared(2_000 + 500 * late(tick), 39_000)));
        assert!(used.is_flat, "{used:?}");
        let longer = verdict(&samples(|tick| shared(2_000, 39_000 + 4 * late(tick))));
        assert!(!longer.is_flat, "{longer:?}");
        // A use that goes on growing is found by its slope.
        let leak = verdict(&samples(|tick| shared(2_000 + tick / 1_024, 39_000)));
        assert!(!leak.is_flat, "{leak:?}");
    }

    #[test]
    fn shared_memory_that_rises_all_the_time_is_a_leak_also_in_a_short_soak() {
        let ticks = 100_000;
        let row = |used_kb: &dyn Fn(u64) -> u64| {
            let samples: Vec<Sample> = (0..ticks / 500)
                .map(|k| Sample {
                    tick: 500 * k,
                    held: vec![Held {
                        name: SHARED_MEMORY.into(),
                        reserved_kb: 39_000,
                        ..held(used_kb(500 * k))
                    }],
                })
                .collect();
            rows(&samples, &Rule::of(ticks, 300)).expect("samples")[0].clone()
        };
        let leak = row(&|tick| 2_000 + tick * 11 / 1_000);
        assert!(!leak.is_flat && leak.rises == 10, "{leak:?}");
        // A step sample of 11,872 B every 20 ticks.
        let fast = row(&|tick| 2_000 + tick / 20 * 11_872 / 1_024);
        assert!(!fast.is_flat && fast.rises == 10, "{fast:?}");
        let lag = row(&|tick| 2_000 + 5_000 * u64::from(tick > 80_000));
        assert!(lag.is_flat && lag.rises == 1, "{lag:?}");
    }

    #[test]
    fn a_file_that_is_open_for_a_moment_is_no_leak() {
        let row = verdict(&samples(|tick| {
            let mut one = held(8_000);
            one.files += u64::from(tick == TICKS - 10_000);
            one
        }));
        assert!(row.is_flat, "{row:?}");
    }

    #[test]
    fn only_the_supervisor_may_keep_its_episodes() {
        let listing = |name: &str| {
            verdict(&samples(|tick| Held {
                name: name.into(),
                ..held(8_000 + tick / 2_000)
            }))
        };
        assert!(listing(LISTER).is_flat);
        assert!(!listing("vlaps-planner").is_flat);
    }
}
