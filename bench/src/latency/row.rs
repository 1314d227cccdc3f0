//! Results of one row, and their consistency check.

use anyhow::bail;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::arguments::Settings;
use super::recording::Recorded;
use super::watch::Beside;
use crate::driven::{Punctuality, Quantiles};

/// Version of the measuring method; raise it with every change: rows of another version
/// are measured again. 2: skipped ticks count in the lateness, and wake-ups are
/// measured. 3: stalls are recorded on each core, and processors are kept from sleeping
/// where that is granted.
pub const METHOD: u32 = 3;
/// Published target of release lateness and wake-up: the 99.9 % quantile of controller
/// and planner over that of the floor.
pub const FLOOR_RATIO_MAX: f64 = 1.3;
/// Published targets of the response, from observation to command, 99 % quantile, us:
/// without load, and under any load.
pub const RESPONSE_MAX_US: [f64; 2] = [1_500.0, 5_000.0];
/// With fewer samples, a 99.9 % quantile is close to the maximum.
pub const SAMPLES_FEW: u64 = 10_000;

/// Results of one run of the set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Requested tick rate, Hz.
    pub rate_hz: f64,
    /// Load during the row.
    pub beside: String,
    /// Requested priority: real-time or ordinary.
    pub priority: String,
    /// Settings of the measurement.
    pub settings: Settings,
    /// Questions that the judge received.
    pub questions: u64,
    /// Number of weights that proposed actions: the row's own, or those of the learner.
    pub weights: u64,
    /// Restarts of processes.
    pub restarts: u64,
    /// Requested plan rate, Hz.
    pub plan_rate_hz: f64,
    /// Punctuality of the world.
    pub world: Punctuality,
    /// Punctuality of the planner; missed plans were due and not made, or made late.
    pub planner: Punctuality,
    /// Punctuality of the controller.
    pub controller: Punctuality,
    /// From the release of the observation to the command, us.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub response_us: Option<Quantiles>,
    /// Whether the processors were kept from sleeping; this holds for the floor, too.
    pub cpu_latency: String,
    /// The program that measured the floor.
    pub floor_by: String,
    /// The machine's floor during the same seconds.
    pub floor: Punctuality,
    /// The floor as measured by a thread of this program.
    pub own_floor: Punctuality,
    /// What the recorder cost and lost; `None` without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recording: Option<Recorded>,
    /// Missed ticks, each with the machine's stall in the same second.
    pub misses: Vec<Beside>,
    /// The most late ticks of the controller, with the same.
    pub latest: Vec<Beside>,
    /// The machine's longest stalls, on any core, us.
    pub stalls_us: Vec<f64>,
}

impl Row {
    /// A process's 99.9 % quantile of lateness or wake-up over that of the floor's lateness
    /// (which is also its wake-up); `None` if either is missing.
    pub fn to_floor(&self, process_us: Option<Quantiles>) -> Option<f64> {
        Some(process_us?.p999 / self.floor.lateness_us?.p999)
    }

    /// Whether controller and planner are within the target ratio to the floor.
    fn are_near_floor(&self, of: impl Fn(&Punctuality) -> Option<Quantiles>) -> bool {
        [&self.controller, &self.planner].iter().all(|process| {
            let ratio = self.to_floor(of(process));
            ratio.is_some_and(|ratio| ratio <= FLOOR_RATIO_MAX)
        })
    }

    /// Checks that each process accounts for every instant of its grid.
    ///
    /// # Errors
    /// The process that does not, with its numbers.
    pub fn check_accounts(&self) -> anyhow::Result<()> {
        let all = [
            ("world", &self.world),
            ("controller", &self.controller),
            ("planner", &self.planner),
        ];
        for (name, process) in all {
            // At a rate below the run's, the planner has no grid of its own.
            if name == "planner" && process.elapsed_s == 0.0 {
                continue;
            }
            let due = (process.elapsed_s * self.rate_hz).round() as u64;
            let counted = process.ticks + process.skipped;
            if due != counted || process.ticks == 0 {
                bail!(
                    "{} Hz, {}, {}: {name}: ticks {} + skipped {} = {counted}, but elapsed {} s \
                     are {due} periods",
                    self.rate_hz,
                    self.beside,
                    self.priority,
                    process.ticks,
                    process.skipped,
                    process.elapsed_s
                );
            }
        }
        Ok(())
    }

