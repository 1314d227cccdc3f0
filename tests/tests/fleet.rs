//! The page of all runs: it lists sets that come and go, says which need attention, and
//! opens the page of each.

#[allow(dead_code)] // the tests of one run use the rest
#[path = "../../view/tests/browser/mod.rs"]
mod browser;
#[allow(dead_code)] // likewise
#[path = "../../view/tests/http/mod.rs"]
mod http;

use std::fs;
use std::path::{Path, PathBuf};

use browser::Browser;
use http::{Events, Page};
use rustix::process::Signal;
use serde_json::Value;
use vlaps_tests::{Set, programs, until};

/// Real time with episodes without end.
const DRIVE: [&str; 4] = ["--seed", "3", "--episodes", "0"];

fn program() -> PathBuf {
    programs().join("vlaps-view")
}

fn show(folder: &Path, words: &[&str]) -> Page {
    let words: Vec<&str> = [&["--all"], words].concat();
    Page::start(&program(), folder, &words)
}

fn driving(label: &str) -> Set {
    let mut set = Set::new(label);
    set.start(&DRIVE);
    until("the run lives", || set.paths().supervisor_pid().is_some());
    set
}

/// The card of a set; null without one.
fn card(news: &Value, set: &Set) -> Value {
    let name = set.name().to_string();
    let mut runs = news["runs"].as_array().into_iter().flatten();
    runs.find(|run| run["name"] == name)
        .cloned()
        .unwrap_or_default()
}

/// Whether the run has drawn a scene, and drives.
fn drives(card: &Value) -> bool {
    let scene = card["scene"].as_str().unwrap_or_default();
    let scene: Value = serde_json::from_str(scene).unwrap_or_default();
    let is_live = ["live", "faulty", "skipping"]
        .iter()
        .any(|word| card["state"] == *word);
    is_live && scene["tick"].as_u64().is_some_and(|tick| tick > 0)
}

fn until_card(events: &mut Events, set: &Set, fits: impl Fn(&Value) -> bool) -> Value {
    let news = events.until("status", |news| fits(&card(news, set)));
    card(&news, set)
}

#[test]
fn runs_come_and_go_on_the_page_and_each_has_a_page_of_its_own() {
    let (mut first, second) = (driving("fleeta"), driving("fleetb"));
    let page = show(first.folder(), &[]);
    let mut events = page.follow();
    let hello = events.until("hello", |_| true);
    assert_eq!(hello["mode"], "fleet");
    let both = |news: &Value| drives(&card(news, &first)) && drives(&card(news, &second));
    let news = events.until("status", both);
    let shown = card(&news, &first);
    assert_eq!(shown["clock"], "real time");
    assert!(
        shown["machine"].is_null() && shown["episode"]["number"] == 1,
        "{shown}"
    );
    // The band has the driver's bit once the reader has looked a few times.
    until_card(&mut events, &first, |card| {
        let band = card["band"].as_array().into_iter().flatten();
        band.filter(|part| part.as_u64() != Some(0)).count() > 3
    });

    // The page of one run, under the same server.
    let below = format!("run/{}/", second.name());
    let answer = page.get(&below);
    assert!(
        answer.status == 200 && answer.text().contains("main.js"),
        "{}",
        answer.status
    );
    let moved = page.get(below.trim_end_matches('/'));
    assert!(moved.status == 308 && moved.head.contains(&format!("location: /{below}")));
    assert_eq!(page.get(&format!("{below}main.js")).status, 200);
    let mut one = page.follow_below(&below);
    let hello = one.until("hello", |hello| !hello["run"].is_null());
    assert_eq!(hello["run"]["name"], second.name().to_string());
    let moment = one.until("moment", |moment| {
        moment["scene"]["tick"].as_u64() > Some(0)
    });
    one.until("moment", |later| {
        later["scene"]["tick"].as_u64() > moment["scene"]["tick"].as_u64()
    });
    one.until("status", |status| status["view"]["processes"].is_array());
    // A page that is opened late is told the driver, too.
    let mut late = page.follow_below(&below);
    late.until("moment", |moment| {
        let drivers = moment["samples"][0]["drivers"].as_array();
        drivers.is_some_and(|drivers| !drivers.is_empty())
    });

    // One is killed: it is shown as ended, after all that live, and the other drives on.
    first.signal(Signal::KILL);
    first.wait();
    let news = events.until("status", |news| card(news, &first)["state"] == "ended");
    assert!(
        drives(&card(&news, &second)),
        "{}",
        card(&news, &second)["state"]
    );
    let names: Vec<_> = news["runs"]
        .as_array()
        .expect("runs")
        .iter()
        .map(|run| &run["name"])
        .collect();
    let place = |set: &Set| {
        names
            .iter()
            .position(|name| **name == set.name().to_string())
    };
    assert!(place(&second) < place(&first), "{names:?}");
    until("the end of the set", || {
        !matches!(first.paths().clean_if_dead(), Ok(None))
    });
    // It returns under its name.
    first.start(&DRIVE);
    until_card(&mut events, &first, drives);
}

