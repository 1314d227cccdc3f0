//! Actors of other machines: only an actor that the run has invited joins, and its steps teach
//! the same policies.

use std::fs;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc::{Sender, channel};
use std::thread;
use std::time::Duration;

use lab::actors::actor::serve;
use lab::actors::coordinate::{Coordinator, Notice, Watch};
use lab::actors::door::Door;
use lab::actors::remote::connect;
use lab::actors::tally::ActorsTally;
use lab::actors::tls::{CertifiedKey, Invitation, ListenerKeys, joining};
use lab::stop::Stop;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::json;
use supervisor::machine::signals::pause;
use tempfile::TempDir;

use crate::small_training::{BLOCK, clock, config};

const STEPS: u64 = 3 * BLOCK;
/// The identity in the actor's certificate.
const PEER: &str = "00112233445566778899aabbccddeeff";

macro_rules! pem {
    ($name:literal) => {
        include_str!(concat!("tls/", $name, ".pem")).to_string()
    };
}

macro_rules! certified {
    ($name:literal, $key:literal) => {
        CertifiedKey {
            certificate: pem!($name),
            key: pem!($key),
        }
    };
}

/// A learner with a port, in a folder of its own.
struct Learner {
    place: TempDir,
    coordinator: Coordinator,
    address: SocketAddr,
}

fn write_private(path: &Path, text: &str) {
    fs::write(path, text).expect("written");
    fs::set_permissions(path, fs::Permissions::from_mode(0o600)).expect("a mode");
}

fn revoke(keys: &Path, revoked: &[&str]) {
    let text = json!({"identity": "a run", "revoked": revoked, "secret": "not read"});
    write_private(keys, &text.to_string());
}

impl Learner {
    fn new(revoked: &[&str]) -> Learner {
        let place = TempDir::new().expect("a folder");
        let keys = place.path().join("keys.json");
        revoke(&keys, revoked);
        let keys = ListenerKeys {
            keys,
            identity: "a run".into(),
            authority: pem!("authority"),
            certificate: certified!("listener", "listener-key"),
        };
        let door = Door::open("127.0.0.1:0", keys).expect("a port");
        let address = door.address().expect("an address");
        let folder = place.path().join("learner");
        let coordinator = Coordinator::new(&config(), &folder, (0, Some(door)));
        Learner {
            coordinator: coordinator.expect("a learner"),
            place,
            address,
        }
    }

    fn keys(&self) -> PathBuf {
        self.place.path().join("keys.json")
    }

    /// An actor within this machine, which ends the training in any case.
    /// It begins when the result is dropped, so that those at the port come first.
    fn join_honest(&mut self) -> Sender<()> {
        let (own, mut theirs) = UnixStream::pair().expect("a pair of sockets");
        self.coordinator.join("here", own).expect("joined");
        let (held, begin) = channel();
        thread::spawn(move || {
            let _ = begin.recv();
            let _ = serve(&mut theirs, "");
        });
        held
    }

    fn train(mut self, mut look: impl FnMut(&[Notice])) -> (Vec<u8>, ActorsTally) {
        let folder = self.place.path().join("learner");
        let watch = Watch {
            clock,
            stop: &Stop::default(),
            look: &mut |notices, _| {
                look(notices);
                Ok(())
            },
        };
        let trained = self.coordinator.train((&folder, STEPS), watch);
        trained.expect("trained");
        let tally = self.coordinator.finish();
        let policy = fs::read(folder.join(format!("policies/{STEPS:08}.onnx")));
        (policy.expect("the last policy"), tally)
    }

    fn invitation(&self, certificate: CertifiedKey) -> Invitation {
        Invitation {
            role: "actor".into(),
            peer: PEER.into(),
            address: self.address.to_string(),
            authority: pem!("authority"),
            certificate,
        }
    }
}

/// The last policy of a learner whose actor is in this process.
fn expected() -> Vec<u8> {
    let mut learner = Learner::new(&[]);
    drop(learner.join_honest());
    learner.train(|_| {}).0
}

#[test]
fn an_invited_actor_teaches_the_same_policies() {
    let learner = Learner::new(&[]);
    let bundle = learner.place.path().join("actor.bundle");
    let text = json!({
        "run": "fleet", "role": "actor", "peer": PEER, "address": learner.address.to_string(),
        "authority": pem!("authority"),
        "certificate": {"certificate": pem!("actor"), "key": pem!("actor-key")},
    });
    write_private(&bundle, &text.to_string());
    let mut actor = Command::new(env!("CARGO_BIN_EXE_vlaps-lab"))
        .arg("actor")
        .arg(&bundle)
        .args(["--worlds", "2"])
        .env(
            "VLAPS_COMMIT",
            std::env::var("VLAPS_COMMIT").unwrap_or_default(),
        )
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .expect("it starts");
    let (policy, tally) = learner.train(|_| {});
    // It waits for another training.
    kill_process(Pid::from_child(&actor), Signal::TERM).expect("it lives");
    assert_eq!(actor.wait().expect("an end").code(), Some(1));
    assert!(policy == expected());
    assert!(tally.actors["actor 00112233"].episodes > 0, "{tally:?}");
    assert!(tally.refused.is_empty(), "{tally:?}");
}

