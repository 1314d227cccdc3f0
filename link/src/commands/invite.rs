//! `link invite`, `link revoke` and `link listener`.

use std::io::{self, IsTerminal as _};

use crate::arguments::{Invite, Listener, Revoke};
use crate::keys::{Identity, RunKeys, folder};
use crate::role::Role;
use crate::stand_in::clocks;

fn role(word: &str) -> Result<Role, String> {
    Role::from_word(word).ok_or_else(|| format!("there is no role {word}"))
}

pub(super) fn invite(arguments: &Invite) -> Result<u8, String> {
    let Invite { run, .. } = arguments;
    let role = role(&arguments.role)?;
    let failed = |error: io::Error| error.to_string();
    let held = RunKeys::hold(run).map_err(failed)?;
    let keys = match RunKeys::read(run).map_err(failed)? {
        Some(keys) => keys,
        None => {
            let keys = RunKeys::make(&run.to_string()).map_err(failed)?;
            keys.write(run).map_err(failed)?;
            let folder = folder().map_err(failed)?;
            println!("made the keys of run '{run}' in {}", folder.display());
            keys
        }
    };
    drop(held);
    let expires_epoch_s = clocks().1 + arguments.hours * 3600;
    let bundle = keys
        .invite(role, &arguments.address, expires_epoch_s)
        .map_err(failed)?;
    let out = arguments.out.display();
    bundle
        .write(&arguments.out)
        .map_err(|error| format!("{out}: {error}; choose a name that no file has"))?;
    let (peer, hours) = (bundle.peer, arguments.hours);
    let join = match role {
        Role::Actor => "actor",
        Role::Judge | Role::Learner | Role::View | Role::Recorder => "join",
    };
    println!(
        "{out}: an invitation for one {role}, {hours} h, peer {peer}\n\
         it holds a key: carry it as a secret, then on the other machine ./vlaps {join} {out}\n\
         to end it: ./vlaps link revoke --run {run} {peer}"
    );
    Ok(0)
}

pub(super) fn revoke(arguments: &Revoke) -> Result<u8, String> {
    let Revoke { run, peer } = arguments;
    let failed = |error: io::Error| error.to_string();
    let peer = Identity::try_from(peer.clone())?;
    let _held = RunKeys::hold(run).map_err(failed)?;
    let keys = RunKeys::read(run).map_err(failed)?;
    let mut keys = keys.ok_or_else(|| format!("run '{run}' has invited no peer"))?;
    if !keys.revoked.contains(&peer) {
        keys.revoked.push(peer);
        keys.write(run).map_err(failed)?;
    }
    println!("peer {peer} has no effect on run '{run}' any more");
    Ok(0)
}

/// Prints the certificate and the key with which a training listens for its actors, for the
/// program that asks: never into a terminal.
pub(super) fn listener(arguments: &Listener) -> Result<u8, String> {
    let run = &arguments.run;
    let failed = |error: io::Error| error.to_string();
    if io::stdout().is_terminal() {
        return Err("listener: prints a key, and only into another program".into());
    }
    let keys = RunKeys::read(run).map_err(failed)?;
    let keys = keys.ok_or_else(|| {
        format!("run '{run}' has invited no actor; ./vlaps link invite --run {run} --as actor does")
    })?;
    let printed = serde_json::json!({
        "keys": RunKeys::file(run).map_err(failed)?,
        "identity": keys.identity,
        "authority": keys.authority.certificate,
        "certificate": keys.authority.vehicle().map_err(failed)?,
    });
    println!("{printed}");
    Ok(0)
}
