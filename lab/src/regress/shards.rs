//! Regressions in parts. A piece is an event. Each part reads all recordings, because the
//! events of a recording are known only then.

use std::path::Path;
use std::process::ExitCode;
use std::sync::Mutex;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use stack::Clock;
use supervisor::subcommand::write_json_option;

use super::{Figures, Job, Regress, Row, Terms as RecordingTerms, recordings, tell};
use crate::progress::Progress;
use crate::shard::Shard;
use crate::shard::folder::ShardWork;
use crate::shard::merge::{Merged, Partial};
use crate::shard::terms::Terms;
use crate::stop::Stop;

/// The unit of the pieces.
const UNIT: &str = "event";

/// A finished event in the file of a part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct EventResult {
    row: Row,
    /// Driven time, ns.
    driven_ns: u64,
}

impl Regress {
    /// Drives on from the events of a part that are left.
    ///
    /// # Errors
    /// If the part cannot be worked on, a recording cannot be rebuilt, or a stop is
    /// requested.
    pub(super) fn drive_shard(
        &self,
        (shard, out): (Shard, &Path),
        clock: Clock,
    ) -> anyhow::Result<()> {
        let stop = Stop::listen()?;
        let terms = self.terms(shard)?;
        let (of_recordings, jobs) = self.jobs(clock)?;
        let label = self.policy()?.display().to_string();
        let pieces = jobs.len() as u64;
        let mut work = ShardWork::open::<EventResult>(out, shard, &terms, (pieces, &label))?;
        if work.was_complete(UNIT) {
            return Ok(());
        }
        let bar = Progress::begin(
            format!("drive, shard {shard}"),
            "events",
            work.progress(),
            clock,
        )?;
        let left = work.left().clone();
        let jobs = jobs.into_iter().enumerate();
        let jobs: Vec<(u64, Job)> = jobs
            .map(|(piece, job)| (piece as u64, job))
            .filter(|(piece, _)| left.contains(piece))
            .collect();
        let kept = Mutex::new((&mut work, bar));
        let driven: anyhow::Result<()> = jobs.into_par_iter().try_for_each(|(piece, job)| {
            if stop.is_asked() {
                return Ok(());
            }
            self.drive_and_keep((piece, job), &of_recordings, &kept, clock)
        });
        if let Ok((_, bar)) = kept.into_inner() {
            bar.end();
        }
        driven?;
        work.finish(UNIT)
    }

    fn drive_and_keep(
        &self,
        (piece, job): (u64, Job),
        of_recordings: &[RecordingTerms],
        kept: &Mutex<(&mut ShardWork, Progress)>,
        clock: Clock,
    ) -> anyhow::Result<()> {
        let (row, driven_ns) = self.drive(job, of_recordings, clock)?;
        // A thread that panicked kept no half of a line.
        let mut kept = match kept.lock() {
            Ok(kept) => kept,
            Err(poisoned) => poisoned.into_inner(),
        };
        kept.0.keep(piece, &EventResult { row, driven_ns })?;
        let (done, _) = kept.0.progress();
        kept.1.at(done);
        Ok(())
    }

    fn terms(&self, shard: Shard) -> anyhow::Result<Terms> {
        let folder = self.folder()?;
        let mut terms = Terms::new("regress", shard);
        terms.add_content("--policy", self.policy()?)?;
        terms.add("--seconds", self.seconds);
        terms.add("--lead", self.lead);
        terms.add("--set", self.overrides.join(" "));
        // Recordings by name and size: the folder may have another path elsewhere.
        for recording in recordings(folder)? {
            let mut bytes = 0;
            for entry in std::fs::read_dir(&recording)? {
                let entry = entry?;
                if entry.path().extension().is_some_and(|end| end == "mcap") {
                    bytes += entry.metadata()?.len();
                }
            }
            let name = recording.strip_prefix(folder).unwrap_or(&recording);
            terms.add(&format!("recording {}", name.display()), bytes);
        }
        Ok(terms)
    }

    /// Merges the parts in the folder. Exit code 1: an event got worse, or something is
    /// missing.
    ///
    /// # Errors
    /// If the folder holds no part, or parts of different work.
    pub(super) fn report_shards(&self, out: &Path) -> anyhow::Result<ExitCode> {
        let merged = Merged::<EventResult>::read(out, "regress")?;
        let recordings = merged.header.terms.count("recording ");
        let results = merged.results.values().cloned();
        let driven = results.map(|EventResult { row, driven_ns }| (row, driven_ns));
        let figures = Figures::of(driven.collect(), recordings);
        tell(&figures);
        let Some(missing) = merged.missing() else {
            write_json_option(&self.json, &figures)?;
            return Ok(figures.exit_code());
        };
        missing.tell(&merged.header, UNIT);
        let figures = Partial { figures, missing };
        write_json_option(&self.json, &figures)?;
        Ok(ExitCode::from(1))
    }
}
