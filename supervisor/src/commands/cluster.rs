//! `cluster`: prints the script with which a cluster does a command's work in parts.

use clap::{Args, Subcommand};

use crate::cli::failure::Failure;
use crate::cli::parsers::whole;
use crate::cli::print::{quoted, say};

/// The scripts of the examples; the printed ones differ in the command and the numbers.
const SLURM: &str = include_str!("../../../examples/cluster/slurm.sh");
const KUBERNETES: &str = include_str!("../../../examples/cluster/kubernetes.yaml");
/// What they have in place of the command, of its name and of the number of parts.
const COMMAND: &str = "eval --driver mpc --episodes 8000 --out runs/mpc";
const POD_COMMAND: &str =
    r#""eval", "--driver", "mpc", "--episodes", "8000", "--out", "/results/mpc""#;
/// The commands that can be done in parts.
const DIVISIBLE: [&str; 4] = ["eval", "train", "sweep", "regress"];
/// The folder at which pods mount the volume of the results.
const MOUNTED: &str = "/results/";

/// Print the script with which a cluster does a command's work in parts
#[derive(Debug, Args)]
#[command(
    after_help = "The words after -- are a command of ./vlaps with --out, the folder of the parts; \
        the script adds --shard. The same command with --out DIR --report merges them.\n\n\
        Examples:\n  \
        ./vlaps cluster slurm -- eval --driver mpc --episodes 8000 --out runs/mpc | sbatch\n  \
        ./vlaps cluster slurm --shards 9 -- sweep --out runs/sweep > sweep.sh\n  \
        ./vlaps cluster kubernetes --image vlaps:0.1.0 -- eval --out /results/expert | kubectl apply -f -"
)]
pub struct Cluster {
    /// The system of the cluster.
    #[command(subcommand)]
    pub system: System,
}

/// A system that runs jobs.
#[derive(Debug, Subcommand)]
pub enum System {
    /// An array job of SLURM, for sbatch.
    Slurm(Job),
    /// An indexed Job of Kubernetes, for kubectl apply.
    Kubernetes(PodJob),
}

/// The job.
#[derive(Debug, Args)]
pub struct Job {
    /// Number of parts.
    #[arg(long, value_name = "N", default_value_t = 8, allow_negative_numbers = true,
          value_parser = whole::<u32>(1..=10_000))]
    pub shards: u32,
    /// Cores for each part.
    #[arg(long, value_name = "N", default_value_t = 2, allow_negative_numbers = true,
          value_parser = whole::<u32>(1..=1024))]
    pub cores: u32,
    /// The command, after --.
    #[arg(last = true, required = true, value_name = "COMMAND")]
    pub words: Vec<String>,
}

/// The job in pods.
#[derive(Debug, Args)]
pub struct PodJob {
    /// The container image, such as that of packaging/build.
    #[arg(long, value_name = "IMAGE", default_value = concat!("vlaps:", env!("CARGO_PKG_VERSION")))]
    pub image: String,
    /// The claim of a volume that all pods mount at /results.
    #[arg(long, value_name = "NAME", default_value = "vlaps-results")]
    pub claim: String,
    /// The job.
    #[command(flatten)]
    pub job: Job,
}

/// Prints the script.
///
/// # Errors
/// If the command cannot be done in parts.
pub fn cluster(arguments: &Cluster) -> Result<(), Failure> {
    match &arguments.system {
        System::Slurm(job) => say(slurm(job)?.trim_end()),
        System::Kubernetes(job) => say(kubernetes(job)?.trim_end()),
    }
    Ok(())
}

impl Job {
    /// The command's name and its folder.
    fn check(&self) -> Result<(&str, &str), Failure> {
        let name = self.words.first().map_or("", String::as_str);
        if !DIVISIBLE.contains(&name) {
            return Err(Failure::Usage(format!(
                "{name}: cannot be done in parts; choose from {}",
                DIVISIBLE.join(", ")
            )));
        }
        for own in ["--shard", "--report", "--json", "--resume"] {
            if self.option(own).is_some() {
                return Err(Failure::Usage(format!(
                    "{own}: leave it out; the script adds --shard, and --report --json FILE is \
                     for afterwards"
                )));
            }
        }
        match self.option("--out") {
            Some(out) if !out.is_empty() => Ok((name, out)),
            _ => Err(Failure::Usage(
                "--out DIR is missing: the folder of the parts, which all machines see".into(),
            )),
        }
    }

    /// The value of an option among the words; empty without one.
    fn option(&self, name: &str) -> Option<&str> {
        let at = self.words.iter().position(|word| {
            let rest = word.strip_prefix(name);
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('='))
        })?;
        let own = self.words[at].split_once('=').map(|(_, value)| value);
        Some(own.unwrap_or_else(|| self.words.get(at + 1).map_or("", String::as_str)))
    }
}

/// The head of an example explains its own command; that of a printed script is a line.
fn without_head(script: &str, first: &str) -> String {
    let body = script.find(first).map_or(script, |at| &script[at..]);
    format!("# Printed by ./vlaps cluster; parts are merged by --report.\n{body}")
}

fn slurm(job: &Job) -> Result<String, Failure> {
    let (name, _) = job.check()?;
    let words: Vec<String> = job.words.iter().map(|word| quoted(word)).collect();
    let script = without_head(SLURM, "#SBATCH --job-name")
        .replace("vlaps-eval", &format!("vlaps-{name}"))
        .replace("--array=1-8", &format!("--array=1-{}", job.shards))
        .replace(
            "--cpus-per-task=2",
            &format!("--cpus-per-task={}", job.cores),
        )
        .replace("sets it}/8\"", &format!("sets it}}/{}\"", job.shards))
        // Last: nothing else is replaced within the user's words.
        .replace(COMMAND, &words.join(" "));
    Ok(format!("#!/usr/bin/env bash\n{script}"))
}

