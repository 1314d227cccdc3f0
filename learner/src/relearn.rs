//! Learns a policy anew from all that sessions recorded.
//!
//! While a car drives, the replay grows: the first transitions are learnt from many times, and
//! the last ones hardly at all, at a rate that has fallen. A policy that is trained from scratch
//! on the whole replay sees all of them equally often, as DAgger has it (Ross, Gordon and
//! Bagnell, 2011).

use std::io;
use std::path::PathBuf;

use policy::{Provenance, Refusal};
use rand_xoshiro::Xoshiro256PlusPlus;
use shm_config::config::Config;

use crate::algorithm::{Losses, Student};
use crate::replay::Replay;
use crate::{export, journal, metrics, session};

/// A policy in training, and the replay of sessions, whose files are only read.
pub struct Relearning {
    student: Student,
    random: Xoshiro256PlusPlus,
    replay: Replay,
    provenance: Provenance,
    threads: usize,
}

impl Relearning {
    /// A new policy of the configured algorithm and sizes, and the replays in the folders of
    /// these sessions, together as much as `learner.capacity` holds: the last ones. `commit` names
    /// the build in the policy file.
    ///
    /// # Errors
    /// When there is no replay, one cannot be read or is damaged, they hold nothing that the
    /// algorithm learns from, or the policy file would be too large.
    pub fn open(config: &Config, folders: &[PathBuf], commit: String) -> io::Result<Relearning> {
        let mut replay = Replay::new(config.learner.capacity as usize);
        replay.set_inputs(session::inputs(config));
        let mut steps = 0;
        for folder in folders {
            let path = folder.join("replay.bin");
            // Before the replay: a session that drives on writes its row after what it learnt from.
            let rows = folder.join("blocks.csv");
            let learnt = metrics::read(&rows).map_or(0, |counts| counts.transitions());
            let mark = journal::read(&path, &mut replay, learnt)
                .map_err(|error| session::named(error, &path))?;
            steps += mark.map_or(0, |mark| mark.counts.driven());
        }
        let state = session::begin(config);
        export::check_size(state.student.policy())?;
        let mut buffers = state.student.buffers().iter();
        if buffers.all(|buffer| replay.len(*buffer) == 0) {
            let files = match folders {
                [folder] => folder.join("replay.bin").display().to_string(),
                folders => format!("replay.bin of {} trainings", folders.len()),
            };
            let what = format!("{files}: nothing that {} learns from", state.algorithm);
            return Err(io::Error::new(io::ErrorKind::InvalidData, what));
        }
        Ok(Relearning {
            provenance: Provenance {
                algorithm: state.algorithm,
                seed: config.learner.seed,
                steps,
                commit,
            },
            student: state.student,
            random: state.random,
            replay,
            threads: session::all_threads(),
        })
    }

    /// Number of transitions that it learns from.
    pub fn transitions(&self) -> usize {
        let buffers = self.student.buffers().iter();
        buffers.map(|buffer| self.replay.len(*buffer)).sum()
    }

    /// Number of transitions that were read and had no room: the first ones.
    pub fn left_out(&self) -> u64 {
        let buffers = self.student.buffers().iter();
        buffers.map(|buffer| self.replay.replaced(*buffer)).sum()
    }

    /// One update.
    pub fn update(&mut self) -> Losses {
        self.student
            .update(&self.replay, &mut self.random, self.threads)
    }

    /// The present policy as a file.
    ///
    /// # Errors
    /// When its numbers are not finite.
    pub fn policy_file(&self) -> Result<Vec<u8>, Refusal> {
        export::with_probes(self.student.policy(), &self.provenance, &self.replay)
    }
}
