//! `train --report`: draws and prints the results in a folder.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use lab::shard::Shard;
use lab::shard::folder::ShardWork;
use lab::shard::terms::Terms;
use lab::train::experiment::Experiment;
use lab::train::shards::TrainingResult;
use tempfile::TempDir;

/// Writes a training with `blocks` blocks and growing success; steps are lost from the
/// second block on.
fn seed(out: &Path, number: u64, blocks: u64, lost: u64) {
    let folder = out.join(format!("seed-{number}"));
    fs::create_dir_all(folder.join("learner")).expect("a folder");
    let mut evaluations = String::from(
        "steps,success,strict_success,contact,crash_last_step,out_of_road,max_step,completion,\
         mean_length,mean_speed_mps\n",
    );
    let mut rows = String::from(
        "steps,updates,lost,interventions,labels_expert,labels_policy,expert_queries,actor_loss,\
         imitation_loss,critic_loss\n",
    );
    for block in 1..=blocks {
        let (steps, success) = (200 * block, block as f64 / blocks as f64);
        let lost = if block > 1 { lost } else { 0 };
        writeln!(
            evaluations,
            "{steps},{success},{success},0.0,0.5,0.0,0.1,{success},700.0,4.5"
        )
        .expect("text");
        let (others, labels, queries) = (50 * block, 20 * block, 620 * block);
        writeln!(
            rows,
            "{steps},{steps},{lost},{others},{labels},{labels},{queries},0.1,0.1,0.0"
        )
        .expect("text");
    }
    fs::write(folder.join("evaluations.csv"), evaluations).expect("written");
    fs::write(folder.join("learner/blocks.csv"), rows).expect("written");
    fs::write(
        folder.join("train.toml"),
        "[learner]\nalgorithm = \"ppl\"\n",
    )
    .expect("written");
    let policies = folder.join("learner/policies");
    fs::create_dir_all(&policies).expect("a folder");
    for block in 1..=blocks {
        fs::write(policies.join(format!("{:08}.onnx", 200 * block)), b"net").expect("written");
    }
}

fn train(out: &Path, words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vlaps-lab"))
        .args(["train", "--out"])
        .arg(out)
        .args(words)
        .output()
        .expect("the program starts")
}

fn report(out: &Path) -> Output {
    train(out, &["--report"])
}

#[test]
fn a_folder_of_an_earlier_version_is_reported_without_the_counts_it_lacks() {
    let out = TempDir::new().expect("a folder");
    seed(out.path(), 0, 2, 0);
    let blocks = out.path().join("seed-0/learner/blocks.csv");
    let text = fs::read_to_string(&blocks).expect("the blocks");
    // Column 7 is expert_queries.
    let older = text.lines().map(|line| {
        let mut columns: Vec<&str> = line.split(',').collect();
        columns.remove(6);
        columns.join(",") + "\n"
    });
    let older: String = older.collect();
    assert!(!older.contains("expert_queries"), "{older}");
    fs::write(&blocks, older).expect("written");
    let output = report(out.path());
    assert!(output.status.success(), "{output:?}");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(row(&said, "expert queries").contains('-'), "{said}");
    assert!(row(&said, "interventions").contains("100"), "{said}");
}

