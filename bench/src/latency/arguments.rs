//! Command line of `bench latency`, and the rows that it requests.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde::{Deserialize, Serialize};

use super::judges::JudgeBehaviour;
use super::link::RemoteJudge;
use super::viewers::Viewers;
use crate::floor::Priority;

/// Measure the punctuality of a running set under load
#[derive(Debug, Args)]
#[command(
    after_help = "Each row is a whole process set that drives in real time under a load: none; work on \
        every core (cpu), in memory (memory) or on the disk (disk), by stress-ng where it is \
        installed; a judge over HTTP that answers in 1 s (gate); a learner that trains and swaps \
        the weights (learner); all of these at once (all); the recorder, the live page with one \
        browser (view) or with ten, one of which reads nothing (browsers); the ROS bridge and \
        10,000 foreign messages a second (ros), for which ./vlaps setup ros and the examples of ros/ \
        have to be built; a judge that joins over the loopback, with mutual TLS, as from another \
        machine (link), or falls silent half way (link-cut), for which ./vlaps setup link has to be \
        built. judges is one row for each behaviour of \
        a judge: answer at once or late, hang, refuse, send 10 MB, die; its first and its last row \
        have no judge, and the difference between these two is the machine's noise.\n\n\
        During each row the machine's own floor is measured by cyclictest at the same priority and \
        period (where it is not installed, by a thread of this program), and one thread per core, \
        which wakes up 1,000 times a second, records the machine's stalls.\n\n\
        With --out each row is kept as soon as it is done: after Ctrl-C, the same command with the \
        same settings continues; other settings are refused; --fresh measures all rows again. The \
        default rows take about 20 minutes.\n\n\
        Examples:\n  \
        ./vlaps bench latency --out latency\n  \
        ./vlaps bench latency --load none,all --rate 1000 --priority granted --seconds 60\n  \
        ./vlaps bench latency --load view,browsers --rate 100 --pairs 3 --seconds 5\n  \
        ./vlaps bench latency --load judges --rate 10,100 --priority granted --json judges.json"
)]
pub struct BenchLatency {
    /// Load on the machine during a row.
    #[arg(
        long,
        value_name = "WHAT",
        value_delimiter = ',',
        default_value = "none,cpu,memory,disk,gate,learner,all"
    )]
    pub load: Vec<Load>,
    /// Seconds per row.
    #[arg(long, value_name = "S", default_value_t = 20.0, allow_negative_numbers = true,
          value_parser = supervisor::subcommand::seconds)]
    pub seconds: f64,
    /// Tick rates, one or more.
    #[arg(
        long,
        value_name = "HZ",
        allow_negative_numbers = true,
        value_delimiter = ',',
        default_value = "10,100,1000"
    )]
    pub rate: Vec<f64>,
    /// Rows that request real-time priority (granted), that do not (refused), or both.
    /// Each row reports what the kernel granted.
    #[arg(long, value_name = "WHICH", default_value = "both")]
    pub priority: PriorityChoice,
    /// Measure each load this many times, each time after a row without load, and print the
    /// ratio of both with its interval.
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = supervisor::cli::parsers::whole::<u32>(2..=100))]
    pub pairs: Option<u32>,
    /// Program that produces the load of cpu, memory and disk.
    #[arg(long, value_name = "PROGRAM", default_value = "auto")]
    pub stress: StressChoice,
    /// Program that measures the machine's floor.
    #[arg(long, value_name = "PROGRAM", default_value = "auto")]
    pub floor: FloorChoice,
    /// Override a key of the configuration, such as planner.rate_hz=10; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Write rows, histograms (CSV) and plots (SVG, PNG) into this folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Measure rows again that --out holds already.
    #[arg(long, requires = "out")]
    pub fresh: bool,
    /// Also write the rows to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Load on the machine, as on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Load {
    /// No load.
    None,
    /// Work on every core.
    Cpu,
    /// Work in memory.
    Memory,
    /// Work on the disk.
    Disk,
    /// A judge that answers in 1 s.
    Gate,
    /// A learner that trains and swaps the weights.
    Learner,
    /// All of these at once.
    All,
    /// The recorder, which writes every message; beside all of these with --set
    /// record.keep=everything.
    Recorder,
    /// The live page with one browser.
    View,
    /// The live page with ten browsers, one of which reads nothing.
    Browsers,
    /// Recorder and page with one browser.
    RecorderView,
    /// The ROS bridge with a reader of all its topics, and 10,000 foreign messages a second.
    Ros,
    /// A judge that joins over the loopback, as from another machine.
    Link,
    /// The same, whose connection stays open and silent from half of the row on.
    LinkCut,
    /// One row for each behaviour of a judge.
    Judges,
}

