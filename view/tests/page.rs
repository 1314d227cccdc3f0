//! The page of a recording: over HTTP, and in a real browser.

#[allow(dead_code)] // the tests of a living set use the rest
mod browser;
mod fixture;
#[allow(dead_code)] // likewise
mod http;

use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::Duration;

use browser::Browser;
use fixture::{HOSTILE, LATE_TICK, RESTART_TICK, TAKEOVER_TICK, TICKS, VETO_TICK};
use http::Page;
use tempfile::TempDir;
use view::live::page::FILES;

fn program() -> PathBuf {
    env!("CARGO_BIN_EXE_vlaps-view").into()
}

/// A folder with a recording.
fn recorded() -> TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    fixture::record(&folder.path().join("fixture-0001.mcap"));
    folder
}

fn show(folder: &Path) -> Page {
    Page::start(&program(), folder, &["."])
}

fn run(arguments: &[&str], folder: &Path) -> Output {
    let mut command = Command::new(program());
    command.arg("view").args(arguments).current_dir(folder);
    command.output().expect("it runs")
}

/// Waits until the whole recording is read.
fn overview(page: &Page) -> serde_json::Value {
    for _ in 0..2_000 {
        let overview = page.json("overview");
        if overview["indexed"] == 1.0 {
            return overview;
        }
        std::thread::park_timeout(Duration::from_millis(30));
    }
    panic!("the recording was not read within a minute");
}

#[test]
fn every_file_is_served_with_the_headers_that_keep_the_page_to_itself() {
    let folder = recorded();
    let page = show(folder.path());
    for file in FILES {
        let answer = page.get(file.path);
        assert_eq!(answer.status, 200, "{}", file.path);
        assert!(answer.body == file.bytes, "{}", file.path);
        for line in [
            "content-security-policy: default-src 'self'",
            "x-content-type-options: nosniff",
            "referrer-policy: no-referrer",
            "x-frame-options: deny",
            "cache-control: no-store",
            &format!("content-type: {}", file.media_type),
        ] {
            assert!(answer.head.contains(line), "{}: {}", file.path, answer.head);
        }
    }
}

#[test]
fn foreign_and_malformed_requests_are_refused_and_end_nothing() {
    let folder = recorded();
    let page = show(folder.path());
    let (host, _) = page.place();
    let status = |head: &str| page.ask(head).status;
    let get = |path: &str| format!("GET {path} HTTP/1.1\r\n");
    let ours = format!("Host: {host}\r\n");
    assert_eq!(status(&format!("{}{ours}", get("/"))), 200);
    for refused in [
        "Host: evil.example\r\n".to_string(),
        "Host: evil.example:8090\r\n".into(),
        format!("{ours}Origin: http://evil.example\r\n"),
        format!("{ours}Origin: null\r\n"),
        format!("{ours}Host: evil.example\r\n"),
    ] {
        let told = status(&format!("{}{refused}", get("/hello")));
        assert!([400, 403].contains(&told), "{refused}: {told}");
    }
    assert_eq!(
        status(&format!("{}{ours}Origin: http://{host}\r\n", get("/hello"))),
        200
    );
    for path in [
        "/nothing",
        "/../Cargo.toml",
        "/..%2f..%2fetc%2fpasswd",
        "/picture/..%2fx.png",
        "/picture/%00.png",
        "/stream",
        "//etc/passwd",
        "/uplot/",
        "/status?tick=99999999",
    ] {
        assert_eq!(status(&format!("{}{ours}", get(path))), 404, "{path}");
    }
    for path in [
        "/frames",
        "/frames?from=-1",
        "/status?tick=x",
        "/tree?tick=",
    ] {
        assert_eq!(status(&format!("{}{ours}", get(path))), 400, "{path}");
    }
    for method in ["POST", "PUT", "DELETE", "OPTIONS", "PATCH"] {
        assert_eq!(
            status(&format!("{method} /hello HTTP/1.1\r\n{ours}")),
            405,
            "{method}"
        );
    }
    for garbage in [
        "\0\0\0\0",
        "GET",
        "GET / HTTP/9.9\r\n",
        "\u{16}\u{3}\u{1}",
        &"A".repeat(1 << 20),
    ] {
        assert!(status(garbage) != 200);
    }
    assert_eq!(page.get("hello").status, 200, "the server lives");
}

