//! Trains a distilled judge from recorded questions, and measures it on others.
//!
//! [`samples`] reads the records, and a [`Split`] divides them by map; [`train`](mod@train) makes the
//! nets; [`calibrate`] gives temperature and threshold; [`Figures`] measure the result.
//! The same records and seed give the same file, bit by bit.

pub mod calibrate;
mod cost;
mod figures;
pub mod picture;
pub mod samples;
mod split;
pub mod train;

use anyhow::bail;
use gate::distilled::{About, DistilledNet, Range, assemble};

pub use cost::Cost;
pub use figures::{BINS, Figures, Point};
pub use samples::{Learn, Samples};
pub use split::{Group, Split};
pub use train::Schedule;

/// Trains, calibrates and chooses the threshold at which at most this share of the
/// questions is passed on. `passed` is called after each pass of a member
/// over the questions.
///
/// # Errors
/// If there are too few questions with an answer.
pub fn distil(
    samples: &Samples,
    split: &Split,
    (schedule, pass_on): (&Schedule, f64),
    commit: &str,
    passed: impl FnMut(usize),
) -> anyhow::Result<DistilledNet> {
    let all = &samples.samples;
    for (name, part) in [
        ("to learn from", &split.learn),
        ("to stop by", &split.stop),
        ("to calibrate with", &split.calibrate),
    ] {
        let labelled = part
            .iter()
            .filter(|index| all[**index].label(schedule.learn).is_some());
        if labelled.count() == 0 {
            bail!("no question with an answer {name}; record more episodes");
        }
    }
    let members = train::train(all, split, schedule, passed);
    let rows = split.learn.iter().flat_map(|index| {
        let sample = &all[*index];
        sample.seen.iter().chain(&sample.mirrored)
    });
    let teacher = &samples.teacher;
    let about = About {
        members: members.len(),
        temperature: calibrate::temperature(&members, all, &split.calibrate, schedule.learn),
        threshold: calibrate::ALWAYS,
        range: Range::of(rows),
        teacher: teacher.judge.clone(),
        preset: teacher.preset.clone(),
        model: teacher.model.clone(),
        learned: schedule.learn.word().into(),
        questions: split.learn.len() as u64,
        seed: schedule.seed,
        commit: commit.into(),
    };
    let mut net = assemble(train::joined(&members), about)?;
    let held_out = split.calibrate.iter().map(|index| &all[*index]);
    let opinions: Vec<_> = held_out
        .map(|sample| (sample.group, net.opinion(&sample.seen)))
        .collect();
    net.about.threshold = calibrate::threshold(&opinions, pass_on);
    Ok(net)
}