/// Whether real-time priority is requested.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PriorityChoice {
    /// It is requested.
    Granted,
    /// It is not requested, as on a machine that refuses it.
    Refused,
    /// Rows of both.
    Both,
}

/// The program that produces the load.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum StressChoice {
    /// stress-ng where it is installed, otherwise this program.
    Auto,
    /// stress-ng.
    StressNg,
    /// Threads of this program.
    Own,
}

/// The program that measures the floor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FloorChoice {
    /// cyclictest where it is installed, otherwise this program.
    Auto,
    /// cyclictest.
    Cyclictest,
    /// A thread of this program.
    Own,
}

/// Load during one row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beside {
    /// Name in tables and files.
    pub name: &'static str,
    /// Work on every core.
    pub cpu: bool,
    /// Work in memory.
    pub memory: bool,
    /// Work on the disk.
    pub disk: bool,
    /// Whether the learner trains.
    pub learner: bool,
    /// Whether the recorder records everything.
    pub recorder: bool,
    /// Browsers that show the set.
    pub viewers: Viewers,
    /// Whether the ROS bridge publishes the set to a flooded router.
    pub ros: bool,
    /// The judge that joins over the network, in place of `judge`.
    pub link: RemoteJudge,
    /// Behaviour of the judge.
    pub judge: JudgeBehaviour,
}

const NOTHING: Beside = Beside {
    name: "none",
    cpu: false,
    memory: false,
    disk: false,
    learner: false,
    recorder: false,
    viewers: Viewers::Absent,
    ros: false,
    link: RemoteJudge::Absent,
    judge: JudgeBehaviour::Absent,
};
const JUDGE: JudgeBehaviour = JudgeBehaviour::Answers { after_s: 1.0 };

impl Load {
    /// The row without any load.
    pub const NOTHING: Beside = NOTHING;

    /// The rows of this choice.
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
                cpu: true,
                memory: true,
                disk: true,
                learner: true,
                judge: JUDGE,
                ..one("all")
            },
            Self::Recorder => Beside {
                recorder: true,
                ..one("recorder")
            },
            Self::View => Beside {
                viewers: Viewers::One,
                ..one("view")
            },
            Self::Browsers => Beside {
                viewers: Viewers::Ten,
                ..one("browsers")
            },
            Self::RecorderView => Beside {
                recorder: true,
                viewers: Viewers::One,
                ..one("recorder-view")
            },
            Self::Ros => Beside {
                ros: true,
                ..one("ros")
            },
            Self::Link => Beside {
                link: RemoteJudge::Joined,
                ..one("link")
            },
            Self::LinkCut => Beside {
                link: RemoteJudge::FallsSilent,
                ..one("link-cut")
            },
            Self::Judges => return judged(),
        }]
    }
}

/// One row per behaviour; the first and the last row have no judge.
fn judged() -> Vec<Beside> {
    let row = |judge: JudgeBehaviour| Beside {
        name: judge.words(),
        judge,
        ..NOTHING
    };
    let mut rows = vec![row(JudgeBehaviour::Absent)];
    rows.extend(JudgeBehaviour::BAD.map(row));
    rows.push(Beside {
        name: "no judge, again",
        ..NOTHING
    });
    rows
}

