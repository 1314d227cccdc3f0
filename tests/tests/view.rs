//! The page of a living set: it follows, survives the set's end and return, and neither
//! a stalled browser nor a hostile one delays the others.

#[allow(dead_code)] // the tests of recordings use the rest
#[path = "../../view/tests/browser/mod.rs"]
mod browser;
#[allow(dead_code)] // likewise
#[path = "../../view/tests/http/mod.rs"]
mod http;
#[allow(dead_code)] // likewise
#[path = "../../view/tests/viewer/mod.rs"]
mod viewer;

use std::cell::Cell;
use std::io::Write;
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::Command;

use browser::Browser;
use http::Page;
use recorder::Recording;
use rustix::process::Signal;
use viewer::{Viewer, pose};
use vlaps_tests::{Set, programs, until};

/// Real time with episodes without end.
const DRIVE: [&str; 4] = ["--seed", "3", "--episodes", "0"];

fn program() -> PathBuf {
    programs().join("vlaps-view")
}

fn show(set: &Set) -> Page {
    Page::start(
        &program(),
        set.folder(),
        &["--run", &set.name().to_string()],
    )
}

fn await_run(set: &Set) {
    until("the run lives", || set.paths().supervisor_pid().is_some());
}

fn tick(moment: &serde_json::Value) -> u64 {
    moment["scene"]["tick"].as_u64().unwrap_or(0)
}

#[test]
fn a_page_follows_a_set_through_its_end_and_its_return() {
    let mut set = Set::new("view");
    set.start(&DRIVE);
    await_run(&set);
    let page = show(&set);
    let mut events = page.follow();
    let hello = events.until("hello", |hello| !hello["run"].is_null());
    assert_eq!(hello["run"]["name"], set.name().to_string());
    let first = events.until("moment", |moment| tick(moment) > 0);
    let second = events.until("moment", |moment| tick(moment) > tick(&first) + 3);
    let scene = &second["scene"];
    assert_eq!(scene["driver"], "expert");
    assert!(
        scene["scan_m"]
            .as_array()
            .is_some_and(|scan| scan.len() == 240)
    );
    assert!(scene["plan"]["points"].as_array().is_some());
    assert_eq!(
        second["samples"][0]["command"].as_array().map(Vec::len),
        Some(2)
    );
    let status = events.until("status", |status| {
        let rows = status["histograms"].as_array();
        rows.is_some_and(|rows| rows.len() >= 6)
    });
    let processes = status["view"]["processes"].as_array().expect("processes");
    assert!(
        processes
            .iter()
            .any(|row| row["process"] == "controller" && row["pid"].is_u64())
    );
    assert!(
        page.json("tree")["ways"]
            .as_array()
            .is_some_and(|ways| !ways.is_empty())
    );
    // The set ends: the page says so, and nothing of the run stays on the machine.
    set.signal(Signal::TERM);
    assert_eq!(set.wait(), Some(0));
    let gone = events.until("hello", |hello| hello["run"].is_null());
    assert!(
        gone["note"]
            .as_str()
            .is_some_and(|note| note.contains("./vlaps up"))
    );
    until("its files are gone", || !set.paths().dir().exists());
    // It returns under its name.
    set.start(&DRIVE);
    let again = events.until("hello", |hello| !hello["run"].is_null());
    assert_ne!(again["run"]["supervisor"], hello["run"]["supervisor"]);
    events.until("moment", |moment| tick(moment) > 0);
}

#[test]
fn a_page_follows_the_restart_after_the_supervisor_was_killed() {
    let mut set = Set::new("viewkill");
    set.start(&DRIVE);
    await_run(&set);
    let page = show(&set);
    let mut events = page.follow();
    let hello = events.until("hello", |hello| !hello["run"].is_null());
    events.until("moment", |moment| tick(moment) > 0);
    set.signal(Signal::KILL);
    set.wait();
    until("the end of the set", || {
        !matches!(set.paths().clean_if_dead(), Ok(None))
    });
    // A reader that stays would keep the next set from starting.
    set.start(&DRIVE);
    let again = events.until("hello", |other| {
        let supervisor = &other["run"]["supervisor"];
        supervisor.is_u64() && *supervisor != hello["run"]["supervisor"]
    });
    assert_eq!(again["run"]["name"], set.name().to_string());
    events.until("moment", |moment| tick(moment) > 0);
}

