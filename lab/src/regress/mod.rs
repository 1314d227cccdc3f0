//! `./vlaps regress`: the events of many recordings, driven again by another policy.

pub mod events;
mod shards;

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;

use anyhow::{Context, bail};
use clap::Args;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shm_config::config::Config;
use shm_config::counted;
use shm_config::message::{Episode, Outcome};
use stack::Clock;
use supervisor::subcommand::{Output, Subcommand, say, seconds, write_json_option};

use crate::fork::course::{Course, Until};
use crate::fork::drive::{Drive, Start, Wheel};
use crate::fork::start::starts;
use crate::fork::{cannot, changed_in_loop, read_policy};
use crate::progress::Progress;
use crate::replay::rebuild::Mover;
use crate::replay::recorded::Recorded;
use crate::replay::source::Source;
use crate::replay::worlds::is_built_in;
use crate::report::table;
use crate::shard::{Shard, needs_shard};
use events::{End, Event, Kind, Trace, events};

/// Drive on from every veto, takeover, contact and late tick of many recordings.
#[derive(Debug, Args)]
#[command(
    after_help = "Each recording of the folder is rebuilt; a little before each event the stack \
        drives on with the policy, and what becomes of the car is compared with what became of \
        it in the recording. Vetoes, takeovers, contacts and late ticks that follow each other \
        within a second are one event. An event got worse when the car now touches something \
        or leaves the road and did not before, or no longer arrives.\n\n\
        --shard I/N drives on from the I-th of N parts of the events, on any machine; the same \
        command continues after Ctrl-C or a kill. --report merges the parts in --out and says which \
        are missing.\n\n\
        Exit code: 0, no event got worse; 1, one did, or parts are missing; 2, a recording cannot \
        be rebuilt.\n\n\
        Examples:\n  \
        ./vlaps regress runs --policy policy.onnx\n  \
        ./vlaps regress incidents --policy policy.onnx --seconds 10 --lead 2 --json regress.json\n  \
        ./vlaps regress incidents --policy policy.onnx --shard 3/8 --out runs/regress\n  \
        ./vlaps regress --out runs/regress --report"
)]
pub struct Regress {
    /// A folder with recordings: MCAP files of one run, or folders with them.
    #[arg(value_name = "FOLDER", required_unless_present = "report")]
    pub folder: Option<PathBuf>,
    /// The policy.
    #[arg(long, value_name = "FILE", required_unless_present = "report")]
    pub policy: Option<PathBuf>,
    /// Look at so long after the fork, s.
    #[arg(long, value_name = "S", default_value = "10", value_parser = seconds)]
    pub seconds: f64,
    /// Fork so long before the event, s.
    #[arg(long, value_name = "S", default_value = "2", value_parser = seconds)]
    pub lead: f64,
    /// With another setting, such as gate.mode=rules; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Drive on from part I of N of the events, such as 3/8, and keep them in --out.
    #[arg(long, value_name = "I/N", requires = "out", conflicts_with = "json")]
    pub shard: Option<Shard>,
    /// Folder of the parts; it may be shared by machines, or be copied together.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Do not drive: merge the parts in --out and print the figures.
    #[arg(long, requires = "out", conflicts_with_all = ["shard", "folder", "policy", "seconds",
          "lead", "overrides"])]
    pub report: bool,
    /// Write the figures to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// One event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The recording.
    pub recording: String,
    /// The episode's seed.
    pub seed: u64,
    /// The tick of the event.
    pub tick: u64,
    /// The tick from which it was driven on.
    pub forked: u64,
    /// What happened.
    pub event: Kind,
    /// What became of the car in the recording.
    pub recorded: End,
    /// What becomes of it with the policy.
    pub new: End,
    /// Whether that is worse.
    pub worse: bool,
}

/// The figures.
#[derive(Debug, Serialize)]
struct Figures {
    rows: Vec<Row>,
    worse: usize,
    better: usize,
    recordings: usize,
    /// Time that was driven, s.
    driven_s: f64,
    /// How long all of it took, s; `None` of merged parts, which have no clock in common.
    elapsed_s: Option<f64>,
    /// Forks in a minute, without the reading of the recordings; `None` of merged parts.
    forks_per_minute: Option<f64>,
}

impl Figures {
    /// Of the rows with the time that each drove, ns.
    fn of(driven: Vec<(Row, u64)>, recordings: usize) -> Figures {
        let driven_s = driven
            .iter()
            .map(|(_, driven_ns)| *driven_ns as f64 * 1e-9)
            .sum();
        let rows: Vec<Row> = driven.into_iter().map(|(row, _)| row).collect();
        Figures {
            worse: rows.iter().filter(|row| row.worse).count(),
            better: rows.iter().filter(|row| row.new < row.recorded).count(),
            recordings,
            driven_s,
            elapsed_s: None,
            forks_per_minute: None,
            rows,
        }
    }

    fn exit_code(&self) -> ExitCode {
        match self.worse {
            0 => ExitCode::SUCCESS,
            _ => ExitCode::from(1),
        }
    }
}

