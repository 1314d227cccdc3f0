//! `vlaps-judge audit` and `replay`.

use std::collections::{BTreeSet, HashSet};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use clap::Args;
use gate::model::Asker;
use gate::record::store::{Records, read};
use gate::record::{Record, Said};
use indicatif::{ProgressBar, ProgressStyle};
use judge::audit::{Figures, page};
use judge::replay::{Comparison, Replay, Step};
use judge::statistics::Share;
use shm_config::judged::of_these_similar;
use shm_config::text::printable_json;
use shm_config::{counted, secret};

use crate::configuration::config;
use crate::print::say;

/// Maximum size of the pictures copied beside a page, bytes: twice the default limit of
/// a run's pictures (vlm.record_bytes_max).
const COPIED_BYTES_MAX: u64 = 1_000_000_000;

/// Write a page with the questions and answers of a run, and their accuracy.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ./vlaps judge audit runs/default\n  \
    ./vlaps judge audit runs/default --out judge.html --pictures 500")]
pub struct AuditArguments {
    /// Folder of a run, or of its records
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// Output page; default: audit.html in the folder of the records
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Number of pictures embedded into the page, those of wrong answers first; the
    /// others are linked, and copied beside the page if it is elsewhere than the records
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub pictures: usize,
    /// Also write the figures to this file
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Ask another model the questions of a run, with the same pictures and words.
#[derive(Debug, Args)]
#[command(
    after_help = "Section [vlm] of the configuration names the model. The answers go to a folder of \
        their own, which can be audited like a run. Questions that have an answer there are not asked \
        again, so that the same command continues an interrupted replay.\n\n\
        Example:\n  \
        ./vlaps judge replay runs/default --set vlm.model=qwen2.5vl:7b \
        --set vlm.server=http://127.0.0.1:11434/v1"
)]
pub struct ReplayArguments {
    /// Folder of a run, or of its records
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// Folder for the answers; default: replay-MODEL in the folder of the records
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Configuration file; default: vlaps.toml of the current folder if it exists
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Override a key of the configuration, such as vlm.model=NAME; repeatable
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
}

/// Writes the page and prints the main figures.
///
/// # Errors
/// If there is no record, or the page cannot be written.
pub fn audit(arguments: &AuditArguments) -> anyhow::Result<()> {
    let records = read(&arguments.folder)?;
    let out = match &arguments.out {
        Some(out) => out.clone(),
        None => records.folder.join("audit.html"),
    };
    let link = link(&out, &records.folder);
    let page = page(&records, arguments.pictures, &link);
    let pictures = home(&out).join(&link);
    if pictures != absolute(&records.folder) {
        copy(&page.linked, &records.folder, &pictures)?;
    }
    std::fs::write(&out, page.html).with_context(|| format!("cannot write {}", out.display()))?;
    let figures = Figures::of(&records.questions);
    print_figures(&records, &figures);
    if let Some(path) = &arguments.json {
        let text = serde_json::to_string_pretty(&figures)?;
        let text = printable_json(&text);
        std::fs::write(path, text.as_bytes())
            .with_context(|| format!("--json {}", path.display()))?;
    }
    say(out.display());
    Ok(())
}

/// Path from a page to the pictures that it links: the folder of records if that lies
/// below the page's folder, otherwise a new folder beside the page, so that both can be
/// moved together.
fn link(page: &Path, folder: &Path) -> PathBuf {
    let folder = absolute(folder);
    if let Ok(below) = folder.strip_prefix(home(page)) {
        return below.into();
    }
    let mut own = page.file_stem().unwrap_or_default().to_os_string();
    own.push("-files");
    own.into()
}

/// The folder of a page.
fn home(page: &Path) -> PathBuf {
    let page = absolute(page);
    page.parent().map_or(page.clone(), Path::to_path_buf)
}

fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.into())
}

/// Copies pictures of the records to the folder that the page links.
fn copy(names: &BTreeSet<String>, from: &Path, to: &Path) -> anyhow::Result<()> {
    let sizes = names.iter().map(|name| std::fs::metadata(from.join(name)));
    let bytes: u64 = sizes.flatten().map(|size| size.len()).sum();
    if bytes > COPIED_BYTES_MAX {
        bail!(
            "{} of {} MB would be copied beside the page; write the page into {} or above, or raise \
             --pictures",
            counted(names.len() as u64, "picture"),
            bytes / 1_000_000,
            from.display()
        );
    }
    for name in names {
        let path = to.join(name);
        let folder = path.parent().unwrap_or(to);
        std::fs::create_dir_all(folder)
            .and_then(|()| std::fs::copy(from.join(name), &path))
            .with_context(|| format!("cannot copy a picture to {}", path.display()))?;
    }
    Ok(())
}

fn print_figures(records: &Records, figures: &Figures) {
    let Figures {
        questions,
        expert,
        policy,
        similar,
        abstained,
        failed,
        ..
    } = figures;
    let folder = records.folder.display();
    say(format_args!(
        "{folder}: {}: expert {expert}, policy {policy}{}, abstained {abstained}, failed {failed}",
        counted(*questions as u64, "question"),
        of_these_similar(*similar as u64)
    ));
    let faults = figures.faults.iter();
    let faults: Vec<_> = faults
        .map(|(word, count)| format!("{count} {word}"))
        .collect();
    if !faults.is_empty() {
        say(format_args!("  no answer: {}", faults.join(", ")));
    }
    if records.is_torn {
        say("the last line is incomplete and left out: the run was killed while writing it");
    }
    let agreement = &figures.agreement;
    say(format_args!(
        "the simulator can check {}: similar {}, abstained {}, failed {}; right preferences: \
         {}",
        counted(agreement.of_all().trials as u64, "question"),
        agreement.said(Said::Similar),
        agreement.said(Said::Abstained),
        agreement.said(Said::Failed),
        share(agreement.of_preferences())
    ));
    say(format_args!(
        "first place preferred: {}; cost {:.4} USD",
        share(figures.first_place),
        figures.cost_usd
    ));
}

