//! One row for each block, as CSV.

use std::fs;
use std::io::{self, BufRead, BufReader};
use std::path::Path;

use serde::{Deserialize, Serialize};
use shm_config::file::{Access, Durable, open_ours, replace};

use crate::assembler::Counts;

/// The figures at the end of a block. Losses are means over its updates; all other
/// figures count from the start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Steps driven.
    pub steps: u64,
    /// Updates made.
    pub updates: u64,
    /// Counts of steps and transitions.
    pub counts: Counts,
    /// Answers of the expert that were learnt from.
    pub expert_queries: u64,
    /// Transitions in the buffer of steps that prefer the expert.
    pub expert_ring: u64,
    /// Transitions in the buffer of all other steps.
    pub learner_ring: u64,
    /// Predicted states.
    pub predicted_ring: u64,
    /// Mean loss of the actor.
    pub actor_loss: f32,
    /// Mean loss of the imitation.
    pub imitation_loss: f32,
    /// Mean loss of the critics.
    pub critic_loss: f32,
}

/// A row as it is written to the file.
#[derive(Serialize, Deserialize)]
struct Line {
    steps: u64,
    updates: u64,
    lost: u64,
    interventions: u64,
    labels_expert: u64,
    labels_policy: u64,
    unlabelled: u64,
    cut: u64,
    unseen: u64,
    imagined: u64,
    expert_queries: u64,
    expert_ring: u64,
    learner_ring: u64,
    predicted_ring: u64,
    actor_loss: f32,
    imitation_loss: f32,
    critic_loss: f32,
}

/// The counts of a file's last row; zeros if no row can be read. The file is only read, and a
/// learner may be using it.
///
/// # Errors
/// When the file cannot be read.
pub fn read(path: &Path) -> io::Result<Counts> {
    Ok(last_counts(&fs::read(path)?))
}

fn last_counts(text: &[u8]) -> Counts {
    let lines = csv::Reader::from_reader(text).into_deserialize::<Line>();
    let last = lines.filter_map(Result::ok).last();
    last.map_or(Counts::default(), |line| Counts {
        steps: line.steps.saturating_sub(line.lost),
        lost: line.lost,
        unseen: line.unseen,
        cut: line.cut,
        expert: line.labels_expert,
        policy: line.labels_policy,
        unlabelled: line.unlabelled,
        interventions: line.interventions,
        imagined: line.imagined,
    })
}

/// The file, opened for appending.
pub struct Metrics {
    writer: csv::Writer<fs::File>,
    counts: Counts,
}

impl Metrics {
    /// Opens the file and keeps this many rows; further rows are of blocks that were
    /// never finished.
    ///
    /// # Errors
    /// When the file cannot be read or written.
    pub fn open(path: &Path, rows: u64) -> io::Result<Metrics> {
        let mut kept = Vec::new();
        if let Ok(file) = open_ours(path, Access::Read) {
            let lines = BufReader::new(file).lines();
            // The header precedes the rows.
            for line in lines.take(rows as usize + usize::from(rows > 0)) {
                kept.extend_from_slice(line?.as_bytes());
                kept.push(b'\n');
            }
        }
        replace(path, &kept, Durable::Yes)?;
        let counts = last_counts(&kept);
        let file = open_ours(path, Access::Append)?;
        let writer = csv::WriterBuilder::new()
            .has_headers(kept.is_empty())
            .from_writer(file);
        Ok(Metrics { writer, counts })
    }

    /// The counts of the last row that was in the file; zeros if no row can be read.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Writes a row.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&mut self, row: &Row) -> io::Result<()> {
        let counts = &row.counts;
        self.writer.serialize(Line {
            steps: row.steps,
            updates: row.updates,
            lost: counts.lost,
            interventions: counts.interventions,
            labels_expert: counts.expert,
            labels_policy: counts.policy,
            unlabelled: counts.unlabelled,
            cut: counts.cut,
            unseen: counts.unseen,
            imagined: counts.imagined,
            expert_queries: row.expert_queries,
            expert_ring: row.expert_ring,
            learner_ring: row.learner_ring,
            predicted_ring: row.predicted_ring,
            actor_loss: row.actor_loss,
            imitation_loss: row.imitation_loss,
            critic_loss: row.critic_loss,
        })?;
        self.writer.flush()
    }
}