/// An event that is to be driven on.
struct Job {
    recording: String,
    start: Start,
    event: Kind,
    tick: u64,
    recorded: End,
    of: usize,
}

/// What is the same for all events of a recording.
struct Terms {
    config: Config,
    mover: Mover,
}

impl Subcommand for Regress {
    fn outputs(&self) -> Vec<Output> {
        vec![
            Output::Folder("--out", self.shard.and(self.out.clone())),
            Output::json(&self.json),
        ]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        match (&self.out, self.report, self.shard) {
            (Some(out), true, _) => return self.report_shards(out),
            (Some(out), false, Some(shard)) => {
                self.drive_shard((shard, out), clock).map_err(cannot)?;
                return Ok(ExitCode::SUCCESS);
            }
            (Some(_), false, None) => {
                return Err(needs_shard());
            }
            (None, _, _) => {}
        }
        let figures = self.figures(clock).map_err(cannot)?;
        tell(&figures);
        write_json_option(&self.json, &figures)?;
        Ok(figures.exit_code())
    }
}

impl Regress {
    fn figures(&self, clock: Clock) -> anyhow::Result<Figures> {
        let begun = clock();
        let (terms, jobs) = self.jobs(clock)?;
        let bar = Progress::begin("drive".into(), "events", (0, jobs.len() as u64), clock)?;
        let bar = Mutex::new((bar, 0));
        let forking = clock();
        let driven: anyhow::Result<Vec<(Row, u64)>> = jobs
            .into_par_iter()
            .map(|job| {
                let row = self.drive(job, &terms, clock);
                step(&bar);
                row
            })
            .collect();
        end(bar);
        let driven = driven?;
        let minutes = clock().since_ns(forking) as f64 * 1e-9 / 60.0;
        Ok(Figures {
            elapsed_s: Some(clock().since_ns(begun) as f64 * 1e-9),
            forks_per_minute: Some(driven.len() as f64 / minutes.max(1e-9)),
            ..Figures::of(driven, terms.len())
        })
    }

    /// The events of all recordings, in their order.
    fn jobs(&self, clock: Clock) -> anyhow::Result<(Vec<Terms>, Vec<Job>)> {
        let recordings = recordings(self.folder()?)?;
        let total = recordings.len() as u64;
        let bar = Progress::begin("read".into(), "recordings", (0, total), clock)?;
        let bar = Mutex::new((bar, 0));
        let read: anyhow::Result<Vec<_>> = recordings
            .par_iter()
            .enumerate()
            .map(|(of, path)| {
                let read = self
                    .read(of, path)
                    .with_context(|| path.display().to_string());
                step(&bar);
                read
            })
            .collect();
        end(bar);
        let (terms, jobs): (Vec<Terms>, Vec<Vec<Job>>) = read?.into_iter().unzip();
        Ok((terms, jobs.into_iter().flatten().collect()))
    }

    /// The folder of the recordings; the command line has it but for a report.
    fn folder(&self) -> anyhow::Result<&Path> {
        self.folder.as_deref().context("FOLDER is missing")
    }

    fn policy(&self) -> anyhow::Result<&Path> {
        self.policy.as_deref().context("--policy is missing")
    }

    /// The events of a recording, each with the state from which it is driven on.
    fn read(&self, of: usize, path: &Path) -> anyhow::Result<(Terms, Vec<Job>)> {
        let mut recorded = Recorded::open(path)?;
        if !is_built_in(recorded.config()) {
            bail!("the recorded world is not the built-in one, and cannot be rebuilt");
        }
        let config = changed_in_loop(&recorded, None, &self.overrides, true)?;
        let course = Course::read(&mut recorded, 0, Until::End)?;
        let mover = Mover::new(&course.config);
        let mut jobs = Vec::new();
        let mut first = course.at;
        while first < course.messages.observations.all.len() {
            let end = course.end_of_episode(first);
            self.episode((of, path), &course, &mover, (first, end), &mut jobs)?;
            first = end;
        }
        Ok((Terms { config, mover }, jobs))
    }

    /// The events of one episode.
    fn episode(
        &self,
        (of, path): (usize, &Path),
        course: &Course,
        mover: &Mover,
        (first, end): (usize, usize),
        jobs: &mut Vec<Job>,
    ) -> anyhow::Result<()> {
        let all = &course.messages.observations.all;
        let mut trace = Trace::default();
        course.rebuild(mover, (first, end - 1), |_, rebuilt| trace.push(rebuilt))?;
        let found = events(course, (first, end), &trace);
        if found.is_empty() {
            return Ok(());
        }
        let lead_ns = (self.lead * 1e9) as u64;
        let forks: Vec<(Event, usize)> = (found.into_iter())
            .map(|event| {
                let at_ns = all[event.index].header.taken_ns.saturating_sub(lead_ns);
                let before = all[first..end].partition_point(|o| o.header.taken_ns < at_ns);
                // The first observation of a tick: those between two ticks have no answer.
                let mut index = (first + before).min(event.index);
                while index > first && all[index - 1].header.tick == all[index].header.tick {
                    index -= 1;
                }
                (event, index)
            })
            .collect();
        let at: BTreeSet<usize> = forks.iter().map(|(_, index)| *index).collect();
        let starts = starts(course, mover, &at)?;
        for (event, index) in forks {
            if let Some(start) = starts.get(&index) {
                jobs.push(Job {
                    recording: path.display().to_string(),
                    start: start.clone(),
                    event: event.kind,
                    tick: all[event.index].header.tick,
                    recorded: self.recorded(course, (first, end), index, &trace),
                    of,
                });
            }
        }
        Ok(())
    }

