//! The command line of `bench latency`, and the rows it asks for.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde::{Deserialize, Serialize};

use super::judges::Conduct;
use crate::floor::Priority;

/// Measure how punctual a running set is, by what happens beside it
#[derive(Debug, Args)]
#[command(
    after_help = "Each row is a whole process set that drives in real time while something happens \
        beside it: nothing; work for every core (cpu), for the memory (memory) or for the disk \
        (disk), by stress-ng where it is installed; a judge over HTTP that answers in 1 s (gate); a \
        learner that trains and swaps the weights (learner); all of these at once (all). judges is \
        one row for each thing a judge can do: answer at once or late, hang, refuse, send 10 MB, \
        die; the row without a judge comes first and last there, and what differs between these \
        two is the machine's noise.\n\n\
        Beside each row, in the same seconds, the machine's own floor is measured by cyclictest at \
        the same priority and period (where it is not installed, by a thread that does the same), \
        and a thread on each core, which wakes up 1,000 times a second, notes when the machine stalled.\n\n\
        With --out each row is kept as it is done: after Ctrl-C, the same command with the same \
        settings continues; other settings are refused; --fresh measures all rows anew. All rows of the defaults take \
        about 20 minutes.\n\n\
        Examples:\n  \
        ./vlaps bench latency --out latency\n  \
        ./vlaps bench latency --load none,all --rate 1000 --priority granted --seconds 60\n  \
        ./vlaps bench latency --load judges --rate 10,100 --priority granted --json judges.json"
)]
pub struct BenchLatency {
    /// What happens beside the set.
    #[arg(
        long,
        value_name = "WHAT",
        value_delimiter = ',',
        default_value = "none,cpu,memory,disk,gate,learner,all"
    )]
    pub load: Vec<Load>,
    /// Seconds for each row.
    #[arg(long, value_name = "S", default_value_t = 20.0, allow_negative_numbers = true,
          value_parser = supervisor::subcommand::seconds)]
    pub seconds: f64,
    /// Ticks per second, one or more.
    #[arg(
        long,
        value_name = "HZ",
        allow_negative_numbers = true,
        value_delimiter = ',',
        default_value = "10,100,1000"
    )]
    pub rate: Vec<f64>,
    /// Rows with real-time priority asked for (granted), not asked for (refused),
    /// or both. Each row holds what the kernel granted.
    #[arg(long, value_name = "WHICH", default_value = "both")]
    pub priority: PriorityChoice,
    /// The program that makes the load of cpu, memory and disk.
    #[arg(long, value_name = "PROGRAM", default_value = "auto")]
    pub stress: StressChoice,
    /// The program that measures the machine's floor.
    #[arg(long, value_name = "PROGRAM", default_value = "auto")]
    pub floor: FloorChoice,
    /// Override a key of the configuration, such as planner.rate_hz=10; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Write rows, histograms (CSV) and pictures (SVG, PNG) into this folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Measure the rows that --out holds already once more.
    #[arg(long, requires = "out")]
    pub fresh: bool,
    /// Write the rows to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// What happens beside the set, as on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Load {
    /// Nothing.
    None,
    /// Work for every core.
    Cpu,
    /// Work for the memory.
    Memory,
    /// Work for the disk.
    Disk,
    /// A judge that answers in 1 s.
    Gate,
    /// A learner that trains and swaps the weights.
    Learner,
    /// All of these at once.
    All,
    /// A row for each thing a judge can do.
    Judges,
}

/// Whether real-time priority is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PriorityChoice {
    /// It is.
    Granted,
    /// It is not, as on a machine that refuses it.
    Refused,
    /// A row of either.
    Both,
}

/// The program that makes the load.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum StressChoice {
    /// stress-ng where it is installed, else this program.
    Auto,
    /// stress-ng.
    StressNg,
    /// Threads of this program.
    Own,
}

/// The program that measures the floor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FloorChoice {
    /// cyclictest where it is installed, else this program.
    Auto,
    /// cyclictest.
    Cyclictest,
    /// A thread of this program.
    Own,
}

/// What happens beside one row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beside {
    /// In one word, or some for a judge.
    pub name: &'static str,
    /// Work for every core.
    pub cpu: bool,
    /// Work for the memory.
    pub memory: bool,
    /// Work for the disk.
    pub disk: bool,
    /// The learner trains.
    pub learner: bool,
    /// The judge.
    pub judge: Conduct,
}

const NOTHING: Beside = Beside {
    name: "none",
    cpu: false,
    memory: false,
    disk: false,
    learner: false,
    judge: Conduct::Absent,
};
const JUDGE: Conduct = Conduct::Answers { after_s: 1.0 };

impl Load {
    /// The rows that it stands for.
    pub fn rows(self) -> Vec<Beside> {
        let one = |name| Beside { name, ..NOTHING };
        vec![match self {
            Self::None => NOTHING,
            Self::Cpu => Beside {
                cpu: true,
                ..one("cpu")
            },
            Self::Memory => Beside {
                memory: true,
                ..one("memory")
            },
            Self::Disk => Beside {
                disk: true,
                ..one("disk")
            },
            Self::Gate => Beside {
                judge: JUDGE,
                ..one("gate")
            },
            Self::Learner => Beside {
                learner: true,
                ..one("learner")
            },
            Self::All => Beside {
                name: "all",
                cpu: true,
                memory: true,
                disk: true,
                learner: true,
                judge: JUDGE,
            },
            Self::Judges => return judged(),
        }]
    }
}

