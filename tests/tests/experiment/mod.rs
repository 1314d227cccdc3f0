//! An experiment of `./vlaps train`, which leaves nothing behind.

use std::fs;
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};

use rustix::process::{Pid, Signal, kill_process};
use shm_config::config::from_toml;
use shm_config::run::RunPaths;
use vlaps_tests::{pids_within, programs, until};

/// Steps of a block: the fewest that give the learner something to do.
pub const BLOCK: u64 = 40;
/// An experiment of a test, in its own folder.
pub struct Experiment {
    pub folder: PathBuf,
    pub name: String,
    child: Option<Child>,
}

impl Experiment {
    pub fn new(label: &str) -> Experiment {
        let name = format!("x{}-{label}", std::process::id());
        let folder = std::env::temp_dir().join(format!("vlaps-tests-{name}"));
        fs::create_dir_all(&folder).expect("a folder");
        Experiment {
            folder,
            name,
            child: None,
        }
    }

    /// Small nets and the cheapest expert, because the test does not depend on how they
    /// drive.
    pub fn command(&self, words: &[&str]) -> Command {
        let mut command = Command::new(programs().join("vlaps-lab"));
        command
            .args([
                "train",
                "--algorithm",
                "hg-dagger",
                "--expert",
                "informed",
                "--out",
            ])
            .arg(&self.name)
            .args(["--eval-episodes", "1"])
            .current_dir(&self.folder)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let settings = [
            format!("learner.block_steps={BLOCK}"),
            "learner.updates=10".into(),
            "learner.batch=32".into(),
            "learner.hidden=32".into(),
            "learner.filters=4".into(),
            "supervisor.restarts_max=100".into(),
            "supervisor.backoff_max_ms=20".into(),
            // Untrained policies stand still until their time is up.
            "world.horizon_ticks=60".into(),
        ];
        for setting in settings {
            command.args(["--set".into(), setting]);
        }
        command.args(words);
        command
    }

    pub fn run(&self, words: &[&str]) -> Output {
        self.command(words).output().expect("it starts")
    }

    /// Resumes with these arguments alone.
    pub fn resume(&self, words: &[&str]) -> Output {
        let mut command = Command::new(programs().join("vlaps-lab"));
        command
            .args(["train", "--resume", "--out", &self.name])
            .args(words)
            .current_dir(&self.folder);
        command.output().expect("it starts")
    }

    pub fn start(&mut self, words: &[&str]) {
        self.child = Some(self.command(words).spawn().expect("it starts"));
    }

    pub fn signal(&self, signal: Signal) {
        let child = self.child.as_ref().expect("a training");
        kill_process(Pid::from_child(child), signal).expect("it lives");
    }

    pub fn end(&mut self) -> Output {
        let child = self.child.take().expect("a training");
        child.wait_with_output().expect("an end")
    }

    pub fn seed(&self, seed: u64) -> PathBuf {
        self.folder.join(&self.name).join(format!("seed-{seed}"))
    }

    /// A column of a seed's CSV file, as text.
    pub fn column(&self, seed: u64, file: &str, name: &str) -> Vec<String> {
        let text = fs::read_to_string(self.seed(seed).join(file)).unwrap_or_default();
        let whole = text.rfind('\n').map_or("", |end| &text[..end]);
        let header = whole.lines().next().unwrap_or_default();
        let Some(at) = header.split(',').position(|word| word == name) else {
            return Vec::new();
        };
        let rows = whole.lines().skip(1);
        rows.map(|row| row.split(',').nth(at).expect("a field").into())
            .collect()
    }

    pub fn blocks(&self, seed: u64) -> Vec<u64> {
        let steps = self.column(seed, "learner/blocks.csv", "steps");
        steps
            .iter()
            .map(|text| text.parse().expect("a number"))
            .collect()
    }

    /// Process ids of a program of the training's set.
    pub fn pids(&self, program: &str) -> Vec<i32> {
        pids_within(&self.folder, program)
    }
}

impl Drop for Experiment {
    fn drop(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
        until("the set ends with its training", || {
            self.pids("").is_empty()
        });
        for seed in 0..3 {
            let begun = fs::read_to_string(self.seed(seed).join("train.toml"));
            let config = begun.ok().and_then(|text| from_toml(&text, "").ok());
            if let Some(Ok(name)) = config.map(|config| config.run.name.parse()) {
                let paths = RunPaths::new(name);
                until("the run is dead", || {
                    !matches!(paths.clean_if_dead(), Ok(None))
                });
                paths.remove_dir();
            }
        }
        let _ = fs::remove_dir_all(&self.folder);
    }
}
