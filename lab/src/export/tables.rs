//! Tables and datasets of a recording. The Python package writes them: pyarrow knows Parquet
//! and Arrow, while the Rust crate `parquet` alone adds 17 packages to the lock file.

use std::process::{Command, ExitCode};

use supervisor::cli::failure::Failure;
use supervisor::machine::programs::own_folder;

use super::{Export, Format};

/// Runs `python -m vlaps.tables` of the package that `./vlaps setup python` installs.
///
/// # Errors
/// When the package is not installed, or cannot be started.
pub fn export(task: &Export) -> anyhow::Result<ExitCode> {
    let release = own_folder()?;
    let target = release.parent().unwrap_or(&release);
    let python = target.join("python/bin/python");
    if !python.is_file() {
        return Err(Failure::Usage(format!(
            "{}: no such file; tables are written by the Python package: ./vlaps setup python \
             installs it",
            python.display()
        ))
        .into());
    }
    let word = match task.format {
        Format::Parquet => "parquet",
        Format::Arrow => "arrow",
        Format::Minari => "minari",
        Format::Lerobot => "lerobot",
        Format::Animation => return Err(anyhow::anyhow!("an animation is no table")),
    };
    let mut command = Command::new(&python);
    command.args(["-m", "vlaps.tables"]).arg(&task.recording);
    command.args(["--format", word, "--from", &task.from.to_string()]);
    if let Some(to) = task.to {
        command.args(["--to", &to.to_string()]);
    }
    if let Some(out) = &task.out {
        command.arg("--out").arg(out);
    }
    for topic in &task.topics {
        command.args(["--topic", topic]);
    }
    let status = command
        .status()
        .map_err(|error| Failure::GivenUp(format!("{}: {error}", python.display())))?;
    // Stopped by a signal it has no code.
    let code = status.code().and_then(|code| u8::try_from(code).ok());
    Ok(ExitCode::from(code.unwrap_or(1)))
}
