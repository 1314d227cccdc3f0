//! Programs in C and C++ that join: what is refused, with its reason. This test is their
//! supervisor: it publishes the roster that names them.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use crate::languages::{compile, example_in_cpp, has_compiler, has_python, in_python};
use shm_config::config::Config;
use shm_config::layout::Layout;
use shm_config::message::{Header, Message, Observation, Refusal, Roster};
use shm_config::run::{RunName, RunPaths};
use shm_config::services::{OBSERVATION, Process, ROSTER, Service};
use shm_config::wire::Wire;
use vlaps::description::{CONSTANTS, layout_with, lists};
use vlaps_tests::until;

/// A run without a supervisor; its folder is removed with it.
struct Run {
    name: RunName,
    wire: Option<Wire>,
    config: PathBuf,
    folder: tempfile::TempDir,
}

impl Run {
    fn new(label: &str) -> Self {
        let name = format!("t{}-{label}", std::process::id());
        let folder = tempfile::tempdir().expect("a folder");
        let mut config = Config::default();
        config.run.name.clone_from(&name);
        // Two instants of the world in each tick of the run.
        config.world.rate_hz = 2.0 * config.run.rate_hz;
        let text = toml::to_string(&config).expect("TOML");
        let name: RunName = name.parse().expect("a run name");
        let path = folder.path().join("vlaps.toml");
        fs::write(&path, text).expect("a configuration");
        Self {
            wire: Some(Wire::join(&name, Process::Supervisor).expect("shared memory")),
            name,
            config: path,
            folder,
        }
    }

    fn wire(&self) -> &Wire {
        self.wire.as_ref().expect("joined")
    }

    /// Starts a program as a planner, names it, and waits for its end.
    fn planner(&self, program: &Path) -> Output {
        self.process(Process::Planner, program, || {})
    }

    /// Starts a program as a process, names it, and looks on until its end.
    fn process(&self, process: Process, program: &Path, look: impl FnMut()) -> Output {
        let mut child = Command::new(program)
            .arg("--config")
            .arg(&self.config)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("it starts");
        self.name_until_its_end((process, &mut child), look);
        child.wait_with_output().expect("its end")
    }

    fn name_until_its_end(&self, (process, child): (Process, &mut Child), mut look: impl FnMut()) {
        let mut port = self.wire().publisher(ROSTER).expect("a place");
        let mut roster = Roster::default();
        roster.set(process, Some(child.id()));
        until("the program ends", || {
            port.update_connections();
            port.send(&mut roster);
            look();
            child.try_wait().expect("its state").is_some()
        });
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        self.wire = None;
        let paths = RunPaths::new(self.name.clone());
        // A compiler that another test starts shares this process's locks until it executes.
        until("the run is removed", || {
            !matches!(paths.clean_if_dead(), Ok(None))
        });
        paths.remove_dir();
    }
}

fn source(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign");
    folder.join(name)
}

fn said(output: &Output) -> String {
    let [out, err] = [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text));
    format!("{out}{err}")
}

#[test]
fn a_world_ends_no_episode_as_it_begins_and_each_observation_says_when_it_was_published() {
    if !has_compiler() {
        return;
    }
    let run = Run::new("world");
    let outside = Wire::join(&run.name, Process::Learner).expect("shared memory");
    let mut observations = outside.every(OBSERVATION).expect("observations");
    let mut seen = Vec::new();
    let program = compile(run.folder.path(), &source("world.c"), &[]);
    let output = run.process(Process::World, &program, || {
        observations.update_connections();
        while let Some(observation) = observations.receive() {
            seen.push((observation.header.tick, observation.published_ns));
        }
    });
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    let is_quiet = |pair: &[(u64, u64)]| pair[0].0 == pair[1].0;
    assert!(seen.windows(2).any(is_quiet), "two of a tick: {seen:?}");
    for pair in seen.windows(2).filter(|pair| is_quiet(pair)) {
        assert_eq!(pair[0].1, pair[1].1, "that of the tick: {seen:?}");
    }
    assert!(seen.iter().all(|(_, at_ns)| *at_ns > 77), "{seen:?}");
}

#[test]
fn a_message_of_another_type_is_a_type_error_in_python() {
    if !has_python() {
        return;
    }
    let run = Run::new("types");
    let output = run.planner(&in_python(run.folder.path(), &source("types.py")));
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
}

#[test]
fn wrong_calls_and_values_are_refused_with_their_reason() {
    if !has_compiler() {
        return;
    }
    let run = Run::new("hostile");
    let output = run.planner(&compile(run.folder.path(), &source("hostile.c"), &[]));
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
}

/// A header of another source: one code differs, so the hash does.
#[test]
fn a_program_of_another_header_is_refused_with_both_hashes() {
    if !has_compiler() {
        return;
    }
    let run = Run::new("header");
    let ours = format!("{:016x}", vlaps::description::layout());
    let mut lists = lists();
    let list = lists.iter_mut().find(|list| list.name == "Outcome");
    let arrived = &mut list.expect("a list").words[1];
    assert_eq!(*arrived, ("arrived", 1));
    arrived.1 = 9;
    let theirs = format!("{:016x}", layout_with(&lists, &CONSTANTS));
    let header = vlaps::header::text()
        .replace(&ours, &theirs)
        .replace("OUTCOME_ARRIVED = 1,", "OUTCOME_ARRIVED = 9,");
    let other = run.folder.path().join("other");
    fs::create_dir(&other).expect("a folder");
    fs::write(other.join("vlaps.h"), header).expect("a header");
    // A header beside the one that includes it comes before the compiler's list.
    let wrapper = crate::languages::checkout().join("capi/include/vlaps.hpp");
    fs::copy(wrapper, other.join("vlaps.hpp")).expect("a header");
    let source = run.folder.path().join("older.cpp");
    let text = "#include <vlaps.hpp>\n\
        int main(int argc, char **argv) {\n\
        return vlaps::run(\"older\", [&] { vlaps::member run(\"planner\", argc, argv); });\n\
        }\n";
    fs::write(&source, text).expect("a source");
    let output = run.planner(&compile(run.folder.path(), &source, &[other]));
    let said = said(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains(&theirs) && said.contains(&ours), "{said}");
    assert_eq!(said.trim().lines().count(), 1, "{said}");
}

mod another_layout {
    use super::{Header, Message, Refusal};

    shm_config::message! {
        /// An observation of another build.
        pub struct Observation: 40 bytes, nested [Header] {
            /// As in every message.
            pub header: Header,
            /// Of that build alone.
            pub other: u64,
        }
    }

    impl Message for Observation {
        fn header(&self) -> &Header {
            &self.header
        }
        fn header_mut(&mut self) -> &mut Header {
            &mut self.header
        }
        fn check(&self) -> Result<(), Refusal> {
            Ok(())
        }
    }
}

#[test]
fn a_library_of_another_layout_than_the_run_is_refused_with_both_hashes() {
    if !has_compiler() {
        return;
    }
    let run = Run::new("library");
    let theirs: Service<another_layout::Observation> = Service::custom(
        OBSERVATION.name,
        OBSERVATION.from,
        OBSERVATION.row.wakes,
        OBSERVATION.row.delivery,
    );
    let _theirs = run.wire().publisher(theirs).expect("a place");
    let output = run.planner(&example_in_cpp(run.folder.path(), "planner"));
    let said = said(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    for hash in [
        another_layout::Observation::FINGERPRINT,
        Observation::FINGERPRINT,
    ] {
        assert!(said.contains(&format!("{hash:016x}")), "{said}");
    }
    assert!(said.contains("service 'observation'"), "{said}");
}
