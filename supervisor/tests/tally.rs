//! Tests of sums: steps, episodes, restarts, histograms, digest and JSON.

use shm_config::config::Config;
use shm_config::message::{
    Driver, Episode, Grant, Header, Health, HealthState, Outcome, Part, Reason, Step, Timing,
};
use shm_config::services::Process;
use supervisor::show::summary::Summary;
use supervisor::telemetry::episodes::command_digest;
use supervisor::telemetry::quantiles::Quantiles;
use supervisor::telemetry::step_tally::WEIGHTS_KEPT;
use supervisor::telemetry::tally::Tally;

use crate::common::Rig;

fn step(producer: u32, sequence: u64, driver: Driver, reason: Reason) -> Step {
    let mut step = Step::default();
    step.header.producer = producer;
    step.header.sequence = sequence;
    step.command.driver = driver.code();
    step.command.reason = reason.code();
    step
}

fn episode(index: u32, outcome: Outcome, digest: u8) -> Episode {
    Episode {
        header: Header {
            episode: index,
            ..Header::default()
        },
        seed: 1000 + u64::from(index),
        ticks: 10,
        completion: 0.5,
        driven_m: 12.0,
        vehicle_contacts: 0,
        object_contacts: 0,
        braked: 1,
        outcome: outcome.code(),
        crash_last_step: 0,
        command_digest: [digest; 32],
        skipped: 0,
    }
}

fn health(producer: u32, ticks: u64, skipped: u64) -> Health {
    let first = 7_000_000_000;
    Health {
        header: Header {
            producer,
            ..Header::default()
        },
        ticks,
        skipped,
        first_scheduled_ns: first,
        next_scheduled_ns: first + (ticks + skipped) * 100_000_000,
        state: HealthState::Running.code(),
        priority: Grant::Refused.code(),
        priority_asked: 48,
        ..Health::default()
    }
}

fn timing(producer: u32, latenesses_ns: impl IntoIterator<Item = u64>) -> Timing {
    let mut timing = Timing::default();
    timing.header.producer = producer;
    for ns in latenesses_ns {
        timing.release_lateness.record(ns);
    }
    timing
}

#[test]
fn steps_are_counted_by_driver_and_reason_and_the_lost_ones_too() {
    let mut tally = Tally::default();
    tally.count_step(&step(11, 1, Driver::Expert, Reason::Unloaded));
    tally.count_step(&step(11, 2, Driver::Expert, Reason::Vetoed));
    tally.count_step(&step(11, 5, Driver::Brake, Reason::Blind));
    // After a restart the first two steps are missing.
    tally.count_step(&step(12, 3, Driver::Policy, Reason::Advised));
    let steps = &tally.steps;
    assert_eq!((steps.received, steps.lost()), (4, 4));
    assert_eq!(steps.driven_by(Driver::Expert), 2);
    assert_eq!(steps.share(Driver::Policy), 0.25);
    assert_eq!(steps.newest, Some((Driver::Policy, Reason::Advised)));
    let reasons: Vec<_> = steps.reasons().collect();
    assert_eq!(
        reasons,
        [
            (Driver::Expert, "unloaded", 1),
            (Driver::Expert, "vetoed", 1),
            (Driver::Policy, "advised", 1),
            (Driver::Brake, "blind", 1),
        ]
    );
}

#[test]
fn steps_after_the_end_of_the_drive_count_for_nothing() {
    let mut tally = Tally::default();
    tally.count_step(&step(11, 1, Driver::Expert, Reason::Unloaded));
    tally.close_steps();
    tally.count_step(&step(11, 3, Driver::Brake, Reason::Stopping));
    assert_eq!((tally.steps.received, tally.steps.lost()), (1, 0));
    assert_eq!(tally.steps.share(Driver::Brake), 0.0);
}

#[test]
fn what_a_controller_does_after_the_worlds_last_tick_counts_for_nothing() {
    let mut tally = Tally::default();
    let mut world = health(5, 18, 2);
    world.state = HealthState::Finished.code();
    tally.count_health(Process::World, &world);
    let taken = |sequence, taken_ns| {
        let mut step = step(6, sequence, Driver::Expert, Reason::Unloaded);
        step.header.taken_ns = taken_ns;
        step
    };
    // The last step may be read after the world's last message.
    tally.count_step(&taken(1, world.next_scheduled_ns - 1));
    tally.count_step(&taken(2, world.next_scheduled_ns));
    assert_eq!((tally.steps.received, tally.steps.lost()), (1, 0));
}

