//! The commands that invite and revoke, as a user starts them.

use std::process::{Child, Command, Stdio};

use serde_json::Value;

fn link(folder: &std::path::Path, words: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_vlaps-link"))
        .arg("link")
        .args(words)
        .current_dir(folder)
        .env("VLAPS_LINK_KEYS", folder.join("keys"))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .expect("it starts")
}

/// Each command reads and writes the whole file of keys; none undoes what another has done.
#[test]
fn commands_at_the_same_time_lose_no_change() {
    let folder = tempfile::tempdir().expect("a folder");
    let at_once = |children: Vec<Child>| {
        for mut child in children {
            assert!(child.wait().expect("it ends").success());
        }
    };
    let bundles: Vec<String> = (0..6).map(|k| format!("{k}.bundle")).collect();
    let invite = |out: &String| {
        let words = ["invite", "--run", "drive", "--as", "judge"];
        let more = ["--address", "127.0.0.1:7450", "--out", out];
        link(folder.path(), &[&words[..], &more].concat())
    };
    at_once(bundles.iter().map(invite).collect());
    let read = |path: &str| -> Value {
        let text = std::fs::read_to_string(folder.path().join(path)).expect("a file");
        serde_json::from_str(&text).expect("JSON")
    };
    let keys = read("keys/drive.json");
    for bundle in &bundles {
        assert_eq!(read(bundle)["identity"], keys["identity"], "{bundle}");
    }
    let peers: Vec<String> = (0..24).map(|k| format!("{k:032x}")).collect();
    let revoke = |peer: &String| link(folder.path(), &["revoke", "--run", "drive", peer]);
    at_once(peers.iter().map(revoke).collect());
    let keys = read("keys/drive.json");
    let revoked = keys["revoked"].as_array().expect("a list");
    assert_eq!(revoked.len(), peers.len());
}
