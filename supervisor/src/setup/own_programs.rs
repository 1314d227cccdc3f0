//! Programs of a user in place of those of the build.

use std::path::{Path, PathBuf};

use rustix::fs::{Access, access};
use shm_config::config::Config;
use shm_config::services::Process;
use shm_config::text::printable;

use crate::cli::failure::Failure;
use crate::machine::programs::binaries;
use crate::set::launch::Program;
use crate::setup::foreign::Foreign;

/// The processes that may be a user's program.
const REPLACEABLE: [Process; 3] = [Process::World, Process::Planner, Process::Gate];

/// The programs of a run that are not those of the build: the user's, those that stand for
/// processes of other machines, and a simulator that is not the built-in one.
///
/// # Errors
/// When one of them cannot be started.
pub fn of_run(config: &Config) -> Result<Vec<Program>, Failure> {
    let mut programs = of(config)?;
    programs.extend(of_link(config)?);
    let has_world = config.programs.of(Process::World).is_some();
    if let (false, Some(foreign)) = (has_world, Foreign::of(config.world.simulator)) {
        programs.push(foreign.world()?);
    }
    Ok(programs)
}

/// The programs that stand in the place of processes on other machines.
fn of_link(config: &Config) -> Result<Vec<Program>, Failure> {
    let mut programs = Vec::new();
    for process in [Process::Gate, Process::Learner] {
        let Some((name, _)) = config.link.of(process) else {
            continue;
        };
        let path = binaries()?.join(name);
        check(&path).map_err(|why| {
            let shown = path.display();
            Failure::Usage(format!("{shown}: {why}; `./vlaps setup link` builds it"))
        })?;
        programs.push(Program {
            process,
            path,
            script: None,
        });
    }
    Ok(programs)
}

/// The user's programs of a run.
///
/// # Errors
/// When one of them cannot be started.
fn of(config: &Config) -> Result<Vec<Program>, Failure> {
    let given = REPLACEABLE
        .iter()
        .filter_map(|process| Some((*process, config.programs.of(*process)?)));
    given
        .map(|(process, path)| {
            check(path)
                .map_err(|why| Failure::Usage(format!("programs.{process} = {path:?}: {why}")))?;
            Ok(Program {
                process,
                path: path.into(),
                script: None,
            })
        })
        .collect()
}

/// The absolute path of the program that an option names.
///
/// # Errors
/// When it cannot be started.
pub fn of_option(option: &str, path: &Path) -> Result<String, Failure> {
    let failed = |why: String| {
        let shown = path.display().to_string();
        Failure::Usage(format!("{option} {}: {why}", printable(&shown)))
    };
    check(path).map_err(failed)?;
    // Not canonical: a program that is a link may look at its own name.
    let whole: PathBuf = std::path::absolute(path).map_err(|error| failed(error.to_string()))?;
    let text = whole.to_str().map(String::from);
    text.ok_or_else(|| failed("its name is no UTF-8".into()))
}

/// Whether a file can be executed; why not, in words.
fn check(path: &Path) -> Result<(), String> {
    let metadata = path.metadata().map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => "there is no such file".into(),
        _ => error.to_string(),
    })?;
    if !metadata.is_file() {
        return Err("is not a file; name the program itself".into());
    }
    match access(path, Access::EXEC_OK) {
        Ok(()) => Ok(()),
        Err(_) => Err("is not executable; chmod +x makes it so".into()),
    }
}