/// A row for each conduct; without a judge first, and last once more.
fn judged() -> Vec<Beside> {
    let row = |judge: Conduct| Beside {
        name: judge.words(),
        judge,
        ..NOTHING
    };
    let mut rows = vec![row(Conduct::Absent)];
    rows.extend(Conduct::BAD.map(row));
    rows.push(Beside {
        name: "no judge, again",
        ..NOTHING
    });
    rows
}

/// One row to drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// Ticks per second.
    pub rate_hz: f64,
    /// Whether real-time priority is asked for.
    pub priority: Priority,
    /// What happens beside it.
    pub beside: Beside,
}

/// What a row is measured with: a row of other settings is another row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Seconds driven.
    pub seconds: f64,
    /// The way of measuring.
    pub method: u32,
    /// Keys that were set.
    pub overrides: Vec<String>,
    /// The program that makes the load.
    pub stress: String,
    /// The program that measures the floor.
    pub floor: String,
}

/// Keys that each row sets, and the option that says them.
pub const OWN_KEYS: [(&str, &str); 11] = [
    ("run.name", ""),
    ("run.folder", ""),
    ("run.clock", ""),
    ("run.seed", ""),
    ("run.episodes", "--seconds"),
    ("run.duration_s", "--seconds"),
    ("run.rate_hz", "--rate"),
    ("supervisor.realtime", "--priority"),
    ("gate.mode", "--load"),
    ("learner.enabled", "--load"),
    ("policy.file", ""),
];

impl BenchLatency {
    /// The rows in the order in which they are driven, each once.
    pub fn cases(&self) -> Vec<Case> {
        let priorities: &[Priority] = match self.priority {
            PriorityChoice::Granted => &[Priority::Asked],
            PriorityChoice::Refused => &[Priority::Ordinary],
            PriorityChoice::Both => &[Priority::Asked, Priority::Ordinary],
        };
        let mut cases: Vec<Case> = Vec::new();
        for &rate_hz in &self.rate {
            for &priority in priorities {
                for beside in self.load.iter().flat_map(|load| load.rows()) {
                    let case = Case {
                        rate_hz,
                        priority,
                        beside,
                    };
                    if !cases.contains(&case) {
                        cases.push(case);
                    }
                }
            }
        }
        cases
    }
}

impl Settings {
    /// What differs from what is asked for, in words; empty when nothing does.
    pub fn unlike(&self, asked: &Self) -> String {
        let set = |overrides: &[String]| match overrides {
            [] => "nothing".to_string(),
            some => some.join(" "),
        };
        let all = [
            (
                "--seconds",
                self.seconds.to_string(),
                asked.seconds.to_string(),
            ),
            ("--set", set(&self.overrides), set(&asked.overrides)),
            ("load by", self.stress.clone(), asked.stress.clone()),
            ("floor by", self.floor.clone(), asked.floor.clone()),
            ("method", self.method.to_string(), asked.method.to_string()),
        ];
        let differing = all.iter().filter(|(_, was, asked)| was != asked);
        let words = differing.map(|(what, was, asked)| format!("{what} {was} in place of {asked}"));
        words.collect::<Vec<_>>().join(", ")
    }
}

impl Case {
    /// For a progress bar.
    pub fn words(&self) -> String {
        format!(
            "{} Hz, {}, {}",
            self.rate_hz,
            self.beside.name,
            self.priority_word()
        )
    }

    /// In one word.
    pub fn priority_word(&self) -> &'static str {
        match self.priority {
            Priority::Asked => "real-time",
            Priority::Ordinary => "ordinary",
        }
    }

    /// The name of its files.
    pub fn slug(&self) -> String {
        let name: String = self.words().to_lowercase();
        let words = name
            .split(|letter: char| !letter.is_ascii_alphanumeric() && letter != '.')
            .filter(|word| !word.is_empty());
        words.collect::<Vec<_>>().join("-")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_has_files_of_its_own() {
        let mut arguments = BenchLatency {
            load: Load::value_variants().to_vec(),
            seconds: 1.0,
            rate: vec![10.0, 100.0, 1000.0],
            priority: PriorityChoice::Both,
            stress: StressChoice::Auto,
            floor: FloorChoice::Auto,
            overrides: Vec::new(),
            out: None,
            fresh: false,
            json: None,
        };
        let cases = arguments.cases();
        let slugs: std::collections::BTreeSet<_> = cases.iter().map(Case::slug).collect();
        assert_eq!(slugs.len(), cases.len(), "{slugs:?}");
        assert_eq!(cases.len(), (7 + 10) * 3 * 2);
        assert!(slugs.contains("100-hz-judge-answers-in-0.1-s-real-time"));
        // A row that is asked for twice is measured once.
        arguments.rate.push(100.0);
        arguments.load.push(Load::Cpu);
        assert_eq!(arguments.cases(), cases);
    }
}