/// A share with its confidence interval, for printing.
fn share(share: Share) -> String {
    let [low, high] = share.interval().map(|end| 100.0 * end);
    match share.trials {
        0 => "none".into(),
        trials => format!(
            "{} of {trials}, {:.1} % ({low:.1} to {high:.1})",
            share.hits,
            100.0 * share.mean()
        ),
    }
}

/// Asks all questions again and compares both judges.
///
/// # Errors
/// If there is no record, the configuration is invalid, the model cannot be asked, or the
/// folder cannot be written.
pub fn replay(arguments: &ReplayArguments) -> anyhow::Result<()> {
    let records = read(&arguments.folder)?;
    let vlm = config(arguments.config.as_deref(), &arguments.overrides)?.vlm;
    // The API key that is read after this line is never written to a core file.
    secret::forbid_dumps().context("cannot keep the key out of core files")?;
    secret::take_named(&vlm.key_env).context("cannot take the key out of the environment")?;
    let out = match &arguments.out {
        Some(out) => out.clone(),
        None => records
            .folder
            .join(format!("replay-{}", file_word(vlm.model_name()))),
    };
    let mut replay = Replay::new(&vlm, Asker::new(&vlm)?, &out)?;
    ask_all(&mut replay, &records, &out)?;
    let lost = replay.lost();
    if lost.lines + lost.pictures > 0 {
        let (lines, pictures) = (lost.lines, lost.pictures);
        say(format_args!(
            "lost {}, {}: {}",
            counted(lines, "line"),
            counted(pictures, "picture"),
            lost.reason
        ));
    }
    drop(replay);
    let mut now = read(&out)?;
    keep_last(&mut now.questions);
    compare(&records, &now);
    match now
        .questions
        .iter()
        .all(|record| record.preference.is_none())
    {
        true => bail!("nothing was answered; the same command asks again"),
        false => Ok(()),
    }
}

/// Asks every question whose pictures exist and that has no answer yet.
fn ask_all(replay: &mut Replay, records: &Records, out: &Path) -> anyhow::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    let bar = ProgressBar::new(records.questions.len() as u64);
    let style = "{elapsed_precise} {wide_bar} {pos}/{len} questions, {eta} left, {msg}";
    bar.set_style(ProgressStyle::with_template(style)?);
    let (mut gone, mut before) = (0, 0);
    for record in &records.questions {
        match runtime.block_on(replay.ask(records, record)) {
            Step::Asked => {}
            Step::Before => before += 1,
            Step::Gone => gone += 1,
            Step::Closed(fault) => {
                bar.finish_and_clear();
                bail!(
                    "{}: {}; the answers so far are in {}; the same command continues",
                    fault.word(),
                    fault.advice(),
                    out.display()
                );
            }
        }
        bar.set_message(format!("{:.4} USD", replay.spent_usd()));
        bar.inc(1);
    }
    bar.finish_and_clear();
    if before > 0 {
        say(format_args!(
            "answered before and not asked again: {before}, in {}",
            out.display()
        ));
    }
    if gone > 0 {
        let questions = counted(gone, "question");
        say(format_args!(
            "not asked, because their pictures are missing: {questions}"
        ));
    }
    Ok(())
}

/// A question that failed and was asked again has two records: keeps the last one.
fn keep_last(records: &mut Vec<Record>) {
    let mut seen = HashSet::new();
    records.reverse();
    records.retain(|record| seen.insert((record.episode, record.tick)));
    records.reverse();
}

fn compare(before: &Records, now: &Records) {
    let comparison = Comparison::of(before, now);
    say("\nrows: before; columns: now       expert   policy  abstain   failed");
    for (name, row) in ["expert", "policy", "abstain", "failed"]
        .iter()
        .zip(comparison.counts)
    {
        let [a, b, c, d] = row;
        say(format_args!("{name:>30} {a:>8} {b:>8} {c:>8} {d:>8}"));
    }
    let kappa = comparison.kappa();
    let kappa = kappa.map_or("-".into(), |kappa| format!("{kappa:.2}"));
    say(format_args!(
        "Cohen's kappa of what both answered: {kappa}\n"
    ));
    for records in [before, now] {
        print_figures(records, &Figures::of(&records.questions));
    }
}

/// A name with all characters replaced that cannot be part of a file name.
fn file_word(name: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || ".-_".contains(c);
    name.chars()
        .map(|c| if is_plain(c) { c } else { '-' })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_never_lead_out_of_the_pages_folder() {
        let link = |page: &str, folder: &str| link(Path::new(page), Path::new(folder));
        let judge = "/runs/a/judge";
        assert_eq!(link("/runs/a/judge/audit.html", judge), Path::new(""));
        assert_eq!(link("/runs/page.html", judge), Path::new("a/judge"));
        assert_eq!(link("/tmp/page.html", judge), Path::new("page-files"));
        assert_eq!(link("runs/page.html", "runs/a"), Path::new("a"));
    }
}
