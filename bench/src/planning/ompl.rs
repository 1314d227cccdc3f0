//! Builds OMPL's RRTstar from `bench/ompl` on request and talks to it through pipes.
//! `bench/ompl/README.md` describes the scene file and the protocol.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use anyhow::{Context, anyhow, bail};
use planner::{Cell, Grid, PlannerConfig};
use shm_config::message::Plan;
use supervisor::cli::failure::Failure;
use tempfile::TempDir;

/// The sources of `bench/ompl`.
const SOURCES: [(&str, &str); 2] = [
    ("rrt_star.cpp", include_str!("../../ompl/rrt_star.cpp")),
    ("grid.hpp", include_str!("../../ompl/grid.hpp")),
];
/// First bytes of a scene file.
const MAGIC: &[u8; 8] = b"VLAPSRRT";
/// OMPL's nearest-neighbour search. With 200 nodes, linear search takes a tenth less
/// time than OMPL's default, a GNAT; the comparison uses the faster one.
const NEIGHBOURS: &str = "linear";
/// Cells per word of the file.
const WORD: usize = u64::BITS as usize;

/// The built program; its folder is removed when this value is dropped.
pub(super) struct Program {
    folder: TempDir,
    /// The library's version.
    pub(super) version: String,
}

/// Builds the program.
///
/// # Errors
/// If the compiler or the library is missing; the message says what to install.
pub(super) fn build() -> anyhow::Result<Program> {
    let missing = |what: &str| {
        Failure::GivenUp(format!(
            "--ompl: {what}; `sudo apt-get install g++ pkg-config libompl-dev` installs what it \
             needs"
        ))
    };
    let ask = |option: &str| {
        let answer = Command::new("pkg-config").args([option, "ompl"]).output();
        let answer = answer.map_err(|_| missing("pkg-config is missing"))?;
        match answer.status.success() {
            true => Ok(String::from_utf8_lossy(&answer.stdout).trim().to_string()),
            false => Err(missing("pkg-config finds no OMPL")),
        }
    };
    let (version, flags) = (ask("--modversion")?, ask("--cflags")?);
    let folder = tempfile::tempdir().context("--ompl: a folder to build in")?;
    for (name, text) in SOURCES {
        std::fs::write(folder.path().join(name), text).context("--ompl: the sources")?;
    }
    let built = Command::new("g++")
        .current_dir(folder.path())
        .arg("-O3")
        .args(flags.split_whitespace())
        // Link the library itself, not all dependencies that pkg-config lists.
        .args(["rrt_star.cpp", "-o", "rrt_star", "-lompl"])
        .output()
        .map_err(|_| missing("g++ is missing"))?;
    if !built.status.success() {
        let text = String::from_utf8_lossy(&built.stderr);
        bail!("--ompl: g++ does not build bench/ompl with OMPL {version}:\n{text}");
    }
    Ok(Program { folder, version })
}

/// A planning problem in OMPL's form.
pub(super) struct Task {
    numbers: [f64; 5],
    words: Vec<u64>,
}

impl Task {
    /// Takes the grid and the goal of a plan.
    pub(super) fn new(grid: &Grid, plan: &Plan) -> Task {
        let corridor = grid.corridor();
        let per_row = grid.columns().div_ceil(WORD);
        let mut words = vec![0; per_row * grid.rows()];
        for row in 0..grid.rows() {
            // The bits beyond the last column are marked as occupied.
            for column in 0..per_row * WORD {
                let occupied = grid.is_occupied(Cell { column, row });
                words[row * per_row + column / WORD] |= u64::from(occupied) << (column % WORD);
            }
        }
        let x_max_m = plan.goal_x_body_m.clamp(0.0, grid.x_max_m());
        Task {
            numbers: [
                plan.goal_x_body_m,
                plan.goal_y_body_m,
                x_max_m,
                corridor.right_m,
                corridor.left_m,
            ],
            words,
        }
    }
}

/// The program's result for one scene.
#[derive(Clone, Copy, Debug)]
pub(super) struct Answer {
    pub(super) time_ns: u64,
    /// Length of the path, m; `None` if the goal is not reached.
    pub(super) cost_m: Option<f64>,
}

