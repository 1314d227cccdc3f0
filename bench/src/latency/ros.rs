//! The ROS bridge of a row, and the foreign messages that flood its router.

use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Stdio};

use anyhow::{Context, bail};

use super::beside;

/// Foreign messages a second.
const FLOOD_HZ: f64 = 10_000.0;
/// A row counts only if this share of the messages was sent that its rate and duration give:
/// the programs begin a moment after the set does, and a loaded machine is slow.
const LEAST_SHARE: f64 = 0.5;
/// Messages of the bridge for each tick of the controller: those that a step becomes. With the
/// other topics it sends 14 in the mean.
const BRIDGE_PER_TICK: f64 = 7.0;
/// How the programs are built.
const HINT: &str = "build it with cargo build --release --manifest-path ros/Cargo.toml --bins \
                    --examples --target-dir target";

/// The bridge of a row and the flood. Both end when it is dropped.
pub struct RowRos {
    programs: Vec<Child>,
}

impl RowRos {
    /// Starts a router that is flooded, subscribes to all that the bridge has, and starts the
    /// bridge of a run; `None` if it is not wanted.
    ///
    /// # Errors
    /// If the programs are not built.
    pub fn start(wanted: bool, (run, folder): (&str, &Path)) -> anyhow::Result<Option<Self>> {
        if !wanted {
            return Ok(None);
        }
        let router = {
            let free = TcpListener::bind("127.0.0.1:0")?;
            format!("tcp/{}", free.local_addr()?)
        };
        let settings = folder.join(format!("{run}-ros.toml"));
        std::fs::write(&settings, format!("router = {router:?}\n"))?;
        let release = std::env::current_exe()?;
        let flood = format!("flood={FLOOD_HZ}");
        let stand_in = release.with_file_name("examples").join("stand_in");
        let bridge = release.with_file_name("vlaps-ros");
        let mut row = Self {
            programs: Vec::new(),
        };
        let words = [router.as_str(), &flood, "subscribe"];
        for (program, words) in [(stand_in, &words[..]), (bridge, &[run][..])] {
            if !program.is_file() {
                bail!("{}: is missing; {HINT}", program.display());
            }
            let mut command = beside(&program.to_string_lossy());
            command.args(words).env("VLAPS_ROS", &settings);
            command.stdin(Stdio::null()).stdout(Stdio::piped());
            let child = command.stderr(Stdio::piped()).spawn();
            row.programs.push(child.context("cannot start it")?);
        }
        Ok(Some(row))
    }

    /// Ends both, and checks by their own counts that there were messages beside the set.
    ///
    /// # Errors
    /// If one has failed, or fewer messages passed than a set at this rate for these seconds
    /// and the flood give.
    pub fn finish(mut self, (rate_hz, seconds): (f64, f64)) -> anyhow::Result<()> {
        let (mut lines, mut names) = (Vec::new(), ["the flood", "the bridge"].into_iter());
        // One by one: after an error, dropping this row ends the others.
        while !self.programs.is_empty() {
            let name = names.next().unwrap_or("a program");
            let line = last_line(self.programs.remove(0));
            lines.push(line.with_context(|| format!("{name} of the row"))?);
        }
        let [flood, bridge] = lines.as_slice() else {
            bail!("no flood and bridge ran");
        };
        for (line, what, of_hz) in [
            (flood, " foreign messages sent", FLOOD_HZ),
            (bridge, " messages sent", rate_hz * BRIDGE_PER_TICK),
            (flood, " others heard", rate_hz),
        ] {
            let least = of_hz * seconds * LEAST_SHARE;
            let count = count(line, what).with_context(|| format!("no count of{what}: {line}"))?;
            if (count as f64) < least {
                bail!("{count}{what} during the row, where {least} is the least: {line}");
            }
        }
        Ok(())
    }
}

/// Ends a program, if it has not ended by itself, and gives the last line that it printed. The
/// bridge ends with its set.
fn last_line(mut program: Child) -> anyhow::Result<String> {
    end(&mut program)?;
    let output = program.wait_with_output()?;
    let lines = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    if !output.status.success() {
        let (status, told) = (output.status, lines(&output.stderr));
        bail!("{status}: {}", told.lines().last().unwrap_or_default());
    }
    let printed = lines(&output.stdout);
    Ok(printed.lines().last().unwrap_or_default().into())
}