#[test]
fn a_run_without_steps_is_shown_as_silent_within_two_seconds_and_recovers() {
    let set = driving("fleetmute");
    let page = show(set.folder(), &[]);
    let mut events = page.follow();
    until_card(&mut events, &set, drives);
    // Without its supervisor, which would start another controller.
    set.signal(Signal::STOP);
    assert_eq!(set.signal_program("vlaps-controller", Signal::STOP), 1);
    let silent = until_card(&mut events, &set, |card| {
        let age_s = card["age_s"].as_f64().unwrap_or(0.0);
        assert!(age_s < 2.0 || card["state"] == "silent", "{card}");
        card["state"] == "silent" && age_s >= 2.0
    });
    assert!(
        !silent["scene"].as_str().unwrap_or_default().is_empty(),
        "the last scene stays"
    );
    assert_eq!(set.signal_program("vlaps-controller", Signal::CONT), 1);
    set.signal(Signal::CONT);
    // The ticks that were skipped meanwhile ask for attention.
    until_card(&mut events, &set, |card| {
        drives(card) && card["skipped"].as_u64() > Some(0) && card["state"] != "live"
    });
}

#[test]
fn a_run_that_cannot_be_opened_is_a_card_that_says_why() {
    // A supervisor that has written no configuration.
    let set = Set::new("fleetshut");
    let paths = set.paths();
    let lock = paths.hold_supervisor().expect("a folder").expect("a lock");
    paths.open(&lock).expect("an open place");
    let page = show(set.folder(), &[]);
    let mut events = page.follow();
    let refused = until_card(&mut events, &set, |card| card["state"] == "refused");
    let note = refused["note"].as_str().unwrap_or_default();
    assert!(note.contains(&set.name().to_string()), "{refused}");
    drop(lock);
    until_card(&mut events, &set, |card| card["state"] == "ended");
}

#[test]
fn names_that_are_none_and_foreign_pages_are_refused() {
    let set = driving("fleethost");
    let page = show(set.folder(), &[]);
    let (host, _) = page.place();
    let (ours, name) = (format!("Host: {host}\r\n"), set.name().to_string());
    let status = |method: &str, path: &str, head: &str| {
        page.ask(&format!("{method} {path} HTTP/1.1\r\n{head}"))
            .status
    };
    let below = format!("/run/{name}/");
    assert_eq!(status("GET", &format!("{below}hello"), &ours), 200);
    for path in [
        "/run".into(),
        "/run/".into(),
        "/run//".into(),
        "/run/../run/".into(),
        "/run/../../etc/passwd".into(),
        "/run/./hello".into(),
        "/run/%2e%2e/hello".into(),
        format!("/run/%74{name}/"),
        "/run/a%2fb/".into(),
        "/run/a%00b/".into(),
        "/run/%3Cscript%3E/".into(),
        format!("/run/{}/", "a".repeat(300)),
        format!("/run/{}/", "../".repeat(80)),
        "/run/no-such-run/".into(),
        "/run/no-such-run".into(),
        format!("{below}../hello"),
        format!("{below}run/{name}/hello"),
        format!("{below}picture/..%2fx.png"),
        format!("{below}fleet"),
    ] {
        assert_eq!(status("GET", &path, &ours), 404, "{path}");
    }
    for foreign in [
        "Host: evil.example\r\n".to_string(),
        format!("{ours}Origin: http://evil.example\r\n"),
        format!("{ours}Origin: null\r\n"),
    ] {
        for path in ["/", "/stream", "/hello", &below, &format!("{below}stream")] {
            assert_eq!(status("GET", path, &foreign), 403, "{path} {foreign}");
        }
    }
    for method in ["POST", "PUT", "DELETE", "OPTIONS"] {
        assert_eq!(status(method, &below, &ours), 405, "{method}");
        assert_eq!(status(method, "/stream", &ours), 405, "{method}");
    }
    assert_eq!(page.get("hello").status, 200, "the server lives");
}

