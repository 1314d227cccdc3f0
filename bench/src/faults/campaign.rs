//! A campaign: fault after fault on a set that keeps running, set after set.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::Context;
use shm_config::services::Process;
use supervisor::cli::failure::Failure;

use super::room::Room;
use super::rows::{Row, append};
use super::stage::{End, Scene, Stage};
use super::strike::{Blow, Came, await_recovery, came, strike};
use super::trouble::{Kind, Trouble};
use super::{BenchFaults, kinds};
use lab::progress::Progress;
use lab::stop::Stop;
use stack::Clock;
use supervisor::subcommand::settings;

/// Faults of one set before the next begins.
const OF_A_SET: u64 = 50;
/// One set in so many drives at the paper's rate.
const SLOW_SETS: u64 = 8;
/// Ticks a second of most sets, and of those.
const RATES_HZ: (f64, f64) = (100.0, 10.0);
/// How long a set may take until it drives again before the next fault, ns.
const SETTLE_NS: u64 = 20_000_000_000;

/// A campaign in progress.
pub struct Campaign<'a> {
    arguments: &'a BenchFaults,
    room: &'a Room,
    clock: Clock,
    stage: Option<Stage>,
    /// What the account of the set was after the fault before.
    counted: [u64; 6],
    skipped: BTreeMap<String, u64>,
}

impl<'a> Campaign<'a> {
    /// Nothing has happened yet.
    pub fn new(arguments: &'a BenchFaults, room: &'a Room, clock: Clock) -> Self {
        Self {
            arguments,
            room,
            clock,
            stage: None,
            counted: [0; 6],
            skipped: BTreeMap::new(),
        }
    }

    /// What was skipped, and why.
    pub fn skipped(&self) -> Vec<String> {
        let told = |(reason, count): (&String, &u64)| format!("{count} x {reason}");
        self.skipped.iter().map(told).collect()
    }

    /// Everything that can be known before the first fault.
    ///
    /// # Errors
    /// When no set can be configured so, or this machine allows none of the kinds.
    pub fn check(&self) -> anyhow::Result<()> {
        // The first set, and the first of the slow ones.
        for number in [0, OF_A_SET] {
            settings::of_set(self.scene(number).words())?;
        }
        let kinds = kinds(self.arguments);
        let reasons: Vec<String> = kinds.iter().filter_map(|k| self.hindrance(*k)).collect();
        if reasons.len() == kinds.len() {
            let told = format!("--kinds: nothing can be tested: {}", reasons.join("; "));
            return Err(Failure::Usage(told).into());
        }
        Ok(())
    }

    /// Rows of the folder are of this campaign.
    ///
    /// # Errors
    /// The first that is not, and what to do.
    pub fn check_same(&self, done: &[Row]) -> anyhow::Result<()> {
        let refused = |told: String| {
            let told = format!("--resume: {told}, or another --out");
            Err(Failure::Usage(told).into())
        };
        for row in done {
            if row.seed != self.arguments.seed {
                let seed = row.seed;
                return refused(format!(
                    "the folder's campaign has seed {seed}; give it with --seed"
                ));
            }
            let trouble = Trouble::draw(row.seed, row.number, kinds(self.arguments));
            let drawn = (
                trouble.kind.word(),
                trouble.whom(),
                self.rate_hz(row.number),
            );
            if (row.kind.as_str(), row.target.as_str(), row.rate_hz) != drawn {
                let (kind, target, rate_hz) = drawn;
                return refused(format!(
                    "fault {} of the folder is '{} {}' at {} Hz, and would be '{kind} {target}' at \
                     {rate_hz} Hz; give the same --kinds and --rate",
                    row.number, row.kind, row.target, row.rate_hz
                ));
            }
        }
        Ok(())
    }

    /// Numbers of the faults that are not done.
    pub fn left(&self, done: &[Row]) -> Vec<u64> {
        let numbers = match self.arguments.only {
            Some(number) => number..number + 1,
            None => 0..self.arguments.faults,
        };
        let known: BTreeSet<u64> = done.iter().map(|row| row.number).collect();
        numbers.filter(|number| !known.contains(number)).collect()
    }

