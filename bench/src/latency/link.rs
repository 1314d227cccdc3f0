//! The judge of a row that joins over the network, as from another machine.

use std::ffi::OsString;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use anyhow::{Context, bail};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use super::beside;
use crate::driven::name_of;

/// Advice that a row has to receive in a second, if no rate of ticks is less: a judge that is
/// not there would cost nothing.
const ADVICE_HZ: f64 = 10.0;
/// A row counts only if it has this share of the advice: the judge joins a moment after the
/// set has begun.
const LEAST_SHARE: f64 = 0.5;
/// The folder of the keys, which is another one than the user's own.
const KEYS: &str = "VLAPS_LINK_KEYS";
/// How the program is built.
const HINT: &str = "./vlaps setup link builds it";

/// How long the judge elsewhere is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RemoteJudge {
    /// There is none.
    Absent,
    /// For the whole row.
    Joined,
    /// Until half of the row; then its connection stays open and silent.
    FallsSilent,
}

/// The judge of a row: an invitation, and then the process that joins with it. It ends when
/// this value is dropped.
pub struct RowLink {
    remote: RemoteJudge,
    folder: PathBuf,
    run: String,
    address: String,
    joined: Option<Child>,
    is_silent: bool,
}

impl RowLink {
    /// Makes keys and an invitation for a run that is not started yet; `None` if no judge is
    /// wanted.
    ///
    /// # Errors
    /// If the program is not built, or makes no invitation.
    pub fn invite(
        remote: RemoteJudge,
        (run, scratch): (&str, &Path),
    ) -> anyhow::Result<Option<Self>> {
        if remote == RemoteJudge::Absent {
            return Ok(None);
        }
        let address = {
            let free = TcpListener::bind("127.0.0.1:0")?;
            free.local_addr()?.to_string()
        };
        let row = Self {
            remote,
            folder: scratch.join(format!("{run}-link")),
            run: name_of(run),
            address,
            joined: None,
            is_silent: false,
        };
        std::fs::create_dir_all(&row.folder)?;
        let program = program()?;
        let mut command = Command::new(&program);
        command.args(["link", "invite", "--as", "judge", "--run", &row.run]);
        command.args(["--address", &row.address, "--out"]);
        command.arg(row.bundle()).env(KEYS, row.keys());
        let made = command.stdin(Stdio::null()).output();
        let made = made.with_context(|| program.display().to_string())?;
        if !made.status.success() {
            let told = String::from_utf8_lossy(&made.stderr).into_owned();
            bail!("no invitation: {}", told.lines().last().unwrap_or_default());
        }
        Ok(Some(row))
    }

    fn bundle(&self) -> PathBuf {
        self.folder.join("judge.bundle")
    }

    fn keys(&self) -> OsString {
        self.folder.join("keys").into()
    }

    /// Arguments of `./vlaps up`.
    pub fn arguments(&self) -> Vec<String> {
        arguments(&self.address)
    }

    /// What the set needs in its environment.
    pub fn environment(&self) -> (&'static str, OsString) {
        (KEYS, self.keys())
    }

    /// Joins the run, which has been started.
    ///
    /// # Errors
    /// If the program cannot be started.
    pub fn join(&mut self) -> anyhow::Result<()> {
        let mut command = beside(&program()?.to_string_lossy());
        let own = format!("{}j", self.run);
        command.arg("join").arg(self.bundle()).args(["--run", &own]);
        command.env(KEYS, self.keys()).current_dir(&self.folder);
        command.stdin(Stdio::null()).stdout(Stdio::null());
        let joined = command.stderr(Stdio::null()).spawn();
        self.joined = Some(joined.context("cannot start vlaps-link")?);
        Ok(())
    }

    /// Called at half of the row: a judge of `FallsSilent` stops.
    pub fn half_way(&mut self) {
        if self.remote == RemoteJudge::FallsSilent && !self.is_silent {
            self.is_silent = true;
            self.signal(Signal::STOP);
        }
    }

    fn signal(&self, signal: Signal) {
        if let Some(joined) = &self.joined {
            let _ = kill_process(Pid::from_child(joined), signal);
        }
    }