    /// Comparison with the published targets, in a few words.
    pub fn verdict(&self) -> String {
        let beside_nothing = self.beside == "none";
        let response_max_us = RESPONSE_MAX_US[usize::from(!beside_nothing)];
        let answered = |us: Quantiles| us.p99 < response_max_us;
        let word = |holds: bool| if holds { "holds" } else { "over" };
        let missed = self.controller.missed + self.world.missed + self.planner.missed;
        format!(
            "lateness {}, wake-up {}, response {}, {}",
            word(self.are_near_floor(|process| process.lateness_us)),
            word(self.are_near_floor(|process| process.wake_up_us)),
            word(self.response_us.is_some_and(answered)),
            match missed {
                0 => "none missed".to_string(),
                _ => format!("{missed} missed"),
            }
        )
    }
}

/// Punctuality of the planner. At a rate below the run's its grid begins anew with each
/// episode and cannot be checked: the plans due are then counted on the controller's grid.
pub fn planner(summary: &Value, controller: &Punctuality, plan_rate_hz: f64) -> Punctuality {
    let planner = Punctuality::of(summary, "planner");
    if planner.elapsed_s > 0.0 {
        return planner;
    }
    let due = (controller.elapsed_s * plan_rate_hz).round() as u64;
    let skipped = due.saturating_sub(planner.ticks);
    Punctuality {
        skipped,
        missed: planner.late + skipped,
        ..planner
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    fn tail(us: f64) -> Option<Quantiles> {
        Some(Quantiles {
            p99: us,
            p999: us,
            ..Quantiles::default()
        })
    }

    /// A row of 20 s.
    pub fn row() -> Row {
        let process = Punctuality {
            ticks: 1_998,
            skipped: 2,
            missed: 2,
            elapsed_s: 20.0,
            wake_up_us: tail(80.0),
            lateness_us: Some(Quantiles {
                p50: 50.0,
                p99: 80.0,
                p999: 120.0,
                max: 9_000.0,
            }),
            ..Punctuality::default()
        };
        Row {
            rate_hz: 100.0,
            beside: "none".into(),
            priority: "real-time".into(),
            settings: Settings {
                seconds: 20.0,
                overrides: Vec::new(),
                method: METHOD,
                stress: "own threads".into(),
                floor: "own thread".into(),
            },
            questions: 0,
            weights: 0,
            restarts: 0,
            plan_rate_hz: 100.0,
            world: process.clone(),
            planner: process.clone(),
            controller: process.clone(),
            response_us: tail(1_400.0),
            cpu_latency: "granted".into(),
            floor_by: "own thread".into(),
            floor: process.clone(),
            own_floor: process,
            recording: None,
            misses: Vec::new(),
            latest: Vec::new(),
            stalls_us: Vec::new(),
        }
    }

    #[test]
    fn an_unaccounted_instant_is_an_error() {
        let mut lost = row();
        lost.check_accounts().expect("1998 + 2 = 2000");
        lost.controller.skipped = 1;
        let error = lost.check_accounts().expect_err("one is missing");
        assert!(error.to_string().contains("= 1999, but"), "{error}");
        let mut idle = row();
        idle.world = Punctuality::default();
        assert!(idle.check_accounts().is_err(), "nothing was driven");
    }

    #[test]
    fn the_verdict_follows_the_published_bars() {
        let mut row = row();
        assert_eq!(
            row.verdict(),
            "lateness holds, wake-up holds, response holds, 6 missed"
        );
        let slow = row.planner.lateness_us.as_mut().expect("lateness");
        slow.p999 *= 1.31;
        row.response_us = tail(1_500.0);
        assert_eq!(
            row.verdict(),
            "lateness over, wake-up holds, response over, 6 missed"
        );
        row.planner.wake_up_us = row.planner.lateness_us;
        assert!(row.verdict().contains("wake-up over"));
        row.beside = "all".into();
        assert!(row.verdict().contains("response holds"));
        // Without a response, the target is not met.
        row.response_us = None;
        assert!(row.verdict().contains("response over"));
    }
}