    /// Makes all faults that are not done, until a stop is requested; the one that is
    /// in progress then is made anew another time.
    ///
    /// # Errors
    /// When a set does not start, or a row cannot be kept. The rows until then are
    /// there, the one that could not be kept among them.
    pub fn run(
        &mut self,
        rows: &mut Vec<Row>,
        file: Option<&Path>,
        stop: &Stop,
    ) -> anyhow::Result<()> {
        let left = self.left(rows);
        let span = (rows.len() as u64, (rows.len() + left.len()) as u64);
        let mut progress = Progress::begin("faults".into(), "faults", span, self.clock)?;
        for (index, &number) in left.iter().enumerate() {
            let mut row = self.fault(number, stop)?;
            if stop.is_asked() {
                break;
            }
            let next = left.get(index + 1);
            let rate_hz = self.rate_hz(number);
            let is_last = next.is_none_or(|&next| {
                next / OF_A_SET != number / OF_A_SET || self.rate_hz(next) != rate_hz
            });
            if is_last && let Some(stage) = self.stage.take() {
                note(&mut row, stage.end()?);
            }
            let kept = file.map_or(Ok(()), |file| append(file, &row));
            rows.push(row);
            kept?;
            progress.note(format!(
                "{} wrong",
                rows.iter()
                    .filter(|row| row.verdict != "ok" && !row.is_skipped())
                    .count()
            ));
            if index % 10 == 9 || is_last {
                progress.at(rows.len() as u64);
            }
        }
        progress.end();
        self.stage.take().map_or(Ok(()), Stage::give_up)
    }

    fn rate_hz(&self, number: u64) -> f64 {
        let is_slow = number / OF_A_SET % SLOW_SETS == 1;
        self.arguments.rate.unwrap_or(match is_slow {
            true => RATES_HZ.1,
            false => RATES_HZ.0,
        })
    }

    /// One fault, from a set that drives to one that does again.
    fn fault(&mut self, number: u64, stop: &Stop) -> anyhow::Result<Row> {
        let clock = self.clock;
        let mut trouble = Trouble::draw(self.arguments.seed, number, kinds(self.arguments));
        let mut row = Row {
            seed: self.arguments.seed,
            number,
            rate_hz: self.rate_hz(number),
            kind: trouble.kind.word().into(),
            target: trouble.whom().into(),
            verdict: "ok".into(),
            ..Row::default()
        };
        if let Some(reason) = self.hindrance(trouble.kind) {
            *self.skipped.entry(reason).or_default() += 1;
            row.verdict = "skipped".into();
            return Ok(row);
        }
        let mut stage = match self.stage.take() {
            Some(stage) => stage,
            None => self.begin(number)?,
        };
        if !stage.settle(SETTLE_NS) {
            row.verdict = "the set did not drive before it".into();
            self.give_up(stage, &mut row)?;
            return Ok(row);
        }
        let old_pid = trouble.target.and_then(|target| stage.pid(target));
        let blow = strike(&mut stage, &mut trouble, clock)
            .with_context(|| format!("fault {number}, {} {}", row.kind, row.target))?;
        row.struck_ns = stage.watch().trial().map_or(0, |trial| trial.struck.0);
        match blow {
            Blow::Skipped(reason) => {
                *self.skipped.entry(reason).or_default() += 1;
                row.verdict = "skipped".into();
                self.stage = Some(stage);
            }
            Blow::Goes { detail } => {
                row.detail = detail;
                let came = await_recovery(&mut stage, &trouble, old_pid, (clock, stop));
                tell(&mut row, &came);
                self.count(&mut stage, &mut row);
                if came.recovered_ns.is_none() && !stop.is_asked() {
                    row.verdict = "did not come back".into();
                    self.give_up(stage, &mut row)?;
                } else {
                    self.stage = Some(stage);
                }
            }
            Blow::Ended => self.end_early(stage, &mut row, Stage::bury)?,
            Blow::Resigns => self.end_early(stage, &mut row, Stage::resign)?,
        }
        Ok(row)
    }

