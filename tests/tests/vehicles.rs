//! Process sets drive the cars of the shipped vehicle files.

use std::path::Path;

use shm_config::config;
use vlaps_tests::Set;

fn vehicle_file(name: &str) -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let path = root.join("vehicles").join(name);
    path.canonicalize().expect(name).display().to_string()
}

/// Drives one episode of a free road by this expert; the summary.
fn driven(vehicle: &str, more: &[&str]) -> (Set, serde_json::Value) {
    let set = Set::new("vehicles");
    let file = vehicle_file(vehicle);
    let fixed = [
        "--lockstep",
        "--gate",
        "expert",
        "--episodes",
        "1",
        "--seed",
        "3",
    ];
    let road = [
        "--set",
        "world.traffic_density=0",
        "--set",
        "world.accident_probability=0",
    ];
    let words = [&fixed[..], &road, &["--vehicle", &file], more].concat();
    let output = set.run(&words);
    assert!(output.status.success(), "{output:?}\n{}", set.logs());
    let json = set.json();
    (set, json)
}

#[test]
fn the_truck_and_the_small_car_arrive_without_contact() {
    for vehicle in ["truck.toml", "car-1-10.toml"] {
        let (set, json) = driven(vehicle, &["--driver", "mpc"]);
        let episode = &json["episodes"][0];
        assert_eq!(episode["outcome"], "arrived", "{vehicle}: {episode}");
        assert_eq!(episode["strict"], true, "{vehicle}: {episode}");
        // What ran is what is saved.
        let saved = set
            .folder()
            .join(format!("runs/{}/config.toml", set.name()));
        let saved = config::load(&saved).expect("the run's configuration");
        let table = config::vehicle_of(Path::new(&vehicle_file(vehicle))).expect(vehicle);
        let given = config::from_toml(&table.to_string(), vehicle).expect(vehicle);
        assert_eq!(
            (saved.vehicle, saved.scanner),
            (given.vehicle, given.scanner)
        );
        assert_eq!(saved.controller, given.controller, "fitted to the car");
    }
}

#[test]
fn a_car_of_2_mps_takes_its_time() {
    let ticks = |top: &str| {
        let long = ["--set", "world.horizon_ticks=6000", "--set", top];
        let (_, json) = driven("metadrive.toml", &long);
        let episode = &json["episodes"][0];
        assert_eq!(episode["outcome"], "arrived", "{top}: {episode}");
        episode["ticks"].as_f64().expect("ticks")
    };
    // The expert wants 5 m/s where it can, and 0.9 of the top speed where it cannot.
    let (fast, slow) = (
        ticks("vehicle.max_speed_mps=22.0"),
        ticks("vehicle.max_speed_mps=2.0"),
    );
    assert!(slow > 2.2 * fast, "{slow} ticks at 2 m/s, {fast} at 22 m/s");
}

#[test]
fn a_wrong_vehicle_file_stops_every_command_with_one_line() {
    let set = Set::new("vehicles");
    let file = set.folder().join("car.toml");
    std::fs::write(&file, "[vehicle]\nlenght_m = 3.0\n").expect("written");
    let output = set.run(&["--lockstep", "--vehicle", "car.toml"]);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(
        text.contains("car.toml") && text.contains("vehicle.length_m"),
        "{text}"
    );
    assert_eq!(text.trim().lines().count(), 1, "{text}");
}
