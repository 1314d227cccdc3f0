//! A campaign: a series of faults on one running set, then on the next set.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::Context;
use shm_config::services::Process;
use supervisor::cli::failure::Failure;

use super::inject::{Effect, Outcome, await_recovery, inject, outcome_of};
use super::monitor::CHILDREN;
use super::planned::{Kind, PlannedFault};
use super::results::{Row, append};
use super::sandbox::Sandbox;
use super::tested_set::{End, SetOptions, TestedSet};
use super::{BenchFaults, kinds};
use lab::progress::Progress;
use lab::stop::Stop;
use stack::Clock;
use supervisor::subcommand::settings;

/// Faults per set.
const FAULTS_PER_SET: u64 = 50;
/// One in this many sets drives at the lower rate, that of the paper.
const SLOW_SETS: u64 = 8;
/// Tick rate of most sets, and the lower rate, Hz.
const RATES_HZ: (f64, f64) = (100.0, 10.0);
/// Time limit for a set to drive again before the next fault, ns.
const SETTLE_NS: u64 = 20_000_000_000;

/// A campaign in progress.
pub struct Campaign<'a> {
    arguments: &'a BenchFaults,
    sandbox: &'a Sandbox,
    clock: Clock,
    set: Option<TestedSet>,
    /// The counts of the set's ledger at the end of the previous fault.
    counted: [u64; 6],
    skipped: BTreeMap<String, u64>,
}

impl<'a> Campaign<'a> {
    /// A campaign before its first fault.
    pub fn new(arguments: &'a BenchFaults, sandbox: &'a Sandbox, clock: Clock) -> Self {
        Self {
            arguments,
            sandbox,
            clock,
            set: None,
            counted: [0; 6],
            skipped: BTreeMap::new(),
        }
    }

    /// The reasons for skipped faults, with counts.
    pub fn skipped(&self) -> Vec<String> {
        let message = |(reason, count): (&String, &u64)| format!("{count} x {reason}");
        self.skipped.iter().map(message).collect()
    }

    /// Checks everything that can be known before the first fault.
    ///
    /// # Errors
    /// If a set's configuration is invalid, or this machine allows none of the kinds.
    pub fn check(&self) -> anyhow::Result<()> {
        // The first set, and the first of the lower rate.
        for number in [0, FAULTS_PER_SET] {
            settings::of_set(self.options(number).arguments())?;
        }
        let kinds = kinds(self.arguments);
        let reasons: Vec<String> = kinds.iter().filter_map(|k| self.refusal(*k)).collect();
        if reasons.len() == kinds.len() {
            let message = format!("--kinds: nothing can be tested: {}", reasons.join("; "));
            return Err(Failure::Usage(message).into());
        }
        Ok(())
    }

    /// Checks that the rows of the folder belong to this campaign.
    ///
    /// # Errors
    /// The first row that does not, and what to do.
    pub fn check_same(&self, done: &[Row]) -> anyhow::Result<()> {
        let refused = |message: String| {
            let message = format!("--resume: {message}, or another --out");
            Err(Failure::Usage(message).into())
        };
        for row in done {
            if row.seed != self.arguments.seed {
                let seed = row.seed;
                return refused(format!(
                    "the campaign in the folder has seed {seed}; give --seed {seed}"
                ));
            }
            let programs = self.arguments.programs.line();
            if row.programs != programs {
                let said = |line: &str| match line {
                    "" => "without programs of yours".to_owned(),
                    line => format!("with {line}"),
                };
                return refused(format!(
                    "the campaign in the folder was made {}, not {}; give the same options",
                    said(&row.programs),
                    said(&programs)
                ));
            }
            let planned = PlannedFault::draw(row.seed, row.number, kinds(self.arguments));
            let drawn = (
                planned.kind.word(),
                planned.target_name(),
                self.rate_hz(row.number),
            );
            if (row.kind.as_str(), row.target.as_str(), row.rate_hz) != drawn {
                let (kind, target, rate_hz) = drawn;
                return refused(format!(
                    "fault {} in the folder is '{} {}' at {} Hz, but would be '{kind} {target}' at \
                     {rate_hz} Hz; give the same --kinds and --rate",
                    row.number, row.kind, row.target, row.rate_hz
                ));
            }
        }
        Ok(())
    }

    /// Numbers of the faults that are not in `done`.
    pub fn left(&self, done: &[Row]) -> Vec<u64> {
        let numbers = match self.arguments.only {
            Some(number) => number..number + 1,
            None => 0..self.arguments.faults,
        };
        let known: BTreeSet<u64> = done.iter().map(|row| row.number).collect();
        numbers.filter(|number| !known.contains(number)).collect()
    }