    /// Why a kind cannot be had here; `None` when it can.
    fn hindrance(&self, kind: Kind) -> Option<String> {
        let word = kind.word();
        match kind {
            Kind::Disk | Kind::Shm | Kind::Files if !self.room.is_private => Some(format!(
                "{word}: this machine grants no mount namespace (unshare -m), and the disks of \
                 others are not filled"
            )),
            Kind::Clock if !self.arguments.step_clock => Some(format!(
                "{word}: the wall clock has no namespace, all on this machine would see it jump; \
                 --step-clock on a machine of your own"
            )),
            _ => None,
        }
    }

    fn begin(&mut self, number: u64) -> anyhow::Result<Stage> {
        self.counted = [0; 6];
        Stage::start(self.scene(number), self.clock)
    }

    fn scene(&self, number: u64) -> Scene {
        Scene {
            // The dead run's name again: its successor clears away what it left.
            run: format!("faults-{}", std::process::id()),
            folder: self.room.folder.join("set"),
            rate_hz: self.rate_hz(number),
            seed: 1000 + number,
            overrides: self.arguments.overrides.clone(),
        }
    }

    /// What the account has come to since the fault before.
    fn count(&mut self, stage: &mut Stage, row: &mut Row) {
        let ledger = &mut stage.watch().ledger;
        let now = [
            ledger.violations,
            ledger.steps,
            ledger.lost,
            ledger.skipped,
            ledger.unmanned,
            ledger.unaccounted,
        ];
        let words = std::mem::take(&mut ledger.words);
        let since = |index: usize| now[index] - self.counted[index];
        row.violations = since(0);
        row.steps = since(1);
        row.lost = since(2);
        row.skipped = since(3);
        row.unmanned = since(4);
        row.unaccounted = since(5);
        self.counted = now;
        if !words.is_empty() {
            row.verdict = words.join("; ");
        }
    }

    /// The set of a dead supervisor is buried, and one that is beyond help resigns;
    /// the next begins at once, and that is the recovery.
    fn end_early(
        &mut self,
        mut stage: Stage,
        row: &mut Row,
        end: fn(Stage) -> anyhow::Result<End>,
    ) -> anyhow::Result<()> {
        let limits = stage.watch().limits;
        // What was on its way when it struck has come by now.
        stage.watch_for(4 * limits.period_ns);
        self.count(&mut stage, row);
        let trial = stage.watch().take_trial().context("a trial")?;
        note(row, end(stage)?);
        let mut next = self.begin(row.number + 1)?;
        let drives = next.settle(SETTLE_NS).then(self.clock);
        tell(row, &came(&trial, &limits, drives));
        self.stage = Some(next);
        Ok(())
    }

    /// Ends a set that does not drive any more.
    fn give_up(&mut self, mut stage: Stage, row: &mut Row) -> anyhow::Result<()> {
        stage.signal(Process::Supervisor, rustix::process::Signal::KILL);
        let end = stage.bury()?;
        note(row, end);
        Ok(())
    }
}

fn tell(row: &mut Row, came: &Came) {
    let ms = |ns: Option<u64>| ns.map(|ns| ns as f64 / 1e6);
    row.safe_ms = ms(came.safe_ns);
    row.by = came.by.into();
    row.command_ms = ms(came.command_ns);
    row.recovered_ms = ms(came.recovered_ns);
}

/// Notes in the row of a set's last fault how it ended.
fn note(row: &mut Row, end: End) {
    row.leftovers += end.leftovers.len() as u64;
    let words: Vec<String> = end.leftovers.into_iter().chain(end.wrongs).collect();
    if !words.is_empty() {
        row.verdict = format!("{}; {}", row.verdict, words.join("; "));
    }
}
