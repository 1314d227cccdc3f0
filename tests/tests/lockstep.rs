//! Lockstep through the real processes: the same seed gives the same commands.

use rustix::process::Signal;
use serde_json::Value;
use shm_config::message::{Message, Observation};
use shm_config::services::{OBSERVATION, Process};
use shm_config::wire::{Subscriber, Wire};
use vlaps_tests::{Set, until};

fn drive(label: &str, seed: u64, episodes: u32) -> Value {
    let set = Set::new(label);
    let (seed, episodes) = (seed.to_string(), episodes.to_string());
    let output = set.run(&["--lockstep", "--seed", &seed, "--episodes", &episodes]);
    assert!(output.status.success(), "{output:?}\n{}", set.logs());
    assert_eq!(
        set.paths().shared_memory().expect("/dev/shm"),
        Vec::<std::path::PathBuf>::new()
    );
    set.json()
}

/// Ticks of a process that were done or skipped; together they are all ticks of its
/// grid.
fn accounted(json: &Value, process: &str) -> u64 {
    let row = &json["processes"][process];
    let number = |key: &str| {
        row[key]
            .as_f64()
            .unwrap_or_else(|| panic!("{process}: {key}"))
    };
    let ticks = number("ticks") + number("skipped");
    let instants = number("elapsed_s") / number("period_s");
    assert!(
        (instants - ticks).abs() < 1e-6,
        "{process}: {instants} against {row}"
    );
    ticks as u64
}

fn assert_accounts(json: &Value) {
    let number = |key: &str| json[key].as_f64().expect(key);
    let instants = (number("elapsed_s") / number("period_s")).round();
    assert_eq!(
        instants,
        number("ticks") + number("skipped"),
        "elapsed / period == ticks + skipped"
    );
    assert_eq!(json["skipped"], 0);
    assert_eq!(json["restarts"], 0);
    let ticks: u64 = json["episodes"]
        .as_array()
        .expect("episodes")
        .iter()
        .map(|e| e["ticks"].as_u64().expect("ticks"))
        .sum();
    assert_eq!(Some(ticks), json["ticks"].as_u64());
    for process in ["world", "planner", "controller"] {
        assert_eq!(accounted(json, process), ticks, "{process}: {json}");
    }
    let share: f64 = ["expert", "policy", "brake"]
        .iter()
        .map(|d| json["share"][d].as_f64().expect("share"))
        .sum();
    assert!((share - 1.0).abs() < 1e-9, "{share}");
}

#[test]
fn the_same_seed_gives_the_same_commands_and_another_differs() {
    // All run at the same time: a digest must not depend on the machine's load.
    let runs = [("a", 3), ("b", 3), ("c", 4)]
        .map(|(label, seed)| std::thread::spawn(move || drive(label, seed, 2)));
    let [a, b, c] = runs.map(|run| run.join().expect("a run"));
    for json in [&a, &b, &c] {
        assert_accounts(json);
    }
    assert_eq!(a["command_digest"], b["command_digest"]);
    assert_eq!(a["episodes"], b["episodes"]);
    assert_ne!(a["command_digest"], c["command_digest"]);
    assert_eq!(a["episodes"][0]["seed"], 3);
    assert_eq!(a["episodes"][0]["outcome"], "arrived");
    assert_eq!(a["episodes"][0]["strict"], true);
    assert_eq!(
        a["reasons"]["expert"]["unloaded"].as_u64(),
        a["ticks"].as_u64(),
        "{a}"
    );
}

#[test]
fn a_fixed_gate_needs_no_gate_process_and_says_so() {
    let set = Set::new("expert");
    let output = set.run(&[
        "--lockstep",
        "--seed",
        "3",
        "--duration",
        "20",
        "--gate",
        "expert",
    ]);
    assert!(output.status.success(), "{output:?}\n{}", set.logs());
    let json = set.json();
    assert_eq!(
        json["reasons"]["expert"]["configured"].as_u64(),
        json["ticks"].as_u64(),
        "{json}"
    );
    assert_eq!(json["ticks"], 200);
    assert!(json["processes"].get("gate").is_none(), "{json}");
    assert_eq!(json["episodes"][0]["outcome"], "stopped");
}

#[test]
fn higher_rates_keep_the_account() {
    let set = Set::new("rate");
    let output = set.run(&[
        "--lockstep",
        "--seed",
        "3",
        "--duration",
        "5",
        "--rate",
        "100",
    ]);
    assert!(output.status.success(), "{output:?}\n{}", set.logs());
    let json = set.json();
    assert_eq!(
        (json["ticks"].as_u64(), json["period_s"].as_f64()),
        (Some(500), Some(0.01))
    );
    assert_eq!(
        json["episodes"][0]["ticks"], 50,
        "traffic and rules decide at 10 Hz"
    );
}