#[test]
fn what_each_version_of_the_weights_did_is_kept() {
    let mut tally = Tally::default();
    for (sequence, version, driver) in [
        (1, 0, Driver::Expert),
        (2, 7, Driver::Policy),
        (3, 7, Driver::Expert),
        (4, 8, Driver::Policy),
    ] {
        let mut step = step(1, sequence, driver, Reason::Advised);
        (step.weights_version, step.weights_hash) = (version, 10 * version);
        tally.count_step(&step);
    }
    let rig = Rig::new("idle", |_| ());
    let summary = Summary::of(&rig.config, &tally, &rig.set, String::new());
    let rows = summary.weights.iter();
    let rows: Vec<_> = rows
        .map(|row| (row.version, row.hash.as_str(), row.proposed, row.drove))
        .collect();
    assert_eq!(
        rows,
        [(7, "0000000000000046", 2, 1), (8, "0000000000000050", 1, 1)]
    );
    let text = summary.to_string();
    assert!(text.contains("8 drove 1 of 1, 7 drove 1 of 2"), "{text}");
    // A run that swaps without limit does not grow.
    for version in 9..5_000 {
        let mut step = step(1, version, Driver::Policy, Reason::Advised);
        step.weights_version = version;
        tally.count_step(&step);
    }
    assert_eq!(tally.steps.weights().count(), WEIGHTS_KEPT);
}

#[test]
fn ticks_without_a_living_process_are_counted_as_absent() {
    let mut tally = Tally::default();
    tally.count_health(Process::Controller, &health(1, 50, 2));
    let mut successor = health(2, 10, 0);
    // Three seconds after its predecessor's last tick.
    successor.first_scheduled_ns = health(1, 50, 2).next_scheduled_ns + 3_000_000_000;
    successor.next_scheduled_ns = successor.first_scheduled_ns + 1_000_000_000;
    tally.count_health(Process::Controller, &successor);
    // A process without a tick has no absence.
    let mut dead = health(3, 0, 0);
    (dead.first_scheduled_ns, dead.next_scheduled_ns) = (0, 0);
    tally.count_health(Process::Controller, &dead);
    let rig = Rig::new("idle", |_| ());
    let summary = Summary::of(&rig.config, &tally, &rig.set, String::new());
    let controller = &summary.processes["controller"];
    assert_eq!((controller.skipped, controller.absent), (2, 30));
}

#[test]
fn a_step_of_unknown_codes_is_refused_and_reads_as_the_brake() {
    let mut tally = Tally::default();
    let mut odd = step(1, 1, Driver::Expert, Reason::Unloaded);
    odd.command.driver = 77;
    tally.count_step(&odd);
    assert_eq!(tally.refused, 1);
    assert_eq!(tally.steps.driven_by(Driver::Brake), 1);
}

#[test]
fn counts_go_on_over_a_restart() {
    let mut tally = Tally::default();
    for health in [health(1, 50, 2), health(1, 90, 3), health(2, 5, 0)] {
        assert!(tally.count_health(Process::World, &health).is_some());
    }
    let totals = tally.process(Process::World).unwrap().totals();
    assert_eq!((totals.ticks, totals.skipped), (95, 3));
    assert_eq!(totals.elapsed_ns, 98 * 100_000_000);
    assert!(tally.is_priority_refused(Process::World));
    assert!(!tally.is_priority_refused(Process::Planner));
}

#[test]
fn a_health_of_unknown_state_is_no_sign_of_life() {
    let mut odd = health(1, 1, 0);
    odd.state = 99;
    assert_eq!(Tally::default().count_health(Process::World, &odd), None);
}