#[test]
fn a_damaged_file_makes_its_training_missing() {
    let out = TempDir::new().expect("a folder");
    let out = out.path();
    seed(out, 0, 2, 0);
    let last = r#"{"steps": 400, "episodes": 50, "success": {"mean": 1.0}}"#;
    fs::write(out.join("seed-0/final.json"), last).expect("written");
    let experiment = Experiment {
        steps: 400,
        final_episodes: 50,
        ..Experiment::default()
    };
    experiment.write(out).expect("the options");
    let shard = Shard { number: 1, of: 1 };
    let terms = Terms::new("train", shard);
    let work = ShardWork::open::<TrainingResult>(out, shard, &terms, (1, "pvp"));
    let result = TrainingResult::of(&experiment, (0, out)).expect("files");
    let kept = work.expect("a part").keep(0, &result.expect("complete"));
    kept.expect("kept");
    assert_eq!(report(out).status.code(), Some(0));
    for name in ["final.json", "evaluations.csv", "learner/blocks.csv"] {
        let file = out.join("seed-0").join(name);
        let whole = fs::read(&file).expect("the file");
        let mut no_text = whole.clone();
        let end = no_text.len() - 2;
        no_text[end] ^= 0x80;
        for damaged in [&whole[..0], &whole[..40], &whole[..end], &no_text] {
            fs::write(&file, damaged).expect("written");
            let output = report(out);
            let said = [&output.stdout[..], &output.stderr].concat();
            let said = String::from_utf8_lossy(&said).into_owned();
            assert_eq!(output.status.code(), Some(1), "{name}: {said}");
            let words = "incomplete: 1 of 1 training missing";
            assert!(said.contains(words), "{name}: {said}");
        }
        fs::remove_file(&file).expect("removed");
        assert_eq!(report(out).status.code(), Some(1), "{name}");
        fs::write(&file, whole).expect("written");
        assert_eq!(report(out).status.code(), Some(0), "{name}");
    }
}

/// All files of a folder with their contents.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let entries = fs::read_dir(folder).expect("the folder");
    let paths = entries.map(|entry| entry.expect("an entry").path());
    paths
        .flat_map(|path| match path.is_dir() {
            true => files(&path),
            false => BTreeMap::from([(path.clone(), fs::read(&path).expect("the file"))]),
        })
        .collect()
}

#[test]
fn a_folder_is_reported_with_one_name_for_each_figure() {
    let out = TempDir::new().expect("a folder");
    seed(out.path(), 0, 10, 0);
    seed(out.path(), 1, 10, 7);
    let output = report(out.path());
    assert!(output.status.success(), "{output:?}");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    for words in [
        "ours, 400 steps",
        "ours, 2000 steps",
        "crash at the last step",
        "which counts sidewalks",
        "seed 1: 7 of 2000 steps were driven while its learner was not running",
    ] {
        assert!(said.contains(words), "{words}: {said}");
    }
    let picture = fs::read_to_string(out.path().join("curves.svg")).expect("the picture");
    for words in ["ppl, 2 seeds", "strict success", "contact", "max step"] {
        assert!(picture.contains(words), "{words}");
    }
    let png = fs::read(out.path().join("curves.png")).expect("the picture");
    assert!(png.starts_with(b"\x89PNG"));
    let tags = fs::read(
        out.path()
            .join("seed-0/tensorboard/events.out.tfevents.0.vlaps"),
    );
    let tags = tags.expect("the events");
    for tag in ["eval/crash_last_step", "eval/mean_speed_mps"] {
        let found = tags.windows(tag.len()).any(|bytes| bytes == tag.as_bytes());
        assert!(found, "{tag}");
    }
    assert_eq!(
        fs::read(out.path().join("policy.onnx")).expect("the best"),
        b"net"
    );
}

#[test]
fn a_short_training_has_no_empty_column_and_an_old_final_is_not_shown() {
    let out = TempDir::new().expect("a folder");
    seed(out.path(), 0, 2, 0);
    let old = r#"{"steps": 200, "episodes": 50, "success": {"mean": 1.0}}"#;
    fs::write(out.path().join("seed-0/final.json"), old).expect("written");
    let output = report(out.path());
    assert!(output.status.success(), "{output:?}");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(said.matches("ours").count(), 1, "{said}");
    assert!(
        !said.contains("last policy") && !said.contains("1 seeds"),
        "{said}"
    );
    // Of that policy they are shown.
    fs::write(
        out.path().join("seed-0/final.json"),
        old.replace("200", "400"),
    )
    .expect("written");
    let said = String::from_utf8_lossy(&report(out.path()).stdout).into_owned();
    assert!(said.contains("last policy, 1 seed x 50 episodes"), "{said}");
}