/// World 100 Hz, controller 50 Hz, planner 10 Hz.
const UNEQUAL: [&str; 6] = [
    "--set",
    "world.rate_hz=100",
    "--set",
    "run.rate_hz=50",
    "--set",
    "planner.rate_hz=10",
];

#[test]
fn unequal_rates_repeat_too() {
    let runs = ["a", "b"].map(|label| {
        std::thread::spawn(move || {
            let set = Set::new(label);
            let output = set.run(
                &[
                    &["--lockstep", "--seed", "3", "--episodes", "2"],
                    &UNEQUAL[..],
                ]
                .concat(),
            );
            assert!(output.status.success(), "{output:?}\n{}", set.logs());
            set.json()
        })
    });
    let [a, b] = runs.map(|run| run.join().expect("a run"));
    assert_eq!(a["command_digest"], b["command_digest"]);
    assert_eq!(a["episodes"], b["episodes"]);
    let single = drive("single", 3, 2);
    assert_ne!(a["command_digest"], single["command_digest"]);
    for episode in a["episodes"].as_array().expect("episodes") {
        assert_eq!(episode["outcome"], "arrived", "{a}");
    }
    // The account is that of the run's grid; an episode's ticks are those of the
    // physics.
    assert_eq!(a["period_s"], 0.02);
    let ticks = a["ticks"].as_u64().expect("ticks");
    assert_eq!(
        (a["elapsed_s"].as_f64(), &a["skipped"]),
        (Some(ticks as f64 * 0.02), &0.into())
    );
    let driven: u64 = a["episodes"]
        .as_array()
        .expect("episodes")
        .iter()
        .map(|episode| episode["ticks"].as_u64().expect("ticks"))
        .sum();
    assert_eq!(ticks, 5 * driven);
    let row = |process: &str, key: &str| a["processes"][process][key].as_f64();
    assert_eq!(row("controller", "ticks"), Some(ticks as f64));
    assert_eq!(row("planner", "ticks"), Some(driven as f64), "one in five");
    let rates = ["world", "controller", "planner"].map(|process| row(process, "rate_hz"));
    assert_eq!(rates, [Some(100.0), Some(50.0), Some(10.0)]);
}

/// Reads from outside of a set which tick its world is at.
struct WorldTicks {
    observations: Subscriber<Observation>,
    newest: u64,
    _wire: Wire,
}

impl WorldTicks {
    fn of(set: &Set) -> Self {
        let wire = Wire::join(set.name(), Process::Learner).expect("shared memory");
        Self {
            observations: wire.subscriber(OBSERVATION).expect("observations"),
            newest: 0,
            _wire: wire,
        }
    }

    fn newest(&mut self) -> u64 {
        self.observations.update_connections();
        if let Some(observation) = self.observations.newest(Message::check) {
            self.newest = observation.header.tick;
        }
        self.newest
    }
}

#[test]
fn in_real_time_every_tick_of_each_process_is_accounted_for_over_a_restart() {
    let mut set = Set::new("absent");
    set.start(&["--seed", "3", "--no-realtime", "--duration", "12"]);
    let journal = set.paths().dir().join("restarts.json");
    // Not before its first ticks: a process without ticks leaves no gap.
    let ticks = || set.status_of("controller")["ticks"].as_u64();
    until("the controller ticks", || ticks() > Some(5));
    let mut world = WorldTicks::of(&set);
    until("the world is heard", || world.newest() > 0);
    // A controller that is restarted within a period misses no tick: the supervisor learns
    // of the death some periods later.
    set.signal(Signal::STOP);
    assert!(set.signal_program("vlaps-controller", Signal::KILL) > 0);
    let killed_at = world.newest();
    until("ticks pass without a controller", || {
        world.newest() >= killed_at + 3
    });
    drop(world);
    set.signal(Signal::CONT);
    until("the restart is written down", || journal.exists());
    assert_eq!(set.wait(), Some(0), "{}", set.logs());
    let json = set.json();
    let [world, planner, controller] =
        ["world", "planner", "controller"].map(|process| accounted(&json, process));
    let absent = json["processes"]["controller"]["absent"]
        .as_u64()
        .expect("absent");
    assert!(absent >= 2, "{json}");
    // Each grid begins with the first observation that is received, and ends with the
    // last.
    for (process, ticks) in [("planner", planner), ("controller", controller + absent)] {
        assert!(world.abs_diff(ticks) <= 3, "{process}: {ticks} of {world}");
    }
}