#[test]
fn stalled_browsers_and_garbage_hold_up_no_other() {
    let mut set = Set::new("viewstall");
    set.start(&DRIVE);
    await_run(&set);
    let page = show(&set);
    // Pages that are never read, requests that never end.
    let stalled: Vec<_> = (0..10).map(|_| page.follow()).collect();
    let half: Vec<_> = (0..10)
        .map(|_| {
            let mut stream = TcpStream::connect(page.address()).expect("a connection");
            stream.write_all(b"GET / HTTP/1.1\r\nHost: ").expect("room");
            stream
        })
        .collect();
    for garbage in ["\0\u{1}\u{2}", "GET /stream\r\n", &"x".repeat(200_000)] {
        page.ask(garbage);
    }
    let mut events = page.follow();
    let first = events.until("moment", |moment| tick(moment) > 0);
    let (scenes, steps) = (Cell::new(0), Cell::new(0));
    let later = events.until("moment", |moment| {
        scenes.set(scenes.get() + u32::from(moment["scene"].is_object()));
        let samples = moment["samples"].as_array().into_iter().flatten();
        let shown: u64 = samples.filter_map(|sample| sample["steps"].as_u64()).sum();
        steps.set(steps.get() + shown);
        tick(moment) > tick(&first) + 50
    });
    let passed = tick(&later) - tick(&first);
    assert!(scenes.get() > 10, "{} scenes", scenes.get());
    drop((stalled, half));
    set.signal(Signal::TERM);
    assert_eq!(set.wait(), Some(0));
    let json = set.json();
    let controller = &json["processes"]["controller"];
    let (ticks, skipped) = (controller["ticks"].as_u64(), controller["skipped"].as_u64());
    let (ticks, skipped) = (ticks.unwrap_or(0), skipped.unwrap_or(u64::MAX));
    assert!(ticks > 50 && skipped < ticks / 5, "{controller}");
    // The page gets every tick that was not skipped.
    let shown = steps.get();
    assert!(
        shown <= passed && passed - shown <= skipped,
        "{shown} of {passed}"
    );
}

/// In lockstep the page changes nothing: the same commands, bit by bit.
#[test]
fn a_watched_run_in_lockstep_has_the_digest_of_an_unwatched_one() {
    let words = ["--lockstep", "--seed", "3", "--episodes", "10"];
    let alone = Set::new("viewalone");
    assert!(alone.run(&words).status.success());
    let mut watched = Set::new("viewed");
    let page = Page::start(&program(), watched.folder(), &[]);
    let mut events = page.follow();
    let waiting = events.until("hello", |_| true);
    assert!(waiting["run"].is_null(), "{waiting}");
    watched.start(&words);
    events.until("moment", |moment| moment["samples"][0]["tick"].is_u64());
    assert_eq!(watched.wait(), Some(0));
    assert_eq!(
        watched.json()["command_digest"],
        alone.json()["command_digest"]
    );
}