/// The running program.
pub(super) struct OmplProcess {
    child: Child,
    questions: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
}

impl Program {
    /// Starts it with these scenes, pinned to the cores of the calling thread.
    pub(super) fn start(
        &self,
        tasks: &[Task],
        grid: &Grid,
        config: &PlannerConfig,
    ) -> anyhow::Result<OmplProcess> {
        let file = self.folder.path().join("scenes");
        write(&file, tasks, grid, config).context("--ompl: the scene file")?;
        let mut child = Command::new(self.path())
            .arg(&file)
            .arg(NEIGHBOURS)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .context("--ompl: the program")?;
        let (questions, answers) = (child.stdin.take(), child.stdout.take());
        let answers = answers.ok_or_else(|| anyhow!("--ompl: no pipe from the program"))?;
        let mut process = OmplProcess {
            child,
            questions,
            answers: BufReader::new(answers),
        };
        let ready = process.line()?;
        if ready != format!("ready {}", tasks.len()) {
            bail!("--ompl: the program is not ready; it printed {ready:?}");
        }
        Ok(process)
    }

    fn path(&self) -> PathBuf {
        self.folder.path().join("rrt_star")
    }
}

impl OmplProcess {
    /// Plans for some scenes in order.
    pub(super) fn plan(
        &mut self,
        scenes: std::ops::Range<usize>,
        iterations: u32,
    ) -> anyhow::Result<Vec<Answer>> {
        let mut text = String::new();
        for scene in scenes.clone() {
            text.push_str(&format!("{scene} {iterations}\n"));
        }
        text.push('\n');
        if let Some(questions) = &mut self.questions {
            questions
                .write_all(text.as_bytes())
                .and_then(|()| questions.flush())
                .context("--ompl: the program does not read its input")?;
        }
        scenes.map(|_| self.answer(iterations)).collect()
    }

    fn answer(&mut self, iterations: u32) -> anyhow::Result<Answer> {
        let line = self.line()?;
        let wrong = || anyhow!("--ompl: unexpected answer of the program: {line:?}");
        let words: Vec<&str> = line.split(' ').collect();
        let [time_ns, cost_m, solved, done] = words[..] else {
            return Err(wrong());
        };
        let cost_m: f64 = cost_m.parse().map_err(|_| wrong())?;
        if done.parse() != Ok(iterations) {
            bail!("--ompl: requested {iterations} iterations, the program did {done}");
        }
        Ok(Answer {
            time_ns: time_ns.parse().map_err(|_| wrong())?,
            cost_m: (solved == "1").then_some(cost_m),
        })
    }

    fn line(&mut self) -> anyhow::Result<String> {
        let mut line = String::new();
        let length = self.answers.read_line(&mut line)?;
        if length == 0 {
            let status = self.child.wait()?;
            bail!("--ompl: the program ended early ({status})");
        }
        Ok(line.trim_end().to_string())
    }
}

impl Drop for OmplProcess {
    fn drop(&mut self) {
        // The program ends at the end of its input.
        self.questions = None;
        let _ = self.child.wait();
    }
}

/// Writes the scene file.
fn write(path: &Path, tasks: &[Task], grid: &Grid, config: &PlannerConfig) -> anyhow::Result<()> {
    let mut bytes = Vec::from(MAGIC);
    let counts = [
        tasks.len(),
        grid.columns(),
        grid.rows(),
        grid.columns().div_ceil(WORD),
    ];
    for count in counts {
        bytes.extend(u32::try_from(count)?.to_le_bytes());
    }
    let numbers = [
        grid.cell_m(),
        config.step_m,
        config.rewire_radius_m,
        config.goal_radius_m,
    ];
    bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    for task in tasks {
        bytes.extend(task.numbers.iter().flat_map(|number| number.to_le_bytes()));
        bytes.extend(task.words.iter().flat_map(|word| word.to_le_bytes()));
    }
    std::fs::write(path, bytes)?;
    Ok(())
}
