//! The program as users run it.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

fn lab(words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vlaps-lab"))
        .args(words)
        .output()
        .expect("the program starts")
}

fn scratch(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

fn json(path: &Path) -> Value {
    let text = std::fs::read_to_string(path).expect("the JSON was written");
    serde_json::from_str(&text).expect("JSON")
}

fn eval(driver: &str, threads: &str) -> Value {
    let path = scratch(&format!("eval-{driver}-{threads}.json"));
    let file = path.display().to_string();
    let output = lab(&[
        "eval",
        "--driver",
        driver,
        "--episodes",
        "6",
        "--threads",
        threads,
        "--json",
        &file,
    ]);
    assert!(output.status.success(), "{output:?}");
    json(&path)
}

#[test]
fn an_evaluation_is_the_same_on_any_number_of_threads() {
    for driver in ["expert", "rrt-star", "lane", "idm"] {
        let (mut one, mut three) = (eval(driver, "1"), eval(driver, "3"));
        // The only figure that is a time of this machine.
        for evaluation in [&mut one, &mut three] {
            let figures = evaluation.as_object_mut().expect("an object");
            let p99 = figures.remove("planning_p99_us").expect("the key");
            assert_eq!(
                p99.is_number(),
                ["expert", "rrt-star"].contains(&driver),
                "{driver}: {p99}"
            );
        }
        assert_eq!(one, three, "{driver}");
        assert!(
            one["mean_length"].as_f64() > Some(10.0),
            "{driver} drove: {one}"
        );
    }
}

#[test]
fn a_planning_method_is_a_driver_of_its_own_name() {
    for driver in ["rrt-star", "informed", "kinodynamic", "mpc"] {
        let path = scratch(&format!("eval-method-{driver}.json"));
        let file = path.display().to_string();
        let words = [
            "eval",
            "--driver",
            driver,
            "--episodes",
            "1",
            "--json",
            &file,
        ];
        let output = lab(&words);
        assert!(output.status.success(), "{output:?}");
        let table = String::from_utf8_lossy(&output.stdout);
        assert!(table.contains("planning p99"), "{driver}: {table}");
        assert_eq!(json(&path)["driver"], driver);
    }
}

#[test]
fn an_evaluation_has_the_agreed_keys() {
    let found = eval("idm", "2");
    for key in [
        "success",
        "strict_success",
        "contact",
        "crash_last_step",
        "out_of_road",
        "max_step",
        "completion",
    ] {
        let [mean, low, high] = ["mean", "low", "high"].map(|end| found[key][end].as_f64());
        assert!(
            low <= mean && mean <= high && low.is_some(),
            "{key}: {}",
            found[key]
        );
    }
    assert_eq!(found["driver"], "idm");
    assert_eq!(found["world"], "sim");
    assert_eq!(found["episodes"], 6);
    assert!(found["mean_speed_mps"].as_f64() > Some(1.0), "{found}");
}

#[test]
fn two_drivers_are_compared_map_by_map() {
    let words = ["eval", "--episodes", "6", "--driver", "lane"];
    let (lane, compared) = (scratch("eval-lane.json"), scratch("eval-against.json"));
    let [lane, compared] = [lane, compared].map(|path| path.display().to_string());
    assert!(
        lab(&[&words[..], &["--json", &lane]].concat())
            .status
            .success()
    );
    let same = lab(&[&words[..], &["--against", &lane, "--json", &compared]].concat());
    assert!(same.status.success(), "{same:?}");
    let figures = json(Path::new(&compared));
    assert_eq!(figures["against"]["driver"], "lane");
    let paired = &figures["against"]["strict_success"];
    assert_eq!(
        (&paired["this_alone"], &paired["other_alone"]),
        (&0.into(), &0.into())
    );
    assert_eq!(paired["p"], 1.0);
    // What it wrote is again an evaluation to compare with.
    let other = [
        "eval",
        "--episodes",
        "6",
        "--driver",
        "mpc",
        "--against",
        &compared,
    ];
    let other = lab(&other);
    let text = String::from_utf8_lossy(&other.stdout);
    assert!(text.contains("the other alone"), "{text}");

    let six = ["--episodes", "6"];
    let cargo = concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml");
    for (file, options, hint) in [
        (
            &*lane,
            &["--episodes", "6", "--first-seed", "7"][..],
            "seeds 1000 to 1005 in sim",
        ),
        (&lane, &["--episodes", "7"], "seeds 1000 to 1005 in sim"),
        (
            &lane,
            &["--episodes", "6", "--json", &lane],
            "--json would write over it",
        ),
        (
            &lane,
            &["--episodes", "6", "--set", "world.blocks=4"],
            "world.blocks 3, not 4",
        ),
        ("no/such/a.json", &six, "--against no/such/a.json"),
        ("/dev/null", &six, "--against /dev/null"),
        (cargo, &six, "no figures of ./vlaps eval"),
    ] {
        let refused = lab(&[&["eval", "--against", file][..], options].concat());
        let text = String::from_utf8_lossy(&refused.stderr);
        assert!(
            !refused.status.success() && text.contains(hint),
            "{options:?}: {text}"
        );
        assert_eq!(
            refused.stdout, b"",
            "{options:?}: before anything is driven"
        );
    }
}

#[test]
fn mistakes_are_named_with_exit_code_2() {
    for (words, hint) in [
        (&["eval", "--drivr", "idm"][..], "--driver"),
        (&["eval", "--driver", "ape"], "expert"),
        (&["eval", "--set", "world.bloks=3"], "world.blocks"),
        (&["eval", "--set", "run.rate_hz=100"], "run.rate_hz"),
        (
            &["eval", "--world", "metadrive", "--driver", "idm"],
            "--driver idm",
        ),
        (&["train", "--world", "ir-sim"], "--world ir-sim"),
        (&["draw", "mapp"], "map"),
        (&["draw", "map", "--seed", "3", "--out", "a.png"], ".svg"),
        (&["draw", "map", "--seed", "-3"], "a whole number from 0"),
        (&["draw", "plan", "--scene", "a", "--tick", "3"], "--tick"),
        (
            &["draw", "plan", "--seed", "3", "--tick", "3", "--index", "3"],
            "--index",
        ),
        (&["eval", "--episodes", "-1"], "from 1 to 1000000"),
        (
            &["eval", "--json", "no/such/a.json"],
            "--json no/such/a.json",
        ),
        (
            &["eval", "--draw", "/proc/pictures"],
            "--draw /proc/pictures",
        ),
        (&["train", "--seeds", "-1"], "from 1 to 1000"),
        (
            &["train", "--out", "/proc/experiment"],
            "--out /proc/experiment",
        ),
    ] {
        let output = lab(words);
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{words:?}: {text}");
        assert!(text.contains(hint), "{words:?}: {text}");
    }
}

#[test]
fn an_evaluation_without_its_simulator_says_what_to_run() {
    for row in supervisor::setup::foreign::FOREIGN {
        let (world, variable) = (row.part(), row.home_variable);
        let output = Command::new(env!("CARGO_BIN_EXE_vlaps-lab"))
            .args(["eval", "--world", world, "--episodes", "1"])
            .env(variable, scratch("no-simulator"))
            .output()
            .expect("the program starts");
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(text.contains(&format!("./vlaps setup {world}")), "{text}");
        assert_eq!(text.lines().count(), 1, "{text}");
    }
}

#[test]
fn pictures_hold_what_happened() {
    let path = scratch("episode.svg");
    let file = path.display().to_string();
    let output = lab(&[
        "draw", "episode", "--seed", "1003", "--driver", "idm", "--out", &file,
    ]);
    assert!(output.status.success(), "{output:?}");
    let picture = std::fs::read_to_string(&path).expect("the picture");
    for word in [
        "<svg",
        "Seed 1003: idm",
        "idm drove",
        "last scan",
        "checkpoint",
    ] {
        assert!(picture.contains(word), "{word}");
    }
    assert!(
        !picture.contains("NaN") && !picture.contains("inf"),
        "all numbers are finite"
    );
}

#[test]
fn a_policy_file_is_a_driver() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../policy/tests/data/torch_dynamo.onnx");
    let (driver, path) = (file.display().to_string(), scratch("eval-policy.json"));
    let json_file = path.display().to_string();
    let words = ["eval", "--episodes", "2", "--driver"];
    let output = lab(&[&words[..], &[&driver, "--json", &json_file]].concat());
    assert!(output.status.success(), "{output:?}");
    assert_eq!(json(&path)["driver"], driver.as_str());
    assert_eq!(
        json(&path)["planning_p99_us"],
        Value::Null,
        "nothing is planned"
    );
    let pipe = scratch("pipe.onnx");
    if !pipe.exists() {
        let made = Command::new("mkfifo").arg(&pipe).status().expect("mkfifo");
        assert!(made.success());
    }
    let pipe = pipe.display().to_string();
    for (file, why) in [
        ("nowhere.onnx", "No such file"),
        (&pipe, "is no regular file"),
    ] {
        let output = lab(&[&words[..], &[file]].concat());
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(
            !output.status.success() && text.contains(file) && text.contains(why),
            "{text}"
        );
    }
}