#[test]
fn behind_a_token_each_run_is_behind_it_too() {
    let set = driving("fleetkey");
    let page = show(set.folder(), &["--bind", "0.0.0.0"]);
    let (_, root) = page.place();
    assert!(root.len() > 30, "{root}");
    let below = format!("run/{}/", set.name());
    assert_eq!(page.get(&format!("{below}hello")).status, 200);
    let moved = page.get(below.trim_end_matches('/'));
    assert!(
        moved.head.contains(&format!("location: {root}{below}")),
        "{}",
        moved.head
    );
    let host = format!("Host: {}\r\n", page.address());
    for path in [
        "/".into(),
        "/stream".into(),
        format!("/{below}"),
        format!("/{below}hello"),
    ] {
        assert_eq!(
            page.ask(&format!("GET {path} HTTP/1.1\r\n{host}")).status,
            403,
            "{path}"
        );
    }
}

/// Threads of the page's process that read runs.
fn readers(page: &Page) -> usize {
    let tasks = fs::read_dir(format!("/proc/{}/task", page.pid()))
        .into_iter()
        .flatten();
    let names = tasks
        .flatten()
        .map(|task| fs::read_to_string(task.path().join("comm")));
    names
        .flatten()
        .filter(|name| name.trim() == "view-reader")
        .count()
}

#[test]
fn a_page_that_is_closed_lets_go_of_the_runs() {
    let set = driving("fleetleave");
    let page = show(set.folder(), &[]);
    assert_eq!(readers(&page), 0, "nothing is read before a page is open");
    let mut events = page.follow();
    until_card(&mut events, &set, drives);
    assert!(readers(&page) > 0);
    drop(events);
    until("no run is read", || readers(&page) == 0);
    // And takes them up again.
    let mut events = page.follow();
    until_card(&mut events, &set, drives);
}

#[test]
fn a_browser_shows_all_runs_filters_them_and_opens_one() {
    let Some(mut browser) = Browser::start() else {
        return;
    };
    let sets: Vec<Set> = ["fleetx", "fleety", "fleetz"].map(driving).into();
    let page = show(sets[0].folder(), &[]);
    browser.look((1440, 900), "dark");
    browser.open(&page.url);
    let named = |set: &Set| {
        format!(
            "[...document.querySelectorAll('.card')].find((card) => card.querySelector('h2 b').textContent === '{}')",
            set.name()
        )
    };
    for set in &sets {
        browser.until(&format!("{}?.dataset.state === 'live'", named(set)));
    }
    browser.until(&format!(
        "Number({}.querySelector('.fast b').textContent) > 0",
        named(&sets[0])
    ));
    browser.until("document.getElementById('mode').textContent === 'live'");
    let drawn = "(() => { const canvas = document.querySelector('.card[data-state=live] .view canvas'); const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height); return new Set(new Uint32Array(pixels.data.buffer)).size > 20; })()";
    browser.until(drawn);
    // The filter, by name.
    browser.press("/");
    let typed = serde_json::json!({"text": sets[1].name().to_string()});
    browser.call("Input.insertText", typed);
    browser.until("document.querySelectorAll('.card:not([hidden])').length === 1");
    browser.press("Escape");
    browser.until("document.querySelectorAll('.card:not([hidden])').length >= 3");
    browser.press("?");
    browser.until("document.getElementById('help').open");
    browser.press("?");
    browser.press("ArrowRight");
    browser.until("document.activeElement.classList.contains('card')");
    // A silent run comes first.
    sets[2].signal(Signal::STOP);
    sets[2].signal_program("vlaps-controller", Signal::STOP);
    browser.until(&format!("{}?.dataset.state === 'silent'", named(&sets[2])));
    browser.until(&format!(
        "document.querySelector('.card').querySelector('h2 b').textContent === '{}'",
        sets[2].name()
    ));
    if let Some(path) = std::env::var_os("VLAPS_FLEET_PICTURE") {
        browser.picture(&PathBuf::from(path));
    }
    // Phone width, and the page of one run with its way back.
    browser.look((390, 844), "light");
    browser.until("document.documentElement.scrollWidth <= 390");
    browser.look((1440, 900), "light");
    browser.value(&format!("{}.click()", named(&sets[0])));
    browser.until("document.getElementById('tick') && Number(document.getElementById('tick').textContent) > 0");
    assert_eq!(browser.text("run"), sets[0].name().to_string());
    browser.until("!document.getElementById('all').hidden");
    browser.press("a");
    browser.until("document.getElementById('cards')?.children.length >= 3");
    assert_eq!(browser.troubles, Vec::<String>::new());
}