/// The printed line of a table that begins with these words.
fn row(said: &str, name: &str) -> String {
    let line = said.lines().find(|line| line.trim().starts_with(name));
    line.unwrap_or_else(|| panic!("{name}: {said}")).into()
}

#[test]
fn an_interval_stays_within_the_range_of_its_figure() {
    let out = TempDir::new().expect("a folder");
    for (number, blocks) in [(0, 10), (1, 2), (2, 5)] {
        seed(out.path(), number, blocks, 0);
        // Success after the first block: 0.1, 0.5 and 0.2.
        let path = out.path().join(format!("seed-{number}/evaluations.csv"));
        let text = fs::read_to_string(&path).expect("the file");
        let first: Vec<&str> = text.lines().take(2).collect();
        fs::write(&path, first.join("\n") + "\n").expect("written");
        let said = String::from_utf8_lossy(&report(out.path()).stdout).into_owned();
        let expected = ["0.100", "0.300 (0.100, 0.500)", "0.267 (0.000 to 0.784)"];
        let found = row(&said, "success");
        assert!(found.contains(expected[number as usize]), "{found}");
        let is_explained = said.contains("In brackets: the 95 % interval");
        assert_eq!(is_explained, number > 0, "{said}");
    }
}

#[test]
fn the_report_names_the_policies_and_explains_the_early_column() {
    let out = TempDir::new().expect("a folder");
    seed(out.path(), 3, 10, 0);
    // The fourth block is the best one; later blocks do not change that.
    let path = out.path().join("seed-3/evaluations.csv");
    let text = fs::read_to_string(&path).expect("the file");
    let text = text.replace("\n800,0.4,0.4,", "\n800,1.0,1.0,");
    fs::write(&path, text.replace("\n2000,1,1,", "\n2000,0.5,0.5,")).expect("written");
    let best = out.path().join("seed-3/learner/policies/00000800.onnx");
    fs::write(best, b"best").expect("written");
    let output = report(out.path());
    assert!(output.status.success(), "{output:?}");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let table = fs::read_to_string(out.path().join("table.md")).expect("the table");
    for words in [
        "policy.onnx is the policy of seed 3 after step 800",
        "After the last block: seed-3/learner/policies/00002000.onnx",
        "\"ours, 400 steps\" is the last block within the first fifth",
    ] {
        assert!(said.contains(words), "{words}: {said}");
        assert!(table.contains(words), "{words}: {table}");
    }
    let taken = fs::read(out.path().join("policy.onnx")).expect("the best");
    assert_eq!(taken, b"best");
}

#[test]
fn blocks_that_taught_nothing_are_reported() {
    let out = TempDir::new().expect("a folder");
    seed(out.path(), 0, 3, 0);
    let path = out.path().join("seed-0/learner/blocks.csv");
    let text = fs::read_to_string(&path).expect("the file");
    fs::write(
        &path,
        text.replace("400,400,0,100,40,40,", "400,400,0,250,20,20,"),
    )
    .expect("written");
    let said = String::from_utf8_lossy(&report(out.path()).stdout).into_owned();
    for words in [
        "seed 0: in 1 block no step got a label",
        "seed 0: in 1 block the policy drove no step, though there was one (ending at step 400).",
    ] {
        assert!(said.contains(words), "{words}: {said}");
    }
}

#[test]
fn each_seed_is_numbered_at_the_end_of_its_curves() {
    let out = TempDir::new().expect("a folder");
    let numbers = || {
        report(out.path());
        let picture = fs::read_to_string(out.path().join("curves.svg")).expect("the picture");
        let count = |word: &str| picture.lines().filter(|line| line.trim() == word).count();
        [count("16"), count("17")]
    };
    seed(out.path(), 16, 10, 0);
    assert_eq!(numbers(), [0, 0], "one seed needs no number");
    seed(out.path(), 17, 10, 0);
    // Two curves in three panels, and one in the fourth.
    assert_eq!(numbers(), [7, 7]);
}

