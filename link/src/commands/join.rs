//! `join`.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use shm_config::config::{Config, load};
use shm_config::secret;

use crate::arguments::{Join, address};
use crate::join::{Options, join};
use crate::keys::Bundle;
use crate::role::Role;

pub(super) fn join_run(arguments: &Join, stop: &AtomicBool) -> Result<u8, String> {
    let (path, target) = match (arguments.target.split_once('@'), &arguments.bundle) {
        (Some((run, at)), Some(bundle)) => (bundle.clone(), Some((run, at))),
        (None, None) => (PathBuf::from(&arguments.target), None),
        (Some(_), None) => return Err("RUN@HOST:PORT needs --bundle FILE, the invitation".into()),
        (None, Some(_)) => {
            return Err(
                "name the invitation once: as the argument, or RUN@HOST:PORT with --bundle".into(),
            );
        }
    };
    let bundle = Bundle::read(&path).map_err(|error| error.to_string())?;
    let invited = bundle.role().map_err(|error| error.to_string())?;
    if invited == Role::Actor {
        let path = path.display();
        return Err(format!(
            "{path}: is an invitation of an actor: ./vlaps actor {path}"
        ));
    }
    if arguments
        .role
        .as_ref()
        .is_some_and(|role| role != invited.word())
    {
        return Err(format!("{}: is an invitation as {invited}", path.display()));
    }
    if let Some((run, _)) = target.filter(|(run, _)| *run != bundle.run) {
        let (path, own) = (path.display(), &bundle.run);
        return Err(format!(
            "{path}: is an invitation of run '{own}', not of '{run}'"
        ));
    }
    let at = target.map_or(Ok(bundle.address.clone()), |(_, at)| address(at))?;
    let name = match &arguments.run {
        Some(name) => name.clone(),
        None => {
            let name = format!("{}-{invited}", bundle.run);
            name.parse()
                .map_err(|error| format!("{error}; choose one with --run NAME"))?
        }
    };
    let own = match &arguments.config {
        Some(path) => load(path).map_err(|error| error.to_string())?,
        None => Config::default(),
    };
    let key = secret::take_named(&own.vlm.key_env);
    key.map_err(|error| format!("the keys of the environment: {error}"))?;
    let options = Options {
        bundle,
        address: at,
        name,
        own,
    };
    join(&options, stop).map(|()| 0)
}