#[test]
fn a_recording_tells_its_course_and_its_events() {
    let folder = recorded();
    let page = show(folder.path());
    let hello = page.json("hello");
    assert_eq!(hello["mode"], "recording");
    assert_eq!(hello["run"]["name"], HOSTILE);
    assert_eq!(hello["recording"]["last_tick"], TICKS - 1);
    assert_eq!(
        hello["drivers"][0],
        serde_json::json!(["expert", "#37d67a"])
    );
    let overview = overview(&page);
    let samples = overview["samples"].as_array().expect("samples");
    // The inadmissible step is left out; every other one is in a sample.
    let steps: u64 = samples
        .iter()
        .filter_map(|sample| sample["steps"].as_u64())
        .sum();
    assert_eq!(steps, TICKS - 1);
    let events = overview["events"].as_array().expect("events");
    let has = |kind: &str, tick: u64| {
        let near = |event: &&serde_json::Value| {
            let at = event["tick"].as_u64().unwrap_or(0);
            event["kind"] == kind && at.abs_diff(tick) < 5
        };
        assert!(
            events.iter().any(|event| near(&event)),
            "{kind} at {tick}: {events:?}"
        );
    };
    has("veto", VETO_TICK);
    has("takeover", TAKEOVER_TICK);
    has("late", LATE_TICK);
    has("fault", RESTART_TICK);
    has("swap", 340);
}

#[test]
fn scenes_status_and_tree_of_a_recorded_tick_are_given() {
    let folder = recorded();
    let page = show(folder.path());
    let scenes = page.json("frames?from=100&count=3&stride=10");
    let ticks: Vec<_> = (0..3).map(|k| scenes[k]["tick"].as_u64()).collect();
    assert_eq!(ticks, [Some(100), Some(110), Some(120)]);
    let scene = &scenes[2];
    assert_eq!(scene["reason"], "vetoed");
    assert_eq!(scene["policy"]["is_vetoed"], true);
    assert!(
        scene["expert"]["rollout"]
            .as_array()
            .is_some_and(|path| path.len() > 5)
    );
    assert!(
        scene["scan_m"]
            .as_array()
            .is_some_and(|scan| scan.len() == 240)
    );
    assert!(
        scene["edges"][0]
            .as_array()
            .is_some_and(|edge| edge.len() > 10)
    );
    // The bad step has no scene; the one after it has.
    let after = page.json("frames?from=50&count=1&stride=1");
    assert_eq!(after[0]["tick"], 51);
    assert_eq!(
        page.json("frames?from=399&count=1000000&stride=18446744073709551615")[0]["tick"],
        399
    );
    let status = page.json("status?tick=320");
    let planner = &status["view"]["processes"][0];
    assert_eq!(
        (planner["process"].as_str(), planner["restarts"].as_u64()),
        (Some("planner"), Some(1))
    );
    assert!(
        status["histograms"]
            .as_array()
            .is_some_and(|all| all.len() == 3)
    );
    assert_eq!(
        page.json("status?tick=100")["view"]["processes"][0]["restarts"],
        0
    );
    let tree = page.json("tree?tick=100");
    assert!(tree["ways"].as_array().is_some_and(|ways| !ways.is_empty()));
}

#[test]
fn a_start_that_cannot_be_is_told_in_one_line_with_exit_code_2() {
    let folder = tempfile::tempdir().expect("a folder");
    let taken = TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = taken.local_addr().expect("an address").port().to_string();
    std::fs::write(folder.path().join("foreign.mcap"), b"not a recording").expect("a file");
    let unheard = format!("x{}", std::process::id() % 10_000);
    for (arguments, parts) in [
        (
            vec!["--port", port.as_str()],
            ["cannot listen on 127.0.0.1", "--port 0"],
        ),
        (
            vec!["--bind", "192.0.2.1"],
            ["cannot listen on 192.0.2.1", "--bind"],
        ),
        (vec!["--run", unheard.as_str()], [unheard.as_str(), "run"]),
        (vec!["missing"], ["missing", "No such file"]),
        (vec!["foreign.mcap"], ["foreign.mcap", "no recording"]),
        (vec!["."], ["foreign.mcap", "no recording"]),
    ] {
        let output = run(&arguments, folder.path());
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {text}");
        assert_eq!(text.lines().count(), 1, "{text}");
        for part in parts {
            assert!(
                text.contains(part),
                "{arguments:?}: {part} is missing in: {text}"
            );
        }
    }
}