#[test]
fn the_quantiles_of_many_restarts_are_those_of_one_histogram() {
    // There are more producers than are kept apart, and the last message of each
    // replaces its earlier ones.
    let mut tally = Tally::default();
    let mut all = Vec::new();
    for producer in 1..=9u32 {
        let part: Vec<u64> = (0..200).map(|k| u64::from(producer) * k * 997).collect();
        tally.count_timing(Process::World, timing(producer, part[..20].iter().copied()));
        tally.count_timing(Process::World, timing(producer, part.iter().copied()));
        all.extend(part);
    }
    let whole = timing(0, all.iter().copied());
    let merged = tally.process(Process::World).unwrap().timing();
    assert_eq!(merged.release_lateness, whole.release_lateness);
    let quantiles = Quantiles::of(&merged.release_lateness).expect("counted");
    all.sort_unstable();
    let exact = |share: f64| all[(share * all.len() as f64) as usize] as f64 / 1e3;
    assert!(
        (quantiles.p50 / exact(0.5) - 1.0).abs() < 0.02,
        "{quantiles:?}"
    );
    assert!(
        (quantiles.p99 / exact(0.99) - 1.0).abs() < 0.02,
        "{quantiles:?}"
    );
    assert_eq!(quantiles.max, exact(0.9999), "the maximum is exact");
}

#[test]
fn the_digest_is_that_of_the_episodes_digests_in_order() {
    // sha256 of nothing, and of 32 bytes 0x01 then 32 bytes 0x02, as
    // `printf '\1%.0s' {1..32}; printf '\2%.0s' {1..32}` piped to sha256sum.
    assert_eq!(
        command_digest([].iter()),
        "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    );
    let two = [
        episode(0, Outcome::Arrived, 1),
        episode(1, Outcome::Arrived, 2),
    ];
    assert_eq!(
        command_digest(two.iter()),
        "f818afd37a6dc3bc92fb44731011277006db4efa6e9023cd7468c02335d22a4d"
    );
    assert_ne!(command_digest(two.iter().rev()), command_digest(two.iter()));
}

#[test]
fn the_world_goes_on_after_the_last_finished_episode() {
    let mut tally = Tally::default();
    assert_eq!(tally.next_episode(), 0);
    tally.count_episode(episode(0, Outcome::Arrived, 1));
    tally.count_episode(episode(1, Outcome::OutOfRoad, 2));
    assert_eq!(tally.next_episode(), 2);
    assert_eq!(tally.outcome_count(Outcome::OutOfRoad), 1);
}

fn driven() -> Tally {
    let mut tally = Tally::default();
    tally.count_health(Process::World, &health(5, 18, 2));
    tally.count_health(Process::Controller, &health(6, 18, 2));
    tally.count_timing(Process::World, timing(5, [10_000, 20_000, 3_000_000]));
    tally.count_episode(episode(0, Outcome::Arrived, 1));
    let mut touched = episode(1, Outcome::Arrived, 2);
    touched.vehicle_contacts = 3;
    tally.count_episode(touched);
    for sequence in 1..=18 {
        tally.count_step(&step(6, sequence, Driver::Expert, Reason::Unloaded));
    }
    tally
}

#[test]
fn the_json_has_the_keys_that_scripts_rely_on() {
    let rig = Rig::new("idle", |_| ());
    let summary = Summary::of(&rig.config, &driven(), &rig.set, "finished".into());
    let path = rig.dir.path().join("summary.json");
    summary.write(&path).expect("written");
    let text = std::fs::read_to_string(&path).expect("read");
    let json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(
        json["episodes"],
        serde_json::json!([
            {"seed": 1000, "outcome": "arrived", "strict": true, "completion": 0.5, "ticks": 10},
            {"seed": 1001, "outcome": "arrived", "strict": false, "completion": 0.5, "ticks": 10},
        ])
    );
    assert_eq!(json["ticks"], 18);
    assert_eq!(json["skipped"], 2);
    assert_eq!(json["elapsed_s"], 2.0);
    assert_eq!(json["period_s"], 0.1);
    assert_eq!(json["restarts"], 0);
    assert_eq!(
        json["share"],
        serde_json::json!({"expert": 1.0, "policy": 0.0, "brake": 0.0})
    );
    assert_eq!(json["command_digest"].as_str().map(str::len), Some(64));
    let lateness = &json["release_lateness_us"];
    assert_eq!(lateness["max"], 3000.0);
    for key in ["p50", "p99", "p999"] {
        assert!(
            lateness[key].as_f64().is_some_and(|us| us > 0.0),
            "{key}: {lateness}"
        );
    }
    // A measure that a process does not have is left out, not 0.
    let world = json["processes"]["world"].as_object().expect("a row");
    assert!(world.contains_key("release_lateness_us"));
    for key in ["response_us", "wake_up_us"] {
        assert!(!world.contains_key(key), "{key}: {world:?}");
    }
    assert_eq!(json["lost_steps"], 0);
    assert_eq!(json["reasons"]["expert"]["unloaded"], 18);
    assert_eq!(
        json["processes"]["world"]["realtime"]["priority"],
        "refused"
    );
    let beside = std::fs::read_dir(rig.dir.path())
        .expect("a folder")
        .flatten();
    let left: Vec<_> = beside
        .map(|entry| entry.file_name())
        .filter(|name| name.to_string_lossy().starts_with("summary.json."))
        .collect();
    assert!(left.is_empty(), "{left:?}");
}

#[test]
fn the_raw_histograms_add_up_to_what_was_counted() {
    let text = supervisor::telemetry::timing::csv(&driven());
    let mut lines = text.lines();
    assert_eq!(
        lines.next(),
        Some("process,measure,from_ns,below_ns,count,max_ns")
    );
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 3, "{text}");
    for (row, ns) in rows.iter().zip([10_000, 20_000, 3_000_000]) {
        assert_eq!(row[..2], ["world", "release_lateness"]);
        let number = |cell: usize| row[cell].parse::<u64>().expect("a number");
        assert!(number(2) <= ns && ns < number(3), "{row:?}");
        assert_eq!((number(4), number(5)), (1, 3_000_000));
    }
}

