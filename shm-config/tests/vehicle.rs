//! Vehicle files, and the settings that follow the car.

use std::path::Path;

use shm_config::config::{Config, from_toml, vehicle_of, with_vehicle};
use vehicle::Vehicle;

fn file(text: &str) -> tempfile::NamedTempFile {
    let file = tempfile::NamedTempFile::new().expect("a file");
    std::fs::write(file.path(), text).expect("written");
    file
}

fn refusal(text: &str) -> String {
    let file = file(text);
    let error = vehicle_of(file.path()).expect_err(text).to_string();
    let named = file.path().display().to_string();
    assert!(error.starts_with(&named), "{error}");
    assert_eq!(error.lines().count(), 1, "{error}");
    error[named.len()..].into()
}

fn shipped(name: &str) -> Config {
    let vehicles = Path::new(env!("CARGO_MANIFEST_DIR")).join("../vehicles");
    let table = vehicle_of(&vehicles.join(name)).expect(name);
    let table = with_vehicle(toml::Table::new(), table);
    from_toml(&table.to_string(), name).expect(name)
}

#[test]
fn a_wrong_vehicle_file_is_refused_in_one_line() {
    for (text, told) in [
        ("", "it is no vehicle file"),
        (
            "[vehicle]\nlenght_m = 4.0\n",
            "did you mean 'vehicle.length_m'?",
        ),
        ("[vehicle]\nlength_m = nan\n", "vehicle.length_m = NaN"),
        (
            "[vehicle]\nlength_m = \"long\"\n",
            "vehicle.length_m = \"long\"",
        ),
        (
            "[vehicle]\nlength_m = 2.0\nwheelbase_m = 3.0\n",
            "vehicle.wheelbase_m = 3",
        ),
        (
            "[scanner]\nbeams = 4000\n",
            "scanner.beams = 4000: must be within 1 and 2048",
        ),
        (
            "[scanner]\nfield_of_view_deg = 0.0\n",
            "scanner.field_of_view_deg = 0",
        ),
        (
            "[vehicle]\nwidth_m = 1.0\n[world]\nlanes = 2\n",
            "world.lanes is no key of a vehicle",
        ),
        (
            "[scanner]\n[run]\nseed = 3\n",
            "run.seed is no key of a vehicle",
        ),
        ("[vehicle\n", ":1"),
    ] {
        let error = refusal(text);
        assert!(error.contains(told), "{text:?}: {error}");
    }
    assert!(vehicle_of(Path::new("no/such/car.toml")).is_err());
    let rated = file("[vehicle]\nwidth_m = 1.0\n[run]\nrate_hz = 50.0\n");
    assert!(
        vehicle_of(rated.path()).is_ok(),
        "the rate belongs to the car"
    );
}

#[test]
fn the_file_of_the_default_car_is_the_default() {
    assert_eq!(shipped("metadrive.toml"), Config::default());
}

#[test]
fn the_keys_of_a_vehicle_file_replace_those_of_the_configuration() {
    let own: toml::Table = "[vehicle]\nwidth_m = 2.0\nlength_m = 5.0\n[world]\nlanes = 2\n"
        .parse()
        .expect("TOML");
    let table = with_vehicle(own, "[vehicle]\nwidth_m = 1.5\n".parse().expect("TOML"));
    let config = from_toml(&table.to_string(), "x").expect("valid");
    let car = config.vehicle;
    assert_eq!(
        (car.width_m, car.length_m, config.world.lanes),
        (1.5, 5.0, 2)
    );
}

#[test]
fn what_follows_the_car_is_written_out_and_what_is_given_is_kept() {
    let truck = shipped("truck.toml");
    let default = Config::default();
    assert!(truck.controller.lookahead_m > default.controller.lookahead_m);
    assert!(truck.planner.lane_margin_m > truck.vehicle.width_m / 2.0);
    assert!(truck.planner.partial_min_m > truck.vehicle.length_m / 2.0);
    // The yaw rate that an error of heading gives is the default car's.
    let turn = |kp: f64, car: &Vehicle| kp * car.max_steer_rad().tan() / car.wheelbase_m;
    for config in [&truck, &shipped("car-1-10.toml")] {
        let gained = turn(config.controller.steer_kp, &config.vehicle);
        let reference = turn(default.controller.steer_kp, &default.vehicle);
        assert!((gained - reference).abs() < 1e-12);
    }
    // The saved configuration is the one that ran: nothing is left to resolve.
    let saved = toml::to_string(&truck).expect("TOML");
    assert_eq!(from_toml(&saved, "saved").expect("valid"), truck);
    let text = "[vehicle]\nmax_speed_mps = 2.0\n";
    let slow = from_toml(text, "x").expect("valid");
    assert!(slow.planner.speed_mps <= 1.8 && slow.mpc.speed_mps <= 1.8);
    let given = from_toml(&format!("{text}[planner]\nspeed_mps = 5.0\n"), "x").expect("valid");
    assert_eq!(given.planner.speed_mps, 5.0);
}

#[test]
fn speed_and_goal_stay_within_what_the_scanner_sees() {
    let near = from_toml("[scanner]\nrange_m = 5.0\n", "x").expect("valid");
    assert_eq!(near.planner.goal_distance_m, 5.0);
    let car = near.vehicle;
    for speed_mps in [near.planner.speed_mps, near.mpc.speed_mps] {
        let braking_m = speed_mps.powi(2) / (2.0 * car.max_brake_mps2);
        let reacting_m = speed_mps * near.safety.reaction_s;
        assert!(speed_mps > 0.5, "{speed_mps}");
        assert!(
            braking_m + reacting_m + car.length_m / 2.0 < 5.0,
            "{speed_mps}"
        );
    }
    let far = from_toml("[scanner]\nrange_m = 100.0\n", "x").expect("valid");
    assert_eq!(far.planner, Config::default().planner);
}

#[test]
fn a_policy_is_refused_with_a_scanner_it_was_not_trained_with() {
    for scanner in [
        "beams = 1080",
        "field_of_view_deg = 270.0",
        "x_m = 1.0",
        "heading_deg = 5.0",
    ] {
        for wanted in [
            "[policy]\nfile = \"/p.onnx\"\n",
            "[learner]\nenabled = true\n",
        ] {
            let text = format!("[scanner]\n{scanner}\n{wanted}");
            let error = from_toml(&text, "x").expect_err(&text).to_string();
            assert!(error.contains("240 beams over 360 degrees"), "{error}");
            assert_eq!(error.lines().count(), 1);
        }
    }
    assert!(
        from_toml(
            "[scanner]\nrange_m = 80.0\n[policy]\nfile = \"/p.onnx\"\n",
            "x"
        )
        .is_ok()
    );
}
