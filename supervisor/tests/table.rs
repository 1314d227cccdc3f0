//! Tests of the process table, its documentation, and the arithmetic of restarts.

use std::collections::BTreeSet;

use shm_config::config::{Clock, Config, GateMode, Keep, Supervisor};
use shm_config::services::Process;
use supervisor::set::backoff::{After, Backoff};
use supervisor::set::privileges::{CORES_MIN, CORES_SHARED, Privileges};
use supervisor::set::table::{Core, ProcessSpec, TABLE, rows};

fn row(process: Process) -> &'static ProcessSpec {
    TABLE
        .iter()
        .find(|row| row.process == process)
        .expect("a row")
}

#[test]
fn every_row_is_one_of_a_kind_and_starts_after_an_earlier_one() {
    let mut seen = BTreeSet::new();
    let mut cores = BTreeSet::new();
    for row in TABLE {
        if let Some(before) = row.after {
            assert!(
                seen.contains(before.word()),
                "{} after {before}",
                row.process
            );
        }
        assert!(seen.insert(row.process.word()), "{} twice", row.process);
        assert_eq!(row.binary, format!("vlaps-{}", row.process));
        if let Core::FromLast(back) = row.core {
            assert!(cores.insert(back), "two processes on one core");
            assert!(
                back < CORES_MIN - 1,
                "one core is left for all other programs"
            );
        }
    }
    assert_eq!(TABLE.last().map(|row| row.process), Some(Process::World));
}

#[test]
fn the_order_of_start_is_the_order_of_the_rows() {
    let after: Vec<_> = TABLE.iter().map(|row| row.after).collect();
    let before: Vec<_> = std::iter::once(None)
        .chain(TABLE.iter().map(|row| Some(row.process)))
        .take(TABLE.len())
        .collect();
    assert_eq!(after, before);
}

#[test]
fn the_world_has_the_highest_priority_and_the_gate_the_lowest() {
    let of = |process| row(process).priority;
    assert!(of(Process::World) > of(Process::Controller));
    assert!(of(Process::Controller) > of(Process::Planner));
    assert_eq!(of(Process::Gate), 0);
    assert!(
        TABLE.iter().all(|row| row.priority < 99),
        "99 is the kernel's"
    );
}

#[test]
fn the_documented_table_is_the_table() {
    let documented: Vec<Vec<String>> = include_str!("../src/lib.rs")
        .lines()
        .filter(|line| line.contains("| `vlaps-"))
        .map(|line| {
            line.trim_start_matches("//!")
                .split('|')
                .map(|cell| cell.trim().trim_matches('`').to_string())
                .collect()
        })
        .collect();
    assert_eq!(documented.len(), TABLE.len());
    for (cells, row) in documented.iter().zip(TABLE) {
        let core = match row.core {
            Core::Any => "any",
            Core::Left => "those left",
            Core::FromLast(0) => "last",
            Core::FromLast(1) => "last but one",
            Core::FromLast(2) => "last but two",
            Core::FromLast(_) => "not in words yet",
        };
        assert_eq!(cells[1], row.process.word());
        assert_eq!(cells[2], row.binary);
        assert_eq!(cells[3], core);
        assert_eq!(cells[4], row.priority.to_string());
        assert_eq!(cells[6], row.after.map_or("", Process::word));
    }
}

#[test]
fn few_cores_are_shared_and_a_single_core_is_not_assigned() {
    let one = Privileges::RealTime(vec![5]);
    let few = Privileges::RealTime(vec![1, 0]);
    let enough = Privileges::RealTime(vec![2, 3, 8, 9]);
    let controller = row(Process::Controller);
    assert_eq!(one.core(controller), None);
    assert_eq!(one.priority(controller), 48);
    for process in [Process::World, Process::Planner, Process::Controller] {
        assert_eq!(few.core(row(process)), Some(0), "the last in their order");
        let more = Privileges::RealTime((0..CORES_MIN - 1).collect());
        assert_eq!(more.core(row(process)), Some(CORES_MIN - 2));
    }
    assert_eq!(few.core(row(Process::Learner)), None);
    const { assert!(CORES_SHARED > 1, "other programs need a core too") };
    assert_eq!(enough.core(controller), Some(9));
    assert_eq!(enough.core(row(Process::Planner)), Some(8));
    assert_eq!(enough.core(row(Process::World)), Some(3));
    assert_eq!(enough.core(row(Process::Gate)), None);
    let recorder = row(Process::Recorder);
    assert_eq!(few.cores_left(recorder), [1], "beside the ticks");
    assert_eq!(enough.cores_left(recorder), [2]);
    assert_eq!(one.cores_left(recorder), [0; 0]);
    assert_eq!(few.cores_left(row(Process::Learner)), [0; 0]);
    assert_eq!(Privileges::Ordinary.cores_left(recorder), [0; 0]);
    assert_eq!(Privileges::Ordinary.priority(controller), 0);
    assert_eq!(Privileges::Ordinary.core(controller), None);
}

#[test]
fn gate_learner_and_recorder_have_a_process_only_when_there_is_work_for_them() {
    let mut config = Config::default();
    config.learner.enabled = true;
    config.record.keep = Keep::Everything;
    assert_eq!(rows(&config).count(), TABLE.len());
    config.gate.mode = GateMode::Expert;
    assert!(rows(&config).all(|row| row.process != Process::Gate));
    assert_eq!(rows(&config).count(), TABLE.len() - 1);
    config.learner.enabled = false;
    assert!(rows(&config).all(|row| row.process != Process::Learner));
    assert_eq!(rows(&config).count(), TABLE.len() - 2);
    config.record.keep = Keep::Auto;
    assert_eq!(rows(&config).count(), TABLE.len() - 2);
    config.run.clock = Clock::Lockstep;
    assert!(rows(&config).all(|row| row.process != Process::Recorder));
}

fn limits() -> Supervisor {
    Supervisor {
        restarts_max: 8,
        backoff_ms: 20.0,
        backoff_max_ms: 100.0,
        healthy_s: 5.0,
        ..Supervisor::default()
    }
}

#[test]
fn the_pause_doubles_up_to_its_limit_and_starts_over_after_a_healthy_time() {
    let mut backoff = Backoff::default();
    let mut pause_ms = |ran_ns| match backoff.died(ran_ns, &limits()) {
        After::Pause(ns) => ns / 1_000_000,
        After::GiveUp => panic!("too early"),
    };
    assert_eq!([0; 5].map(&mut pause_ms), [20, 40, 80, 100, 100]);
    assert_eq!(pause_ms(4_999_999_999), 100);
    assert_eq!(pause_ms(5_000_000_000), 20);
    assert_eq!(pause_ms(0), 40);
    assert_eq!(backoff.died(0, &limits()), After::GiveUp);
    assert_eq!(backoff.restarts(), 8);
}

#[test]
fn no_restart_is_a_limit_too_and_many_do_not_overflow() {
    let none = Supervisor {
        restarts_max: 0,
        ..limits()
    };
    assert_eq!(Backoff::default().died(0, &none), After::GiveUp);
    let many = Supervisor {
        restarts_max: 2000,
        ..limits()
    };
    let mut backoff = Backoff::default();
    for _ in 0..2000 {
        assert!(matches!(backoff.died(0, &many), After::Pause(ns) if ns <= 100_000_000));
    }
    assert_eq!(backoff.died(0, &many), After::GiveUp);
}
