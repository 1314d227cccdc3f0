//! The policy that drives unchanged while a session records what `./vlaps relearn` learns from:
//! `policy.file`, where `learner.updates` is 0.

use std::io;
use std::path::Path;

use shm_config::config::Config;
use shm_config::file;
use shm_config::message::WEIGHTS_BYTES_MAX;

use crate::checkpoint::Checkpoint;
use crate::session::{inputs, named, policy_path};

/// The policy that drives unchanged, if there is one.
///
/// # Errors
/// When it cannot be read, is refused, or sees what the session would not record.
pub fn policy(config: &Config) -> io::Result<Option<Vec<u8>>> {
    let path = Path::new(&config.policy.file);
    if config.learner.updates > 0 || config.policy.file.is_empty() {
        return Ok(None);
    }
    let refused = |what: String| named(io::Error::new(io::ErrorKind::InvalidData, what), path);
    let bytes = file::read(path, WEIGHTS_BYTES_MAX as u64).map_err(|error| named(error, path))?;
    let policy = policy::decode(&bytes).map_err(|refusal| refused(refusal.to_string()))?;
    if policy.net.inputs() > inputs(config) {
        return Err(refused(
            "is told how the cars around it move, which would not be recorded; add --set \
             learner.motion=true"
                .into(),
        ));
    }
    Ok(Some(bytes))
}

/// The same; a session that goes on keeps the policy with which it began.
///
/// # Errors
/// As [`policy`], and when it is another policy.
pub(crate) fn same_policy(
    config: &Config,
    folder: &Path,
    state: &Checkpoint,
) -> io::Result<Option<Vec<u8>>> {
    let policy = policy(config)?;
    if let Some(policy) = &policy
        && state.blocks > 0
    {
        let driven = policy_path(folder, state.steps);
        let before =
            file::read(&driven, WEIGHTS_BYTES_MAX as u64).map_err(|error| named(error, &driven))?;
        if before != *policy {
            let what = format!(
                "{} is another policy than {}, which drove before",
                config.policy.file,
                driven.display()
            );
            return Err(io::Error::new(io::ErrorKind::InvalidData, what));
        }
    }
    Ok(policy)
}