    /// Checks by the report in the run's folder that there was advice from elsewhere. To be
    /// called after the set's end.
    ///
    /// # Errors
    /// If the report is missing, or says less than a judge gives in this time.
    pub fn check(&self, run: &Path, (rate_hz, seconds): (f64, f64)) -> anyhow::Result<()> {
        let path = run.join("link-judge.json");
        let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        let report: Value = serde_json::from_str(&text).context("the link's report")?;
        let advice = &report["peers"][0]["rows"]["advice"]["received"]["messages"];
        let share = match self.remote {
            RemoteJudge::FallsSilent => LEAST_SHARE / 2.0,
            RemoteJudge::Absent | RemoteJudge::Joined => LEAST_SHARE,
        };
        let least = rate_hz.min(ADVICE_HZ) * seconds * share;
        let count = advice.as_f64().unwrap_or(0.0);
        if count < least {
            bail!("{count} advices from elsewhere during the row, where {least} is the least");
        }
        Ok(())
    }
}

impl Drop for RowLink {
    fn drop(&mut self) {
        // Its gate ends with it, so that it is asked first; a stopped process hears nothing.
        self.signal(Signal::TERM);
        self.signal(Signal::CONT);
        if let Some(mut joined) = self.joined.take() {
            let _ = joined.wait();
        }
    }
}

/// Arguments of `./vlaps up` for a judge elsewhere.
fn arguments(address: &str) -> Vec<String> {
    ["--judge", address].map(String::from).to_vec()
}

impl RemoteJudge {
    /// Arguments of `./vlaps up` with a placeholder for the address; `None` without a judge
    /// elsewhere.
    pub fn arguments(self) -> Option<Vec<String>> {
        (self != Self::Absent).then(|| arguments("127.0.0.1:7447"))
    }
}

fn program() -> anyhow::Result<PathBuf> {
    let program = std::env::current_exe()?.with_file_name("vlaps-link");
    match program.is_file() {
        true => Ok(program),
        false => bail!("{}: is missing; {HINT}", program.display()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_without_advice_from_elsewhere_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let row = |remote| RowLink {
            remote,
            folder: folder.path().into(),
            run: "row".into(),
            address: String::new(),
            joined: None,
            is_silent: false,
        };
        let told = |remote, report: &str| {
            std::fs::write(folder.path().join("link-judge.json"), report).expect("a report");
            let checked = row(remote).check(folder.path(), (100.0, 20.0));
            checked.map_err(|error| format!("{error:#}"))
        };
        let report = |count: u32| {
            let received = serde_json::json!({ "received": { "messages": count } });
            serde_json::json!({ "peers": [{ "rows": { "advice": received } }] }).to_string()
        };
        use RemoteJudge::{FallsSilent, Joined};
        assert_eq!(told(Joined, &report(100)), Ok(()));
        let few = told(Joined, &report(99)).expect_err("too few");
        assert!(few.contains("99 advices"), "{few}");
        assert_eq!(told(FallsSilent, &report(50)), Ok(()));
        assert!(told(FallsSilent, &report(49)).is_err());
        assert!(told(Joined, r#"{"peers":[]}"#).is_err());
        assert!(told(Joined, "{").is_err());
        std::fs::remove_file(folder.path().join("link-judge.json")).expect("it is there");
        assert!(row(Joined).check(folder.path(), (100.0, 20.0)).is_err());
    }

    #[test]
    fn a_judge_that_has_fallen_silent_ends_with_its_row() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut waits = Command::new("sleep");
        let joined = waits.arg("600").spawn().expect("a program");
        let pid = Pid::from_child(&joined);
        let mut row = RowLink {
            remote: RemoteJudge::FallsSilent,
            folder: folder.path().into(),
            run: "row".into(),
            address: String::new(),
            joined: Some(joined),
            is_silent: false,
        };
        row.half_way();
        drop(row);
        // It is waited for, so that its id is free.
        assert!(rustix::process::test_kill_process(pid).is_err());
    }
}