fn kubernetes(arguments: &PodJob) -> Result<String, Failure> {
    let job = &arguments.job;
    let (_, out) = job.check()?;
    if !out.starts_with(MOUNTED) {
        return Err(Failure::Usage(format!(
            "--out {out}: must be below {MOUNTED}, where the pods mount the volume"
        )));
    }
    let text = |word: &String| serde_json::Value::from(word.replace("$(", "$$(")).to_string();
    let words: Vec<String> = job.words.iter().map(text).collect();
    Ok(without_head(KUBERNETES, "apiVersion")
        .replace("vlaps-eval", &job_name(out))
        .replace("completions: 8", &format!("completions: {}", job.shards))
        .replace("parallelism: 8", &format!("parallelism: {}", job.shards))
        .replace("+1/8\"", &format!("+1/{}\"", job.shards))
        .replace("cpu: \"2\"", &format!("cpu: \"{}\"", job.cores))
        .replace(
            "image: vlaps:0.1.0",
            &format!("image: {}", text(&arguments.image)),
        )
        .replace(
            "claimName: vlaps-results",
            &format!("claimName: {}", text(&arguments.claim)),
        )
        .replace(POD_COMMAND, &words.join(", ")))
}

/// The name of the Job, from the folder of the parts below the volume: a Job cannot be
/// changed, so other work needs another name. A label of DNS has 63 letters at most.
fn job_name(out: &str) -> String {
    let below = out.strip_prefix(MOUNTED).unwrap_or(out).to_lowercase();
    let words = below.split(|c: char| !c.is_ascii_alphanumeric());
    let words: Vec<&str> = words.filter(|word| !word.is_empty()).collect();
    let mut name = format!("vlaps-{}", words.join("-"));
    name.truncate(63);
    name.trim_end_matches('-').into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job(words: &[&str], shards: u32) -> Job {
        Job {
            shards,
            cores: 3,
            words: words.iter().map(ToString::to_string).collect(),
        }
    }

    #[test]
    fn the_script_has_the_command_as_it_was_given() {
        let words = [
            "train",
            "--out",
            "runs/a b",
            "--set",
            "run.name='x'; rm -rf /",
        ];
        let script = slurm(&job(&words, 12)).expect("a script");
        for line in [
            "#SBATCH --job-name=vlaps-train",
            "#SBATCH --array=1-12",
            "#SBATCH --cpus-per-task=3",
        ] {
            assert!(
                script.lines().any(|other| other == line),
                "{line}: {script}"
            );
        }
        let last = script.lines().last().expect("a command");
        assert_eq!(
            last,
            r#"exec ./vlaps train --out 'runs/a b' --set 'run.name='\''x'\''; rm -rf /' --shard "${SLURM_ARRAY_TASK_ID:?sbatch sets it}/12""#
        );
        assert!(script.starts_with("#!/usr/bin/env bash\n"), "{script}");
    }

    #[test]
    fn the_manifest_has_the_command_as_it_was_given() {
        let words = [
            "sweep",
            "--out",
            "/results/My_sweep/",
            "--set",
            "a=\"$(HOME)\"",
        ];
        let arguments = PodJob {
            image: "registry:5000/vlaps@sha256:0".into(),
            claim: "mine".into(),
            job: job(&words, 9),
        };
        let manifest = kubernetes(&arguments).expect("a manifest");
        for line in [
            "  name: vlaps-my-sweep",
            "  completions: 9",
            "  parallelism: 9",
            "          image: \"registry:5000/vlaps@sha256:0\"",
            "            claimName: \"mine\"",
            "              cpu: \"3\"",
            r#"          args: ["sweep", "--out", "/results/My_sweep/", "--set", "a=\"$$(HOME)\"", "--shard=$(JOB_COMPLETION_INDEX)+1/9"]"#,
        ] {
            assert!(
                manifest.lines().any(|other| other == line),
                "{line}: {manifest}"
            );
        }
        let cores = manifest.lines().filter(|line| line.contains("cpu: \"3\""));
        assert_eq!(cores.count(), 2, "requests and limits: {manifest}");
        assert_eq!(job_name(&format!("/results/{}-", "a".repeat(56))).len(), 62);
    }

    #[test]
    fn commands_without_parts_or_folder_are_refused() {
        for (words, hint) in [
            (&["up", "--out", "x"][..], "up: cannot be done in parts"),
            (&["eval"], "--out DIR is missing"),
            (&["eval", "--out"], "--out DIR is missing"),
            (
                &["eval", "--out", "x", "--shard=1/2"],
                "--shard: leave it out",
            ),
            (&["eval", "--out=x", "--json", "a"], "--json: leave it out"),
        ] {
            let error = slurm(&job(words, 8)).expect_err(hint).to_string();
            assert!(error.contains(hint), "{words:?}: {error}");
        }
        let pods = PodJob {
            image: "vlaps".into(),
            claim: "c".into(),
            job: job(&["eval", "--out", "runs/x"], 8),
        };
        let error = kubernetes(&pods).expect_err("not mounted").to_string();
        assert!(error.contains("below /results/"), "{error}");
    }
}
