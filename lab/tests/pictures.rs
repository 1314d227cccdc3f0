//! `draw plan` and `draw frame`.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use shm_config::palette;

fn draw(words: &[&str]) -> Output {
    draw_what("plan", words)
}

fn draw_what(what: &str, words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vlaps-lab"))
        .args(["draw", what])
        .args(words)
        .output()
        .expect("the program starts")
}

fn scratch(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

fn scenes() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../stack/scenes/built_in.jsonl.gz");
    path.display().to_string()
}

/// Draws a plan and checks that the SVG is well formed; returns its text.
fn picture(name: &str, words: &[&str]) -> String {
    let path = scratch(name);
    let file = path.display().to_string();
    let output = draw(&[words, &["--out", &file]].concat());
    assert!(output.status.success(), "{words:?}: {output:?}");
    let text = std::fs::read_to_string(&path).expect("the picture");
    assert_well_formed(&text);
    assert!(!text.contains("NaN") && !text.contains("inf"), "{words:?}");
    text
}

/// Checks that all elements are closed in the right order.
fn assert_well_formed(text: &str) {
    let mut open = Vec::new();
    for tag in text.split('<').skip(1) {
        let (tag, _) = tag.split_once('>').expect("each tag ends");
        assert_eq!(tag.matches('"').count() % 2, 0, "quotes: {tag}");
        let name = tag.trim_start_matches('/').trim_end_matches('/');
        let name = name.split_whitespace().next().expect("a name");
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name), "{tag}");
        } else if !tag.ends_with('/') {
            open.push(name);
        }
    }
    assert!(open.is_empty(), "left open: {open:?}");
}

#[test]
fn a_plan_of_an_episode_shows_tree_path_and_goal() {
    let text = picture("plan-seed.svg", &["--seed", "103", "--tick", "40"]);
    for word in [
        "Plan of seed 103, tick 40",
        "rrt-star",
        "cost-to-come, m",
        "goal with its ball",
    ] {
        assert!(text.contains(word), "{word}");
    }
    let again = picture("plan-seed-again.svg", &["--seed", "103", "--tick", "40"]);
    assert!(text == again, "the same picture each time");
}

#[test]
fn plans_of_reached_partial_and_blocked_scenes_are_drawn() {
    let file = scenes();
    let all = stack::scene::checked_in().expect("the checked-in scenes");
    let of = |outcome: &str| {
        all.iter()
            .position(|scene| scene.origin.outcome.word() == outcome)
    };
    for outcome in ["reached", "partial"] {
        let index = of(outcome).expect("one of each").to_string();
        let words = ["--scene", &file, "--index", &index, "--driver", "rrt-star"];
        let text = picture(&format!("plan-{outcome}.svg"), &words);
        assert!(text.contains(outcome), "{outcome}");
    }
}

#[test]
fn mistakes_are_named() {
    let file = scenes();
    let no_run = "run 'nobody' is not running";
    for (words, code, hint) in [
        (&[][..], 2, "--seed"),
        (&["--seed", "3"], 2, "--tick"),
        (
            &["--seed", "3", "--tick", "1", "--run", "a"],
            2,
            "cannot be used",
        ),
        (&["--seed", "103", "--tick", "999999"], 1, "ends at"),
        (&["--scene", &file, "--index", "600"], 1, "0 to 599"),
        (&["--run", "nobody"], 1, no_run),
    ] {
        let output = draw(words);
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{words:?}: {text}");
        assert!(text.contains(hint), "{words:?}: {text}");
    }
}

/// Draws a camera frame; returns width, height and pixels of the file.
fn frame(name: &str, words: &[&str]) -> (u32, u32, Vec<u8>) {
    let path = scratch(name);
    let file = path.display().to_string();
    let output = draw_what("frame", &[words, &["--out", &file]].concat());
    assert!(output.status.success(), "{words:?}: {output:?}");
    let picture = image::open(&path).expect("a PNG").into_rgb8();
    (picture.width(), picture.height(), picture.into_raw())
}

#[test]
fn frames_are_what_the_camera_sees_at_the_tick() {
    let words = ["--seed", "103", "--driver", "lane", "--tick"];
    let has = |pixels: &[u8], color: [u8; 3]| pixels.chunks_exact(3).any(|p| p == color);
    let (width, height, above) = frame("above.png", &[&words[..], &["40"]].concat());
    assert_eq!((width, height, above.len()), (480, 480, 480 * 480 * 3));
    assert!(has(&above, palette::ROAD) && has(&above, palette::EGO));
    assert!(!has(&above, palette::SKY), "from above there is none");
    let ahead = [&words[..], &["40", "--view", "ego", "--width", "640"]].concat();
    let (width, height, ahead) = frame("ahead.png", &ahead);
    assert_eq!((width, height), (640, 480));
    assert!(has(&ahead, palette::ROAD) && has(&ahead, palette::SKY));
    let (_, _, later) = frame("later.png", &[&words[..], &["0"]].concat());
    assert!(later != above, "another tick is another picture");
}

#[test]
fn mistakes_about_frames_are_named() {
    for (words, code, hint) in [
        (&["--seed", "3"][..], 2, "--tick"),
        (
            &["--seed", "3", "--tick", "1", "--view", "side"],
            2,
            "top_down",
        ),
        (&["--seed", "3", "--tick", "1", "--width", "63"], 2, "64"),
        (
            &[
                "--seed", "3", "--tick", "1", "--width", "961", "--height", "720",
            ],
            1,
            "960 x 720",
        ),
        (
            &["--seed", "103", "--tick", "999999", "--driver", "lane"],
            1,
            "ends at",
        ),
    ] {
        let output = draw_what("frame", words);
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{words:?}: {text}");
        assert!(text.contains(hint), "{words:?}: {text}");
    }
}