#[test]
fn faults_overruns_and_elapsed_time_go_on_over_a_restart() {
    let mut tally = Tally::default();
    for producer in [1, 2] {
        let mut health = health(producer, 50, 0);
        (health.minor_faults, health.major_faults) = (3, 1);
        health.involuntary_switches = 7;
        health.overruns[Part::Search.code() as usize] = 4;
        tally.count_health(Process::Planner, &health);
    }
    let rig = Rig::new("idle", |_| ());
    let summary = Summary::of(&rig.config, &tally, &rig.set, String::new());
    let planner = &summary.processes["planner"];
    assert_eq!((planner.minor_faults, planner.major_faults), (6, 2));
    assert_eq!(planner.involuntary_switches, 14);
    assert_eq!(planner.overruns, [("search", 8)].into());
    assert_eq!(
        (planner.elapsed_s, planner.period_s),
        (Some(10.0), Some(0.1))
    );
    assert!(
        summary
            .to_string()
            .contains("planner over budget: search 8")
    );
}

#[test]
fn the_table_says_what_the_json_says() {
    let rig = Rig::new("idle", |_| ());
    let summary = Summary::of(&rig.config, &driven(), &rig.set, "finished".into());
    let text = summary.to_string();
    for part in [
        "run default: finished",
        "2 episodes: 2 arrived (1 without contact), 0 out of road",
        "expert 100.0 %, policy 0.0 %, brake 0.0 % of 18 steps (0 lost",
        "ticks 18 + skipped 2 = 20 == 20 = elapsed 2.000 s / period 0.1 s",
        "priority refused (asked ordinary 48, got ordinary 0)",
    ] {
        assert!(text.contains(part), "'{part}' is missing in\n{text}");
    }
    let mut wrong = driven();
    let mut health = health(5, 18, 2);
    health.skipped = 1;
    wrong.count_health(Process::World, &health);
    let text = Summary::of(&rig.config, &wrong, &rig.set, String::new()).to_string();
    assert!(text.contains("ticks 18 + skipped 1 = 19 != 20"), "{text}");
}

#[test]
fn an_empty_run_adds_up_to_nothing() {
    let rig = Rig::new("idle", |_| ());
    let summary = Summary::of(
        &Config::default(),
        &Tally::default(),
        &rig.set,
        "stopped".into(),
    );
    assert_eq!(
        (summary.ticks, summary.steps, summary.lost_steps),
        (0, 0, 0)
    );
    assert_eq!(summary.share.expert, 0.0);
    assert!(summary.to_string().contains("no episode was finished"));
}