#[test]
fn a_peer_that_was_not_invited_as_an_actor_is_refused_with_its_reason() {
    let expected = expected();
    let cases = [
        ("other role", certified!("view", "view-key"), PEER, &[][..]),
        (
            "no certificate",
            certified!("ended", "ended-key"),
            PEER,
            &[],
        ),
        (
            "no certificate",
            certified!("foreign", "foreign-key"),
            PEER,
            &[],
        ),
        (
            "other identity",
            certified!("actor", "actor-key"),
            "ffffffffffffffffffffffffffffffff",
            &[],
        ),
        ("revoked", certified!("actor", "actor-key"), PEER, &[PEER]),
    ];
    for (reason, certificate, identity, revoked) in cases {
        let mut learner = Learner::new(revoked);
        let held = learner.join_honest();
        let invitation = learner.invitation(certificate);
        let peer = thread::spawn(move || {
            let _held = held;
            let config = joining(&invitation).expect("a configuration");
            let mut line = connect(&invitation, &config)?;
            serve(&mut line, identity).map_err(std::io::Error::other_of)
        });
        let (policy, tally) = learner.train(|_| {});
        let told = peer.join().expect("a peer").expect_err(reason).to_string();
        // TLS itself refuses a certificate.
        let is_told = told.contains(&format!("the training refuses this actor: {reason}"));
        assert_eq!(is_told, reason != "no certificate", "{reason}: {told}");
        assert_eq!(tally.refused.get(reason), Some(&1), "{reason}: {tally:?}");
        assert!(policy == expected, "{reason}");
    }
}

/// An error of a connection, as one of the system.
trait OtherOf {
    fn other_of(broken: lab::actors::envelope::Broken) -> std::io::Error;
}

impl OtherOf for std::io::Error {
    fn other_of(broken: lab::actors::envelope::Broken) -> std::io::Error {
        std::io::Error::other(broken.to_string())
    }
}

#[test]
fn bytes_without_tls_reach_no_frame() {
    let mut learner = Learner::new(&[]);
    let held = learner.join_honest();
    let address = learner.address;
    let peer = thread::spawn(move || {
        let _held = held;
        let mut stream = TcpStream::connect(address).expect("connected");
        stream
            .write_all(b"VLAC\x01\x00\x01\x00 without TLS")
            .expect("sent");
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
    });
    let (_, tally) = learner.train(|_| {});
    peer.join().expect("a peer");
    assert_eq!(tally.refused.get("no certificate"), Some(&1), "{tally:?}");
}

/// Peers that connect and say nothing, more of them than there are handshakes at a time.
#[test]
fn silent_peers_keep_no_actor_out() {
    let learner = Learner::new(&[]);
    let silent: Vec<_> = (0..100)
        .map(|_| TcpStream::connect(learner.address).expect("connected"))
        .collect();
    let invitation = learner.invitation(certified!("actor", "actor-key"));
    let peer = thread::spawn(move || {
        let config = joining(&invitation).expect("a configuration");
        let mut line = connect(&invitation, &config).expect("connected");
        serve(&mut line, &invitation.peer).is_ok()
    });
    let is_open = |peer: &TcpStream| {
        peer.set_nonblocking(true).expect("a mode");
        let waits = std::io::ErrorKind::WouldBlock;
        peer.peek(&mut [0])
            .is_err_and(|error| error.kind() == waits)
    };
    let mut open = None;
    let (policy, tally) = learner.train(|notices| {
        if notices
            .iter()
            .any(|notice| matches!(notice, Notice::News(_)))
        {
            open.get_or_insert(silent.iter().filter(|peer| is_open(peer)).count());
        }
    });
    assert!(peer.join().expect("a peer"));
    assert!(policy == expected());
    // When the actor joined, the others of the newest 64 had not been waited for.
    assert_eq!(open, Some(63), "{tally:?}");
    drop(silent);
}

#[test]
fn a_revoked_invitation_ends_its_connection() {
    let expected = expected();
    let mut learner = Learner::new(&[]);
    let mut held = Some(learner.join_honest());
    let invitation = learner.invitation(certified!("actor", "actor-key"));
    let peer = thread::spawn(move || {
        let config = joining(&invitation).expect("a configuration");
        let mut line = connect(&invitation, &config).expect("connected");
        serve(&mut line, &invitation.peer).is_err()
    });
    let (keys, first) = (
        learner.keys(),
        learner
            .place
            .path()
            .join(format!("learner/policies/{BLOCK:08}.onnx")),
    );
    let mut is_revoked = false;
    let (policy, tally) = learner.train(|notices| {
        if notices
            .iter()
            .any(|notice| matches!(notice, Notice::News(_)))
        {
            // The first one that has joined is the one at the port.
            held = None;
        }
        if !is_revoked && first.exists() {
            is_revoked = true;
            revoke(&keys, &[PEER]);
            // The learner reads the keys every two seconds.
            pause(Duration::from_millis(2100));
        }
    });
    assert!(peer.join().expect("a peer"), "it was ended");
    assert_eq!(tally.refused.get("revoked"), Some(&1), "{tally:?}");
    assert!(policy == expected);
}

#[test]
fn an_actor_drives_for_no_other_learner_than_the_one_that_invited_it() {
    let mut learner = Learner::new(&[]);
    let held = learner.join_honest();
    let invitation = Invitation {
        // As if another machine had the learner's address.
        authority: pem!("foreign"),
        ..learner.invitation(certified!("actor", "actor-key"))
    };
    let peer = thread::spawn(move || {
        let _held = held;
        let config = joining(&invitation).expect("a configuration");
        let mut line = connect(&invitation, &config).expect("connected");
        serve(&mut line, &invitation.peer).is_err()
    });
    let (_, tally) = learner.train(|_| {});
    assert!(peer.join().expect("a peer"), "it refuses the learner");
    assert_eq!(tally.refused.get("no certificate"), Some(&1), "{tally:?}");
}