#[test]
fn a_folder_with_other_files_is_refused_and_unchanged() {
    let out = TempDir::new().expect("a folder");
    fs::write(out.path().join("policy.onnx"), b"mine").expect("written");
    let before = files(out.path());
    let output = train(out.path(), &["--steps", "200"]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(
        said.contains("contains policy.onnx, but no experiment"),
        "{said}"
    );
    assert!(said.contains("name a new or an empty folder"), "{said}");
    assert_eq!(files(out.path()), before);
}

#[test]
fn a_folder_with_a_running_training_is_refused_and_unchanged() {
    let out = TempDir::new().expect("a folder");
    seed(out.path(), 0, 2, 0);
    fs::write(out.path().join("seed-0/drive.log"), b"drives").expect("written");
    fs::remove_file(out.path().join("seed-0/train.toml")).expect("the file");
    let lock = File::create(out.path().join(".lock")).expect("written");
    lock.try_lock().expect("the lock is free");
    let before = files(out.path());
    let words = ["--resume", "--algorithm", "ppl", "--expert", "informed"];
    let output = train(out.path(), &words);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("is being trained in by another"), "{said}");
    assert_eq!(files(out.path()), before);
}

#[test]
fn overrides_of_the_trainings_own_keys_are_refused_before_any_file_is_made() {
    let place = TempDir::new().expect("a folder");
    let out = place.path().join("out");
    for (words, hint) in [
        (
            &["--steps", "300"][..],
            "a multiple of learner.block_steps, 200",
        ),
        (&["--set", "run.clock=real_time"], "drives in lockstep"),
        (&["--set", "run.duration_s = 3"], "--steps says how long"),
        (&["--set", "run.folder=there"], "--out names the folder"),
        (&["--set", "learner.enabled=false"], "always learns"),
        (&["--set", "learner.algorithm=bc"], "--algorithm says"),
        (&["--set", "learner.seed=4"], "--seed and --seeds"),
    ] {
        let output = train(&out, words);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{words:?}: {said}");
        assert!(said.contains(hint), "{words:?}: {said}");
        assert!(!out.exists(), "{words:?}");
    }
}

#[test]
fn an_empty_folder_is_told() {
    let out = TempDir::new().expect("a folder");
    let output = report(out.path());
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(
        said.contains("no block has been trained there yet"),
        "{said}"
    );
}

#[test]
fn queries_and_held_back_episodes_are_reported() {
    let out = TempDir::new().expect("a folder");
    seed(out.path(), 0, 10, 0);
    let held_back = r#"{"steps": 2000, "episodes": 40, "success": {"mean": 0.75}}"#;
    fs::write(out.path().join("seed-0/held-back.json"), held_back).expect("written");
    let json = out.path().join("figures.json");
    let output = train(
        out.path(),
        &["--report", "--json", json.to_str().expect("UTF-8")],
    );
    assert!(output.status.success(), "{output:?}");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let queries = row(&said, "expert queries");
    assert!(
        queries.contains("1240") && queries.contains("6200"),
        "{queries}"
    );
    let name = "last policy, held-back episodes, 1 seed x 40 episodes";
    assert!(said.contains(name), "{said}");
    assert!(!said.contains("last policy, 1 seed"), "{said}");
    let figures: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(&json).expect("the file")).expect("JSON");
    assert_eq!(figures["seeds"][0]["expert_queries"], 6200);
    assert_eq!(figures["seeds"][0]["held_back"]["success"]["mean"], 0.75);
    let picture = fs::read_to_string(out.path().join("queries.svg")).expect("the picture");
    assert!(picture.contains("expert queries"));
}