/// The page and the server for viewers open subscribers alone.
#[test]
fn a_watched_run_has_no_message_of_its_watchers() {
    let mut set = Set::new("viewer");
    set.start(&["--seed", "3", "--duration", "8", "--record", "rec"]);
    await_run(&set);
    let name = set.name().to_string();
    let told = set.folder().join("view.json");
    let path = told.to_string_lossy().into_owned();
    let words = ["--run", &name, "--foxglove", "0", "--json", &path];
    let page = Page::start(&program(), set.folder(), &words);
    let text = std::fs::read_to_string(&told).expect("the addresses");
    let told: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let url = told["foxglove"].as_str().expect("an address");
    let mut viewer = Viewer::connect(url, &[]).expect("a connection");
    // Rather a failure than a wait for a run that is over.
    viewer.patience(std::time::Duration::from_secs(30));
    viewer.subscribe(1, "/ros/pose");
    let mut places = Vec::new();
    while places.len() < 10 {
        let (_, _, cdr) = viewer.data().expect("a pose");
        let ([x, y], _, frame) = pose(&cdr);
        assert_eq!(frame, "map");
        places.push((x, y));
    }
    places.dedup();
    assert!(places.len() > 2, "the car moves: {places:?}");
    let mut events = page.follow();
    events.until("moment", |moment| tick(moment) > 0);
    assert_eq!(set.wait(), Some(0), "{}", set.logs());
    let recording = Recording::open(&set.folder().join("rec")).expect("a recording");
    let mut count = 0;
    for entry in recording.entries() {
        let entry = entry.expect("whole");
        let producer = entry.header().expect("a header").producer;
        assert_ne!(producer, page.pid(), "{}", entry.channel.service);
        count += 1;
    }
    assert!(count > 500, "{count}");
}

#[test]
fn the_name_of_a_run_that_does_not_live_is_refused_with_those_that_do() {
    let mut set = Set::new("viewname");
    set.start(&DRIVE);
    await_run(&set);
    let output = Command::new(program())
        .args(["view", "--run", "no-such-run", "--port", "0"])
        .current_dir(set.folder())
        .output()
        .expect("it runs");
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(text.contains(&set.name().to_string()), "{text}");
    assert_eq!(text.lines().count(), 1, "{text}");
}

#[test]
fn a_browser_follows_a_set_pauses_and_survives_its_end_and_return() {
    let Some(mut browser) = Browser::start() else {
        return;
    };
    let mut set = Set::new("viewpage");
    set.start(&DRIVE);
    await_run(&set);
    let page = show(&set);
    browser.look((1440, 900), "light");
    // A link points at a tick of a living run, too; times begin with the run.
    let mut events = page.follow();
    events.until("moment", |moment| tick(moment) > 15);
    browser.open(&format!("{}#tick=12", page.url));
    browser.until("document.getElementById('mode')?.textContent === 'paused'");
    browser.until("Math.abs(Number(document.getElementById('tick').textContent) - 12) <= 1");
    browser.until("Number(document.getElementById('time').textContent) <= 1.4");
    browser.press("l");
    browser.until("document.getElementById('mode')?.textContent === 'live'");
    browser.until("Number(document.getElementById('tick').textContent) > 20");
    assert_eq!(browser.text("run"), set.name().to_string());
    assert_eq!(browser.text("driver-name"), "expert");
    assert!(browser.colors("scene") > 50 && browser.colors("timeline") > 3);
    browser.until("document.querySelectorAll('#processes tbody tr').length >= 3");
    browser.until("document.querySelectorAll('.histogram canvas').length >= 2");
    // Paused, it stands; one step back, and on to the newest.
    browser.press(" ");
    browser.until("document.getElementById('mode').textContent === 'paused'");
    let tick: u64 = browser.text("tick").parse().expect("a tick");
    browser.press("ArrowLeft");
    browser.until(&format!(
        "Number(document.getElementById('tick').textContent) === {}",
        tick - 1
    ));
    browser.until(&format!("location.hash === '#tick={}'", tick - 1));
    browser.press("l");
    browser.until(&format!(
        "Number(document.getElementById('tick').textContent) > {}",
        tick + 5
    ));
    browser.press("t");
    browser.until(
        "performance.getEntriesByType('resource').some((one) => one.name.endsWith('/tree'))",
    );
    browser.press("t");
    if let Some(path) = std::env::var_os("VLAPS_VIEW_PICTURE") {
        browser.picture(&PathBuf::from(path));
    }
    set.signal(Signal::TERM);
    set.wait();
    browser.until("document.getElementById('mode').textContent === 'no run'");
    browser.until("!document.getElementById('none').hidden");
    set.start(&DRIVE);
    browser.until("document.getElementById('mode').textContent === 'live'");
    browser.until("Number(document.getElementById('tick').textContent) > 3");
    assert_eq!(browser.troubles, Vec::<String>::new());
}
