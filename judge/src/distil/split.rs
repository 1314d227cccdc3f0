//! The parts of the questions: to learn from, to stop by, and to calibrate with.

use anyhow::bail;
use shm_config::draw::Draw;

use super::samples::Sample;

/// Questions that resemble each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Group {
    /// Those on the map of this seed; several runs may have driven it.
    Map(u64),
    /// Those of an episode of a run without a configuration, whose map is unknown.
    Episode {
        /// The run's number among those that are read.
        run: usize,
        /// The run's episode.
        episode: u32,
    },
}

/// The parts of the questions.
#[derive(Debug, Clone, Default)]
pub struct Split {
    /// Indices that the nets learn from.
    pub learn: Vec<usize>,
    /// Indices by which the training ends in time.
    pub stop: Vec<usize>,
    /// Indices for temperature and threshold.
    pub calibrate: Vec<usize>,
}

impl Split {
    /// 70, 10 and 20 of 100 groups, drawn with this seed; all questions of a group are in
    /// the same part.
    ///
    /// # Errors
    /// If there are too few groups for three parts.
    pub fn of(samples: &[Sample], seed: u64) -> anyhow::Result<Self> {
        let mut groups: Vec<Group> = samples.iter().map(|sample| sample.group).collect();
        groups.sort_unstable();
        groups.dedup();
        let count = groups.len();
        if count < 10 {
            bail!(
                "{count} episodes are too few to learn from some and to check with others; record at \
                 least 10, better 100"
            );
        }
        let mut draw = Draw::new(seed ^ 0x0073_706c_6974);
        for at in (1..count).rev() {
            groups.swap(at, draw.below(at as u64 + 1) as usize);
        }
        let (stop, rest) = groups.split_at(count / 10);
        let (calibrate, _) = rest.split_at(count / 5);
        let mut split = Self::default();
        for (index, sample) in samples.iter().enumerate() {
            let part = match &sample.group {
                group if stop.contains(group) => &mut split.stop,
                group if calibrate.contains(group) => &mut split.calibrate,
                _ => &mut split.learn,
            };
            part.push(index);
        }
        Ok(split)
    }
}