/// One row to measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// Ticks per second.
    pub rate_hz: f64,
    /// Whether real-time priority is requested.
    pub priority: Priority,
    /// Load during the row.
    pub beside: Beside,
    /// The number of its pair from 0; `None` without pairs.
    pub pair: Option<u32>,
}

/// Settings of a measurement: rows of different settings are not mixed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Seconds per row.
    pub seconds: f64,
    /// Version of the measuring method.
    pub method: u32,
    /// Configuration keys that were overridden.
    pub overrides: Vec<String>,
    /// The program that produces the load.
    pub stress: String,
    /// The program that measures the floor.
    pub floor: String,
}

/// Keys that each row sets, and the option that changes them.
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
    /// The rows in order, each once.
    pub fn cases(&self) -> Vec<Case> {
        let priorities: &[Priority] = match self.priority {
            PriorityChoice::Granted => &[Priority::Asked],
            PriorityChoice::Refused => &[Priority::Ordinary],
            PriorityChoice::Both => &[Priority::Asked, Priority::Ordinary],
        };
        let loads: Vec<Beside> = self.load.iter().flat_map(|load| load.rows()).collect();
        let mut cases: Vec<Case> = Vec::new();
        for &rate_hz in &self.rate {
            for &priority in priorities {
                for (beside, pair) in self.in_pairs(&loads) {
                    let case = Case {
                        rate_hz,
                        priority,
                        beside,
                        pair,
                    };
                    if !cases.contains(&case) {
                        cases.push(case);
                    }
                }
            }
        }
        cases
    }

    /// The rows of one rate and priority; with pairs, each round begins without a load.
    fn in_pairs(&self, loads: &[Beside]) -> Vec<(Beside, Option<u32>)> {
        let Some(pairs) = self.pairs else {
            return loads.iter().map(|load| (*load, None)).collect();
        };
        let round = || std::iter::once(&NOTHING).chain(loads);
        let rounds = (0..pairs).flat_map(|pair| round().map(move |load| (*load, Some(pair))));
        rounds.collect()
    }
}

impl Settings {
    /// The settings that differ from the requested ones, in words; empty if none does.
    pub fn differences(&self, asked: &Self) -> String {
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
    /// Description for the progress bar.
    pub fn words(&self) -> String {
        let words = self.words_without_pair();
        match self.pair {
            Some(pair) => format!("{words}, pair {}", pair + 1),
            None => words,
        }
    }

    /// The same for all pairs.
    pub fn words_without_pair(&self) -> String {
        format!(
            "{} Hz, {}, {}",
            self.rate_hz,
            self.beside.name,
            self.priority_word()
        )
    }

    /// The word for the priority in tables and files.
    pub fn priority_word(&self) -> &'static str {
        match self.priority {
            Priority::Asked => "real-time",
            Priority::Ordinary => "ordinary",
        }
    }

    /// Stem of its file names.
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
            pairs: None,
            out: None,
            fresh: false,
            json: None,
        };
        let cases = arguments.cases();
        let slugs: std::collections::BTreeSet<_> = cases.iter().map(Case::slug).collect();
        assert_eq!(slugs.len(), cases.len(), "{slugs:?}");
        assert_eq!(cases.len(), (14 + 10) * 3 * 2);
        assert!(slugs.contains("100-hz-judge-answers-in-0.1-s-real-time"));
        // A row that is requested twice is measured once.
        arguments.rate.push(100.0);
        arguments.load.push(Load::Cpu);
        assert_eq!(arguments.cases(), cases);
        (arguments.rate, arguments.load) = (vec![100.0], vec![Load::View]);
        (arguments.priority, arguments.pairs) = (PriorityChoice::Granted, Some(2));
        let words: Vec<_> = arguments.cases().iter().map(Case::words).collect();
        let expected = [("none", 1), ("view", 1), ("none", 2), ("view", 2)];
        let expected =
            expected.map(|(load, pair)| format!("100 Hz, {load}, real-time, pair {pair}"));
        assert_eq!(words, expected);
    }
}
