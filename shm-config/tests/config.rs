//! The configuration: the paper's numbers by default, and clear errors.

use shm_config::config::{Clock, Config, GateMode, from_toml, load};

fn error(text: &str) -> String {
    let error = from_toml(text, "vlaps.toml")
        .expect_err("refused")
        .to_string();
    assert_eq!(error.lines().count(), 1, "one line: {error}");
    error
}

#[test]
fn an_empty_file_is_the_papers_experiment() {
    let config = from_toml("", "vlaps.toml").unwrap();
    assert_eq!(config, Config::default());
    assert_eq!(
        (config.run.rate_hz, config.run.clock),
        (10.0, Clock::RealTime)
    );
    let planner = config.planner;
    assert_eq!(
        (planner.cell_m, planner.x_max_m, planner.y_max_m),
        (0.05, 30.0, 10.0)
    );
    assert_eq!(
        (planner.inflation_m, planner.iterations, planner.step_m),
        (0.5, 200, 2.0)
    );
    assert_eq!(
        (
            planner.rewire_radius_m,
            planner.goal_radius_m,
            planner.speed_mps
        ),
        (3.0, 1.0, 5.0)
    );
    let pd = config.controller;
    assert_eq!(
        (pd.steer_kp, pd.steer_kd, pd.pedal_kp, pd.pedal_kd),
        (2.0, 0.001, 0.1, 0.05)
    );
    assert_eq!((pd.lookahead_m, config.gate.period_s), (2.0, 10.0));
    assert_eq!(config.gate.mode, GateMode::Rules);
}

#[test]
fn defaults_survive_the_file() {
    let text = toml::to_string(&Config::default()).unwrap();
    assert_eq!(from_toml(&text, "x").unwrap(), Config::default());
}

#[test]
fn unknown_keys_are_named_with_the_nearest_valid_one() {
    let text = error("[planner]\niteration = 100\n");
    assert!(
        text.contains("planner.iteration") && text.contains("'planner.iterations'"),
        "{text}"
    );
    let text = error("[plannr]\niterations = 100\n");
    assert!(
        text.contains("'plannr'") && text.contains("'planner'"),
        "{text}"
    );
    let text = error("[run]\nlookahead_m = 3.0\n");
    assert!(text.contains("'controller.lookahead_m'"), "{text}");
    assert!(error("[zzz]\nqqq = 1\n").contains("./vlaps config"));
}

#[test]
fn types_ranges_and_syntax_are_told_with_their_place() {
    let text = error("[run]\nseed = \"three\"\n");
    assert!(
        text.starts_with("vlaps.toml:2:") && text.contains("invalid type"),
        "{text}"
    );
    let text = error("[run]\nname = \"x\"\nclock = \"sideways\"\n");
    assert!(
        text.contains("real_time") && text.contains("lockstep"),
        "{text}"
    );
    let text = error("[planner]\ncell_m = 0.0\n");
    assert!(
        text.contains("planner.cell_m = 0: must be within 0.01 and 1"),
        "{text}"
    );
    let text = error("[planner]\nstep_m = nan\n");
    assert!(text.contains("planner.step_m = NaN"), "{text}");
    let text = error("[limits]\ncommand_age_ms = 100.0\n");
    assert!(
        text.contains("limits.command_age_ms = 100: must be within 150"),
        "{text}"
    );
    let text = error("[run]\nname = \"../etc\"\n");
    assert!(text.contains("run.name"), "{text}");
    let text = error("[vehicle]\nwheelbase_m = -1.0\n");
    assert!(text.contains("vehicle.wheelbase_m = -1"), "{text}");
    let text = error("[world]\nsequence = \"SCQ\"\n");
    assert!(
        text.contains("world.sequence") && text.contains("'Q'"),
        "{text}"
    );
    assert!(error("[run\n").starts_with("vlaps.toml:1:"));
}

#[test]
fn a_missing_file_is_named() {
    let text = load("no/such/file.toml".as_ref())
        .expect_err("refused")
        .to_string();
    assert!(
        text.contains("no/such/file.toml") && text.lines().count() == 1,
        "{text}"
    );
}