    /// Injects all faults that are not in `done`, until a stop is requested; the fault in
    /// progress then is repeated by a later run.
    ///
    /// # Errors
    /// If a set does not start, or a row cannot be written. `rows` then holds all rows
    /// until then, including the one that could not be written.
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
                next / FAULTS_PER_SET != number / FAULTS_PER_SET || self.rate_hz(next) != rate_hz
            });
            if is_last && let Some(set) = self.set.take() {
                note(&mut row, set.end()?);
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
        self.set.take().map_or(Ok(()), TestedSet::give_up)
    }

    fn rate_hz(&self, number: u64) -> f64 {
        let is_slow = number / FAULTS_PER_SET % SLOW_SETS == 1;
        self.arguments.rate.unwrap_or(match is_slow {
            true => RATES_HZ.1,
            false => RATES_HZ.0,
        })
    }

    /// Injects one fault into a driving set and waits until the set drives again.
    fn fault(&mut self, number: u64, stop: &Stop) -> anyhow::Result<Row> {
        let clock = self.clock;
        let mut planned = PlannedFault::draw(self.arguments.seed, number, kinds(self.arguments));
        let mut row = Row {
            seed: self.arguments.seed,
            number,
            rate_hz: self.rate_hz(number),
            programs: self.arguments.programs.line(),
            kind: planned.kind.word().into(),
            target: planned.target_name().into(),
            verdict: "ok".into(),
            ..Row::default()
        };
        if let Some(reason) = self.refusal(planned.kind) {
            *self.skipped.entry(reason).or_default() += 1;
            row.verdict = "skipped".into();
            return Ok(row);
        }
        let mut set = match self.set.take() {
            Some(set) => set,
            None => self.begin(number)?,
        };
        if !set.settle(SETTLE_NS) {
            row.verdict = "the set did not drive before the fault".into();
            self.give_up(set, &mut row)?;
            return Ok(row);
        }
        let old_pid = planned.target.and_then(|target| set.pid(target));
        let before = CHILDREN.map(|process| set.pid(process));
        let effect = inject(&mut set, &mut planned, clock)
            .with_context(|| format!("fault {number}, {} {}", row.kind, row.target))?;
        row.struck_ns = set.monitor().trial().map_or(0, |trial| trial.injected.0);
        match effect {
            Effect::Skipped(reason) => {
                *self.skipped.entry(reason).or_default() += 1;
                row.verdict = "skipped".into();
                self.set = Some(set);
            }
            Effect::Continues { detail } => {
                row.detail = detail;
                let outcome = await_recovery(&mut set, &planned, old_pid, (clock, stop));
                record_outcome(&mut row, &outcome);
                self.count(&mut set, &mut row);
                if !planned.may_kill()
                    && let Some(dead) = CHILDREN
                        .into_iter()
                        .zip(before)
                        .find(|(process, pid)| set.pid(*process) != *pid)
                {
                    row.verdict = format!("{}; the {} died of it", row.verdict, dead.0);
                }
                if outcome.recovered_ns.is_none() && !stop.is_asked() {
                    row.verdict = "did not recover".into();
                    self.give_up(set, &mut row)?;
                } else {
                    self.set = Some(set);
                }
            }
            Effect::Ended => self.end_early(set, &mut row, TestedSet::end_killed)?,
            Effect::GivesUp => self.end_early(set, &mut row, TestedSet::end_failed)?,
        }
        Ok(row)
    }

    /// The reason why this machine does not allow a kind; `None` if it does.
    fn refusal(&self, kind: Kind) -> Option<String> {
        let word = kind.word();
        match kind {
            Kind::Disk | Kind::Shm | Kind::Files if !self.sandbox.is_private => Some(format!(
                "{word}: this machine grants no mount namespace (unshare -m), and only private file \
                 systems are filled"
            )),
            Kind::Clock if !self.arguments.step_clock => Some(format!(
                "{word}: the wall clock is shared by all programs on this machine; --step-clock allows \
                 the jump"
            )),
            _ => None,
        }
    }

    fn begin(&mut self, number: u64) -> anyhow::Result<TestedSet> {
        self.counted = [0; 6];
        TestedSet::start(self.options(number), self.clock)
    }

    fn options(&self, number: u64) -> SetOptions {
        SetOptions {
            // The same name for every set: the next start cleans up after a killed one.
            run: format!("faults-{}", std::process::id()),
            folder: self.sandbox.folder.join("set"),
            rate_hz: self.rate_hz(number),
            seed: 1000 + number,
            programs: self.arguments.programs.words(),
            overrides: self.arguments.overrides.clone(),
        }
    }

    /// Fills in the row from the ledger's counts since the previous fault.
    fn count(&mut self, set: &mut TestedSet, row: &mut Row) {
        let ledger = &mut set.monitor().ledger;
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

    /// Ends a set whose supervisor is dead or gave up; the next set starts at once, and
    /// that is the recovery.
    fn end_early(
        &mut self,
        mut set: TestedSet,
        row: &mut Row,
        end: fn(TestedSet) -> anyhow::Result<End>,
    ) -> anyhow::Result<()> {
        let limits = set.monitor().limits;
        // By now, everything that was in flight at the fault has arrived.
        set.watch_for(4 * limits.period_ns);
        self.count(&mut set, row);
        let trial = set.monitor().take_trial().context("a trial")?;
        note(row, end(set)?);
        let mut next = self.begin(row.number + 1)?;
        let drives = next.settle(SETTLE_NS).then(self.clock);
        record_outcome(row, &outcome_of(&trial, &limits, drives));
        self.set = Some(next);
        Ok(())
    }

    /// Ends a set that does not drive any more.
    fn give_up(&mut self, mut set: TestedSet, row: &mut Row) -> anyhow::Result<()> {
        set.signal(Process::Supervisor, rustix::process::Signal::KILL);
        let end = set.end_killed()?;
        note(row, end);
        Ok(())
    }
}

fn record_outcome(row: &mut Row, outcome: &Outcome) {
    let ms = |ns: Option<u64>| ns.map(|ns| ns as f64 / 1e6);
    row.safe_ms = ms(outcome.safe_ns);
    row.by = outcome.by.into();
    row.command_ms = ms(outcome.command_ns);
    row.recovered_ms = ms(outcome.recovered_ns);
}

/// Adds the end of a set to the row of its last fault.
fn note(row: &mut Row, end: End) {
    row.leftovers += end.leftovers.len() as u64;
    let words: Vec<String> = end.leftovers.into_iter().chain(end.errors).collect();
    if !words.is_empty() {
        row.verdict = format!("{}; {}", row.verdict, words.join("; "));
    }
}