    /// What became of the car after an observation of the recording.
    fn recorded(
        &self,
        course: &Course,
        (first, end): (usize, usize),
        index: usize,
        trace: &Trace,
    ) -> End {
        let all = &course.messages.observations.all;
        let until_ns = all[index].header.taken_ns;
        let until_ns = until_ns.saturating_add((self.seconds * 1e9) as u64);
        let after = all[first..end].partition_point(|o| o.header.taken_ns <= until_ns);
        // In a damaged recording time may go back.
        let last = (first + after).saturating_sub(1).max(index);
        let header = &all[first].header;
        let ended = course.messages.episodes.all.iter().find(|episode| {
            (episode.header.producer, episode.header.episode) == (header.producer, header.episode)
                && episode.header.taken_ns <= until_ns
        });
        let touched = trace.contacts[last - first] - trace.contacts[index - first];
        let at_last = ended.map_or(0, |episode| {
            episode
                .contacts()
                .saturating_sub(trace.contacts[last - first])
        });
        let outcome = ended.map_or(Outcome::Driving, Episode::outcome);
        End::of(outcome, touched + at_last)
    }

    fn drive(&self, job: Job, terms: &[Terms], clock: Clock) -> anyhow::Result<(Row, u64)> {
        let Terms { config, mover } = &terms[job.of];
        let seed = job.start.rebuilt.world.seed();
        let forked = job.start.observation.header.tick;
        let policy = read_policy(self.policy()?, config, clock)?;
        let drive = Drive {
            config,
            mover,
            seconds: self.seconds,
            clock,
        };
        let driven = drive.run(job.start, Wheel::Stack(Some(policy)))?;
        let new = End::of(driven.episode.outcome(), driven.contacts);
        let row = Row {
            recording: job.recording,
            seed,
            tick: job.tick,
            forked,
            event: job.event,
            recorded: job.recorded,
            new,
            worse: new > job.recorded,
        };
        Ok((row, driven.ticks * config.run.period_ns()))
    }
}

/// The recordings in a folder: itself, when it has MCAP files, else the folders within it
/// that have some, at most two levels down.
fn recordings(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    let mut level = vec![folder.to_path_buf()];
    for _ in 0..=2 {
        let mut below = Vec::new();
        for folder in level {
            let read = fs::read_dir(&folder).with_context(|| folder.display().to_string())?;
            let paths: Vec<PathBuf> = read.flatten().map(|entry| entry.path()).collect();
            let is_recorded = |path: &PathBuf| path.extension().is_some_and(|e| e == "mcap");
            match paths.iter().any(is_recorded) {
                true => found.push(folder),
                false => below.extend(paths.into_iter().filter(|path| path.is_dir())),
            }
        }
        level = below;
    }
    found.sort();
    match found.is_empty() {
        true => bail!(
            "{}: no recording in it; ./vlaps up --record makes one",
            folder.display()
        ),
        false => Ok(found),
    }
}

/// A bar that several threads move, and how far it is.
type Shared = Mutex<(Progress, u64)>;

fn step(bar: &Shared) {
    if let Ok(mut bar) = bar.lock() {
        bar.1 += 1;
        let done = bar.1;
        bar.0.at(done);
    }
}

fn end(bar: Shared) {
    if let Ok((bar, _)) = bar.into_inner() {
        bar.end();
    }
}

fn tell(figures: &Figures) {
    let mut rows = table(&["recording", "seed", "tick", "event", "recorded", "now", ""]);
    for row in &figures.rows {
        rows.add_row([
            row.recording.clone(),
            row.seed.to_string(),
            row.tick.to_string(),
            row.event.word().to_string(),
            row.recorded.word().to_string(),
            row.new.word().to_string(),
            if row.worse { "worse" } else { "" }.to_string(),
        ]);
    }
    say(rows);
    let rate = match (figures.elapsed_s, figures.forks_per_minute) {
        (Some(elapsed_s), Some(rate)) => format!(" in {elapsed_s:.1} s, {rate:.0} forks a minute"),
        (_, _) => String::new(),
    };
    say(format_args!(
        "{} of {}: {} worse, {} better; {:.0} s driven{rate}",
        counted(figures.rows.len() as u64, "event"),
        counted(figures.recordings as u64, "recording"),
        figures.worse,
        figures.better,
        figures.driven_s,
    ));
}