#[test]
fn another_machine_needs_the_token() {
    let folder = recorded();
    let page = Page::start(&program(), folder.path(), &[".", "--bind", "0.0.0.0"]);
    let (host, root) = page.place();
    assert!(root.len() > 30, "{}", page.url);
    assert_eq!(page.get("hello").status, 200);
    let ask = |path: &str| page.ask(&format!("GET {path} HTTP/1.1\r\nHost: {host}\r\n"));
    for path in ["/", "/hello", "/00000000000000000000000000000000/hello"] {
        let answer = ask(path);
        assert_eq!(answer.status, 403, "{path}");
        assert!(!answer.text().contains(root.trim_matches('/')));
    }
    // Without its last slash it leads to the page, on which addresses are relative.
    let moved = ask(root.trim_end_matches('/'));
    assert_eq!(moved.status, 308);
    assert!(
        moved.head.contains(&format!("location: {root}")),
        "{}",
        moved.head
    );
    let foreign = format!("GET {root}hello HTTP/1.1\r\nHost: evil.example\r\n");
    assert_eq!(page.ask(&foreign).status, 403);
}

#[test]
fn a_browser_draws_plays_and_seeks_a_recording() {
    let Some(mut browser) = Browser::start() else {
        return;
    };
    let folder = recorded();
    let page = show(folder.path());
    let events = overview(&page)["events"].clone();
    let later = events.as_array().into_iter().flatten().find(|event| {
        let is_worth = !["swap", "episode"].contains(&event["kind"].as_str().unwrap_or(""));
        is_worth && event["tick"].as_u64().is_some_and(|tick| tick > VETO_TICK)
    });
    let later = later.expect("an event")["tick"].clone();
    browser.look((1440, 900), "dark");
    browser.open(&format!("{}#tick={VETO_TICK}", page.url));
    browser.until("document.getElementById('tick')?.textContent === '120'");
    assert_eq!(browser.text("mode").to_lowercase(), "recording");
    assert_eq!(browser.text("driver-name"), "expert");
    assert_eq!(browser.text("driver-reason"), "vetoed");
    browser.until("document.querySelectorAll('#events li').length >= 5");
    assert!(browser.colors("scene") > 50 && browser.colors("timeline") > 5);
    assert!(browser.value("document.querySelectorAll('#charts canvas').length") == 4);
    // Steps, events, the link.
    browser.press("ArrowRight");
    browser.until("document.getElementById('tick').textContent === '121'");
    browser.press("ArrowLeft");
    browser.press("n");
    browser.until(&format!(
        "document.getElementById('tick').textContent === '{later}'"
    ));
    browser.until(&format!("location.hash === '#tick={later}'"));
    browser.press("p");
    browser.until("document.getElementById('tick').textContent === '120'");
    // The page writes the link a moment later; the same link again would be no change.
    browser.until(&format!("location.hash === '#tick={VETO_TICK}'"));
    browser.value(&format!("location.hash = '#tick={TAKEOVER_TICK}'"));
    browser.until("document.getElementById('driver-name').textContent === 'person'");
    browser.value("location.hash = '#tick=300'");
    browser.until("document.getElementById('tick').textContent === '300'");
    // It plays on, and stands still when told.
    browser.press(" ");
    browser.until("Number(document.getElementById('tick').textContent) > 304");
    browser.press(" ");
    let tick = browser.text("tick");
    browser.until("document.getElementById('play').textContent === '▶'");
    browser.press("Home");
    browser.until("document.getElementById('tick').textContent === '0'");
    assert_ne!(tick, "0");
    browser.press("t");
    browser
        .until("document.querySelector('[data-key=tree]').getAttribute('aria-pressed') === 'true'");
    // Help, themes, phone width.
    browser.press("?");
    browser.until("document.getElementById('help').open");
    browser.press("?");
    let dark = browser.value("getComputedStyle(document.body).backgroundColor");
    browser.press("d");
    assert_ne!(
        browser.value("getComputedStyle(document.body).backgroundColor"),
        dark
    );
    browser.look((390, 844), "dark");
    browser.until("document.documentElement.scrollWidth <= 390");
    // The run's name is shown as text, markup included.
    assert_eq!(browser.text("run"), HOSTILE);
    assert_eq!(browser.value("window.hostile === undefined"), true);
    assert_eq!(browser.troubles, Vec::<String>::new());
}