/// The number before some words of a line.
fn count(line: &str, words: &str) -> Option<u64> {
    let (before, _) = line.split_once(words)?;
    before.rsplit(' ').next()?.parse().ok()
}

/// Asks a program to end.
fn end(program: &mut Child) -> std::io::Result<()> {
    if program.try_wait()?.is_none() {
        // Ours, and not waited for yet: the id is its own.
        let pid = rustix::process::Pid::from_child(program);
        let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
    }
    Ok(())
}

impl Drop for RowRos {
    fn drop(&mut self) {
        for mut program in self.programs.drain(..) {
            if end(&mut program).is_ok() {
                let _ = program.wait();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    /// Programs that have ended.
    fn row(flood: &str, bridge: &str) -> RowRos {
        let child = |script: &str| {
            let mut command = Command::new("sh");
            command.args(["-c", script]).stdout(Stdio::piped());
            let mut child = command.stderr(Stdio::piped()).spawn().expect("a shell");
            child.wait().expect("its end");
            child
        };
        RowRos {
            programs: vec![child(flood), child(bridge)],
        }
    }

    fn told(flood: &str, bridge: &str) -> String {
        let finished = row(flood, bridge).finish((100.0, 10.0));
        finished.map_or_else(|error| format!("{error:#}"), |()| "counted".into())
    }

    const FLOOD: &str = "echo '10.0 s: 100000 foreign messages sent, 900 others heard'";
    const BRIDGE: &str = "echo '14400 messages sent, 0 refused'";

    #[test]
    fn a_row_whose_bridge_or_flood_was_not_there_is_refused() {
        assert_eq!(told(FLOOD, BRIDGE), "counted");
        let tenth = "echo '1440 messages sent, 0 refused'";
        assert!(told(FLOOD, tenth).contains("1440 messages sent during the row"));
        let silent = "echo '0 messages sent, 0 refused'";
        assert!(told(FLOOD, silent).contains("0 messages sent during the row"));
        assert!(told(FLOOD, "exit 0").contains("no count of messages sent"));
        let alone = "echo '10.0 s: 100000 foreign messages sent, 0 others heard'";
        assert!(told(alone, BRIDGE).contains("0 others heard during the row"));
        let slow = "echo '10.0 s: 400 foreign messages sent, 900 others heard'";
        assert!(told(slow, BRIDGE).contains("400 foreign messages sent"));
        let taken = "echo 'the port is taken' >&2; exit 1";
        let told = told(taken, BRIDGE);
        assert!(
            told.contains("the flood") && told.contains("the port is taken"),
            "{told}"
        );
    }

    #[test]
    fn after_a_failed_flood_the_bridge_ends_too() {
        let mut row = row("echo 'the port is taken' >&2; exit 1", "exit 0");
        let mut waits = Command::new("sleep");
        let waits = waits.arg("600").stdout(Stdio::piped()).spawn();
        row.programs[1] = waits.expect("a program");
        let pid = rustix::process::Pid::from_child(&row.programs[1]);
        assert!(row.finish((100.0, 10.0)).is_err());
        // It is waited for, so that its id is free.
        assert!(rustix::process::test_kill_process(pid).is_err());
    }

    #[test]
    fn a_program_that_runs_is_asked_to_end_and_then_says_its_count() {
        // It waits until it is asked.
        let waits =
            format!("trap \"{BRIDGE}; exit 0\" TERM; echo up; while :; do sleep 0.02; done");
        let mut command = Command::new("sh");
        command.args(["-c", &waits]).stdout(Stdio::piped());
        let mut program = command.stderr(Stdio::piped()).spawn().expect("a shell");
        let mut up = [0; 3];
        let out = program.stdout.as_mut().expect("a pipe");
        std::io::Read::read_exact(out, &mut up).expect("it is up");
        let line = last_line(program).expect("a line");
        assert_eq!(count(&line, " messages sent"), Some(14_400), "{line}");
    }
}
