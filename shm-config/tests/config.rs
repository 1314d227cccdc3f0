//! Tests of the configuration: the paper's numbers by default, and clear errors.

use shm_config::config::{Clock, Config, GateMode, Vlm, from_toml, load};

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
    assert!(
        planner.shrink_after >= planner.iterations,
        "the paper's radius is not reduced"
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
        text.starts_with("vlaps.toml:2: run.seed = \"three\": must be a whole number from 0"),
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
    let text = error("[run]\nclock = \"lockstep\"\n[gate]\nmode = \"human\"\n");
    assert!(
        text.contains("gate.mode = human") && text.contains("a person needs real time"),
        "{text}"
    );
    let text = error("[limits]\ntakeover_age_ms = 50.0\n");
    assert!(text.contains("limits.takeover_age_ms = 50"), "{text}");
    let text = error("[run]\nname = \"../etc\"\n");
    assert!(text.contains("run.name"), "{text}");
    let text = error("[vehicle]\nwheelbase_m = -1.0\n");
    assert!(text.contains("vehicle.wheelbase_m = -1"), "{text}");
    let text = error("[vehicle]\nwidth_m = nan\n");
    assert!(
        text.contains("vehicle.width_m = NaN: must be within"),
        "{text}"
    );
    let text = error("[world]\nsimulator = \"metadrive\"\n[vehicle]\nwidth_m = 2.5\n");
    let told = "vehicle.width_m = 2.5: must be 1.852, the default: MetaDrive drives its own car";
    assert!(text.contains(told), "{text}");
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

#[test]
fn rates_are_equal_by_default_and_follow_the_runs() {
    let config = Config::default();
    assert_eq!((config.world_instants(), config.plan_ticks()), (1, 1));
    assert_eq!(config.plan_age_ns(), 250_000_000);
    let config = from_toml("[run]\nrate_hz = 100.0\n", "x").unwrap();
    assert_eq!(
        (config.world_rate_hz(), config.planner_rate_hz()),
        (100.0, 100.0)
    );
    assert_eq!(config.plan_age_ns(), 250_000_000, "never shorter");
}

#[test]
fn world_controller_and_planner_may_differ_by_whole_numbers() {
    let text = "[run]\nrate_hz = 100.0\n[world]\nrate_hz = 1000.0\n[planner]\nrate_hz = 2.0\n";
    let config = from_toml(text, "x").unwrap();
    assert_eq!((config.world_instants(), config.plan_ticks()), (10, 50));
    assert_eq!(config.plan_age_ns(), 1_250_000_000, "2.5 of its periods");
    let text = error("[run]\nrate_hz = 40.0\n[world]\nrate_hz = 100.0\n");
    assert!(
        text.contains("world.rate_hz = 100: must be 0 or a multiple of run.rate_hz = 40"),
        "{text}"
    );
    let text = error("[run]\nrate_hz = 100.0\n[world]\nrate_hz = 50.0\n");
    assert!(text.contains("a multiple of run.rate_hz = 100"), "{text}");
    let text = error("[run]\nrate_hz = 100.0\n[planner]\nrate_hz = 30.0\n");
    assert!(
        text.contains("planner.rate_hz = 30: must be 0, or run.rate_hz = 100 divided"),
        "{text}"
    );
    let text = error("[planner]\nrate_hz = 20.0\n");
    assert!(text.contains("run.rate_hz = 10 divided"), "{text}");
    let text = error("[world]\nrate_hz = 2000.0\n");
    assert!(text.contains("within 10 and 1000"), "{text}");
    let text = error("[run]\nrate_hz = 15.0\n");
    assert!(
        text.contains("run.rate_hz = 15: must be a multiple of 10"),
        "{text}"
    );
    for value in ["nan", "-10.0", "inf"] {
        for section in ["run", "world", "planner"] {
            let text = error(&format!("[{section}]\nrate_hz = {value}\n"));
            assert!(text.contains(&format!("{section}.rate_hz")), "{text}");
        }
    }
}

#[test]
fn age_limits_suit_the_rate_of_the_producer() {
    let slow = "[planner]\nrate_hz = 2.0\n[limits]\nplan_age_ms = ";
    let text = error(&format!("{slow}250.0\n"));
    assert!(
        text.contains("limits.plan_age_ms = 250: must be within 750"),
        "{text}"
    );
    let config = from_toml(&format!("{slow}800.0\n"), "x").unwrap();
    assert_eq!(config.plan_age_ns(), 800_000_000);
}

#[test]
fn metadrive_has_one_rate() {
    let metadrive = "[world]\nsimulator = \"metadrive\"\n";
    assert!(from_toml(metadrive, "x").is_ok());
    assert!(from_toml(&format!("{metadrive}[planner]\nrate_hz = 5.0\n"), "x").is_ok());
    let text = error(&format!("{metadrive}rate_hz = 100.0\n"));
    assert!(
        text.contains("world.rate_hz = 100: must be 10 with world.simulator"),
        "{text}"
    );
    let text = error(&format!("{metadrive}[run]\nrate_hz = 20.0\n"));
    assert!(text.contains("run.rate_hz = 20: must be 10"), "{text}");
}

#[test]
fn only_the_built_in_world_is_varied() {
    assert!(from_toml("[world]\nvaried = true\n", "x").is_ok());
    let text = error("[world]\nsimulator = \"metadrive\"\nvaried = true\n");
    assert!(
        text.contains("world.varied = true: must be false"),
        "{text}"
    );
}

#[test]
fn a_models_server_is_an_address_and_holds_no_key() {
    for server in [
        "",
        "127.0.0.1:8080",
        "ftp://x/v1",
        "http://",
        "http://a b/v1",
        "http://x/?a=1",
    ] {
        let text = error(&format!("[vlm]\nserver = \"{server}\"\n"));
        assert!(text.contains("vlm.server"), "{text}");
    }
    for (key, value) in [
        ("server", "https://me:sk-secret@api.openai.com/v1"),
        ("server", "me:sk-secret@api.openai.com/v1"),
        ("server", "https://api.openai.com/v1?key=sk-secret"),
        ("server", "https://api.openai.com/v1#sk-secret"),
        ("server", "https://api.openai.com/v1 sk-secret"),
        ("server", "sk-secret"),
        ("key_env", "sk-secret"),
        ("key_file", "sk-secret"),
    ] {
        let text = error(&format!("[vlm]\n{key} = \"{value}\"\n"));
        assert!(text.contains(&format!("vlm.{key}")), "{text}");
        assert!(!text.contains("sk-secret"), "it may be a key: {text}");
    }
    for path in ["/home/me/key", "./key.txt", "../keys/openai"] {
        assert!(from_toml(&format!("[vlm]\nkey_file = \"{path}\"\n"), "x").is_ok());
    }
}

#[test]
fn a_model_without_a_name_is_the_one_that_the_prices_are_of() {
    let vlm = Config::default().vlm;
    assert_eq!(vlm.model_name(), "gpt-4o-mini");
    assert_eq!(vlm.prices_usd(), [0.15, 0.60]);
}

#[test]
fn the_papers_mode_is_written_out_where_it_is_loaded() {
    let text = "[run]\nclock = \"lockstep\"\n[gate]\nmode = \"paper\"\ndwell_s = 5.0\n";
    let loaded = from_toml(text, "x").unwrap();
    assert_eq!((loaded.gate.dwell_s, loaded.vlm.ask_twice), (0.0, false));
    assert_eq!(loaded.controller.handover_steer_per_s, 0.0);
    let saved = toml::to_string(&loaded).unwrap();
    assert!(saved.contains("ask_twice = false"), "{saved}");
    assert_eq!(
        from_toml(&saved, "x").unwrap(),
        loaded,
        "nothing is left to resolve"
    );
}

#[test]
fn the_stand_in_has_a_name_of_its_own_and_is_free() {
    let vlm = from_toml("[vlm]\nmodel = \"vlaps-stand-in\"\n", "x")
        .unwrap()
        .vlm;
    assert_eq!(vlm.model_name(), "vlaps-stand-in");
    assert_eq!(vlm.prices_usd(), [0.0, 0.0]);
    let priced = Vlm {
        price_in_usd: 1.0,
        ..vlm
    };
    assert_eq!(priced.prices_usd(), [1.0, 0.0], "unless it is told");
}

#[test]
fn foresight_is_refused_where_nothing_is_recorded() {
    let replay = "mode = \"replay\"\nrecording = \"runs/a/judge\"";
    let error = |text: &str| from_toml(text, "test").expect_err(text).to_string();
    let text = error(&format!("[gate]\nforesight = true\n{replay}\n"));
    assert!(
        text.contains("gate.foresight = true") && text.contains("false when gate.mode is replay"),
        "{text}"
    );
    let text = error("[gate]\nforesight = true\n[programs]\ngate = \"/a\"\n");
    assert!(
        text.contains("gate.foresight = true") && text.contains("programs.gate"),
        "{text}"
    );
    for text in [
        format!("[gate]\nforesight = false\n{replay}\n"),
        "[gate]\nforesight = true\n".into(),
    ] {
        from_toml(&text, "test").expect("foresight has an effect, or is not asked for");
    }
}

/// A process on another machine needs an address, and a place to stand in.
#[test]
fn an_address_of_another_machine_is_checked_with_what_it_needs() {
    let with = |text: &str| from_toml(text, "test").map(|config| config.link);
    let link = with("[gate]\nmode = \"rules\"\n[link]\njudge = \"0.0.0.0:7450\"\n");
    assert_eq!(link.expect("a judge elsewhere").judge, "0.0.0.0:7450");
    let link = with("[learner]\nenabled = true\n[link]\nlearner = \"car.local:7451\"\n");
    assert_eq!(link.expect("a learner elsewhere").learner, "car.local:7451");
    for (text, named) in [
        ("[link]\njudge = \"7450\"\n", "link.judge"),
        ("[link]\njudge = \":7450\"\n", "link.judge"),
        ("[link]\njudge = \"host:0\"\n", "link.judge"),
        ("[link]\njudge = \"ho st:1\"\n", "link.judge"),
        (
            "[gate]\nmode = \"expert\"\n[link]\njudge = \"a:1\"\n",
            "link.judge",
        ),
        ("[link]\nlearner = \"a:1\"\n", "link.learner"),
        (
            "[programs]\ngate = \"/a\"\n[link]\njudge = \"a:1\"\n",
            "link.judge",
        ),
        (
            "[learner]\nenabled = true\n[link]\njudge = \"a:1\"\nlearner = \"a:1\"\n",
            "link.learner",
        ),
    ] {
        let error = with(text).expect_err(text).to_string();
        assert!(error.contains(named), "{error}");
    }
}
