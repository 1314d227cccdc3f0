//! Tests of starts, deaths, restarts and stops, with children that are shell scripts.

use rustix::process::{Signal, WaitIdOptions};
use shm_config::config::Keep;
use shm_config::message::HealthState;
use shm_config::services::Process;
use supervisor::set::event::Event;
use supervisor::set::launch::{Program, Resume};
use supervisor::set::member::{Decision, Phase, READY_LIMIT_NS};
use supervisor::set::stop::Stop;

use crate::common::{self, Rig, SECOND, await_state};

#[test]
fn each_starts_when_the_one_before_is_ready() {
    let mut rig = Rig::new("idle", |_| ());
    for process in [Process::Planner, Process::Controller, Process::World] {
        assert_eq!(
            rig.set.start_due(rig.now, Resume::default()),
            Decision::Continue
        );
        assert!(rig.pid(process).is_some(), "{process} has its turn");
        let started = rig.set.members().iter().filter(|m| m.lives()).count();
        assert_eq!(
            rig.set.start_due(rig.now, Resume::default()),
            Decision::Continue
        );
        let still = rig.set.members().iter().filter(|m| m.lives()).count();
        assert_eq!(
            started, still,
            "no process starts before {process} is ready"
        );
        let pid = rig.pid(process).unwrap();
        rig.set.hear(process, pid, HealthState::Starting);
        rig.set.hear(process, pid + 1, HealthState::Ready);
        let phase = rig.set.member(process).unwrap().phase();
        assert!(
            matches!(phase, Phase::Starting { .. }),
            "neither 'starting' nor another process's word makes it ready: {phase:?}"
        );
        rig.ready(process);
    }
    assert!(
        rig.set.member(Process::Gate).is_none(),
        "the gate is the expert"
    );
}

#[test]
fn a_death_is_followed_by_a_restart_after_its_pause() {
    let mut rig = Rig::new("idle", |_| ());
    rig.start_all();
    let first = rig.pid(Process::Controller).unwrap();
    rig.set.signal(Process::Controller, Signal::KILL);
    rig.await_end(Process::Controller);
    assert!(rig.set.reap(rig.now));
    rig.set.take_events();
    assert_eq!(rig.set.decide(rig.now), Decision::Continue);
    let events = rig.set.take_events();
    assert_eq!(
        events[0].to_string(),
        "controller: died (killed by SIGKILL); restart 1 of 10 in 20 ms"
    );
    let due = rig.set.next_start().expect("a restart is due");
    assert_eq!(due, rig.now.after_ns(20_000_000));
    rig.set.start_due(rig.now, Resume::default());
    assert_eq!(
        rig.pid(Process::Controller),
        None,
        "not before the pause is over"
    );
    rig.set.start_due(due, Resume::default());
    assert_ne!(rig.pid(Process::Controller), Some(first));
    assert!(rig.pid(Process::Controller).is_some());
    assert_eq!(rig.restarts(Process::Controller), 1);
    assert_eq!(rig.restarts(Process::Planner), 0);
}

#[test]
fn a_run_is_given_up_after_the_last_restart_allowed() {
    let mut rig = Rig::new("crash", |config| config.supervisor.restarts_max = 2);
    let mut deaths = 0;
    let reason = loop {
        assert_eq!(
            rig.set.start_due(rig.now, Resume::default()),
            Decision::Continue
        );
        rig.await_end(Process::Planner);
        assert!(rig.set.reap(rig.now));
        deaths += 1;
        match rig.set.decide(rig.now) {
            Decision::GiveUp(reason) => break reason,
            turn => assert_eq!(turn, Decision::Continue),
        }
        rig.now = rig.set.next_start().expect("a restart is due");
    };
    assert_eq!(deaths, 3, "two restarts");
    assert_eq!(rig.arguments("vlaps-planner").len(), 3);
    assert!(
        reason.contains("exit code 3") && reason.contains("the ground gave way"),
        "{reason}"
    );
}

#[test]
fn the_run_goes_on_without_a_recorder_that_died_too_often() {
    let mut rig = Rig::new("crash", |config| {
        config.supervisor.restarts_max = 2;
        config.record.keep = Keep::Everything;
    });
    let mut deaths = 0;
    loop {
        assert_eq!(
            rig.set.start_due(rig.now, Resume::default()),
            Decision::Continue
        );
        rig.await_end(Process::Recorder);
        assert!(rig.set.reap(rig.now));
        deaths += 1;
        assert_eq!(rig.set.decide(rig.now), Decision::Continue);
        match rig.set.next_start() {
            Some(due) => rig.now = due,
            None => break,
        }
    }
    assert_eq!(deaths, 3, "two restarts");
    let events = rig.set.take_events();
    assert_eq!(
        events.last().map(ToString::to_string).as_deref(),
        Some(
            "recorder: died (exit code 3) and was restarted 2 times already, which is \
             supervisor.restarts_max; the run goes on without it"
        )
    );
    assert!(events.last().is_some_and(|event| event.is_notable()));
    // It was never ready, and the others start all the same.
    rig.set.start_due(rig.now, Resume::default());
    assert!(rig.pid(Process::Planner).is_some());
}

#[test]
fn a_refused_set_up_is_shown_and_never_tried_again() {
    let mut rig = Rig::new("refuse", |_| ());
    rig.set.start_due(rig.now, Resume::default());
    rig.await_end(Process::Planner);
    rig.set.reap(rig.now);
    let turn = rig.set.decide(rig.now);
    assert_eq!(turn, Decision::GiveUp("planner: no such lane".into()));
    assert_eq!(rig.set.next_start(), None);
    assert_eq!(rig.restarts(Process::Planner), 0);
}

#[test]
fn a_users_program_that_ends_at_its_start_ends_the_run_with_its_last_lines() {
    for (script, shown) in [
        ("crash", "(exit code 3); its log: "),
        ("done", "(exit code 0); its log is empty: "),
        (
            "refuse",
            "(exit code 2); its last line: vlaps-planner: no such lane",
        ),
    ] {
        let program = |dir: &std::path::Path| {
            common::replace(dir, "my-planner", script);
            vec![Program {
                process: Process::Planner,
                path: dir.join("my-planner"),
                script: None,
            }]
        };
        let mut rig = Rig::with_programs("idle", |_| (), program);
        rig.set.start_due(rig.now, Resume::default());
        rig.await_end(Process::Planner);
        rig.set.reap(rig.now);
        let Decision::GiveUp(text) = rig.set.decide(rig.now) else {
            panic!("{script}: the run goes on");
        };
        let begin = "planner: its program ended before it was ready ";
        assert!(text.starts_with(begin) && text.contains(shown), "{text}");
        if script == "crash" {
            let end = "; its last lines:\n  a first line\n  the ground gave way";
            assert!(text.ends_with(end), "{text}");
        }
        assert_eq!(rig.restarts(Process::Planner), 0);
        let words = common::arguments(rig.dir.path(), "my-planner").join(" ");
        assert_eq!(words.contains("--config"), script == "crash", "{words}");
    }
}

#[test]
fn a_set_up_that_was_good_before_is_tried_again() {
    let mut rig = Rig::new("idle", |_| ());
    rig.start_all();
    // A full disk, for example, refuses for a while what was valid before.
    common::replace(rig.dir.path(), "vlaps-planner.now", "refuse");
    rig.set.signal(Process::Planner, Signal::KILL);
    for restart in 1..=3 {
        rig.await_end(Process::Planner);
        assert!(rig.set.reap(rig.now));
        assert_eq!(rig.set.decide(rig.now), Decision::Continue);
        rig.now = rig.set.next_start().expect("a restart is due");
        assert_eq!(rig.restarts(Process::Planner), restart);
        assert_eq!(
            rig.set.start_due(rig.now, Resume::default()),
            Decision::Continue
        );
    }
}

#[test]
fn a_process_is_restarted_by_the_program_that_the_run_began_with() {
    let mut rig = Rig::new("idle", |_| ());
    rig.start_all();
    // As an upgrade does: another file of the same name.
    common::replace(rig.dir.path(), "vlaps-planner", "refuse");
    rig.set.signal(Process::Planner, Signal::KILL);
    rig.await_end(Process::Planner);
    rig.set.reap(rig.now);
    assert_eq!(rig.set.decide(rig.now), Decision::Continue);
    rig.now = rig.set.next_start().expect("a restart is due");
    rig.set.start_due(rig.now, Resume::default());
    let pid = rig.pid(Process::Planner).expect("it lives");
    let command_line = format!("/proc/{pid}/cmdline");
    // The script that refuses ends at once, the one that idles becomes `sleep`.
    while !std::fs::read_to_string(&command_line).is_ok_and(|line| line.starts_with("sleep")) {
        assert!(!rig.set.reap(rig.now), "another program was started");
        std::thread::yield_now();
    }
}

#[test]
fn a_stopped_process_is_silent_and_is_killed() {
    let mut rig = Rig::new("idle", |config| config.supervisor.silence_s = 1.0);
    rig.start_all();
    let planner = rig.pid(Process::Planner).unwrap();
    rig.set.signal(Process::Planner, Signal::STOP);
    await_state(planner, WaitIdOptions::STOPPED);
    let mut killed = None;
    for look in 0..40 {
        rig.now = rig.now.after_ns(SECOND / 20);
        for process in [Process::Controller, Process::World] {
            let pid = rig.pid(process).unwrap();
            rig.set.hear(process, pid, HealthState::Running);
        }
        rig.set.decide(rig.now);
        let silenced = |event: &Event| matches!(event, Event::Silenced { .. });
        if rig.set.take_events().iter().any(silenced) {
            killed = Some(look);
            break;
        }
    }
    // 20 checks a second and a limit of one second.
    assert_eq!(killed, Some(21));
    rig.await_end(Process::Planner);
    assert!(rig.set.reap(rig.now));
    assert_eq!(rig.set.decide(rig.now), Decision::Continue);
    assert!(rig.set.next_start().is_some(), "it will be back");
    assert!(rig.set.lives(Process::Controller) && rig.set.lives(Process::World));
}

#[test]
fn a_pause_of_the_supervisor_does_not_count_as_silence() {
    let mut rig = Rig::new("idle", |_| ());
    rig.start_all();
    rig.set.decide(rig.now);
    rig.set.take_events();
    rig.now = rig.now.after_ns(3600 * SECOND);
    assert_eq!(rig.set.decide(rig.now), Decision::Continue);
    assert_eq!(rig.set.take_events(), Vec::new());
}

#[test]
fn a_process_that_never_gets_ready_ends_the_start() {
    let mut rig = Rig::new("idle", |_| ());
    rig.set.start_due(rig.now, Resume::default());
    rig.now = rig.now.after_ns(READY_LIMIT_NS);
    assert_eq!(rig.set.decide(rig.now), Decision::Continue);
    rig.now = rig.now.after_ns(1);
    let Decision::GiveUp(reason) = rig.set.decide(rig.now) else {
        panic!("waits for ever");
    };
    assert!(
        reason.starts_with("planner: not ready 20 s after its start"),
        "{reason}"
    );
}

#[test]
fn the_world_goes_on_with_the_episode_it_died_in() {
    let mut rig = Rig::with_others("idle", &[("vlaps-world", "crash")]);
    rig.start_all();
    rig.await_end(Process::World);
    rig.set.reap(rig.now);
    assert_eq!(rig.set.decide(rig.now), Decision::Continue);
    rig.now = rig.set.next_start().expect("a restart is due");
    let resume = Resume {
        episode: 7,
        driven_ns: 12_300_000_000,
    };
    rig.set.start_due(rig.now, resume);
    rig.await_end(Process::World);
    let starts = rig.arguments("vlaps-world");
    assert_eq!(starts.len(), 2);
    assert!(starts[0].ends_with("--priority 0"), "{starts:?}");
    assert!(
        starts[1].ends_with("--priority 0 --first-episode 7 --driven-ns 12300000000"),
        "{starts:?}"
    );
}

#[test]
fn only_the_worlds_exit_0_ends_the_run() {
    let done = [("vlaps-planner", "done"), ("vlaps-world", "done")];
    let mut rig = Rig::with_others("idle", &done);
    rig.start_all();
    rig.await_end(Process::Planner);
    rig.set.reap(rig.now);
    // The first call may have found both.
    rig.await_end_if_alive(Process::World);
    rig.set.reap(rig.now);
    assert_eq!(rig.set.decide(rig.now), Decision::Finished);
    assert_eq!(
        rig.restarts(Process::Planner),
        1,
        "another process ended it, so it is restarted"
    );
}

#[test]
fn a_stop_brakes_the_car_first() {
    let mut rig = Rig::new("idle", |_| ());
    rig.start_all();
    let mut stop = Stop::begin(&rig.set, &rig.config.supervisor, rig.now);
    stop.advance(&rig.set, rig.now);
    rig.await_end(Process::Controller);
    rig.set.reap(rig.now);
    assert!(!rig.set.lives(Process::Controller));
    assert!(rig.set.lives(Process::World), "it drives the braking car");
    stop.advance(&rig.set, rig.now);
    rig.await_end(Process::World);
    rig.await_end(Process::Planner);
    rig.set.reap(rig.now);
    assert!(rig.set.is_empty());
    assert!(!stop.was_forced());
}

#[test]
fn a_stop_ends_in_time_although_processes_do_not_react() {
    let mut rig = Rig::new("idle", |config| config.supervisor.stop_s = 4.0);
    rig.start_all();
    for process in [Process::Controller, Process::Planner] {
        rig.set.signal(process, Signal::STOP);
        await_state(rig.pid(process).unwrap(), WaitIdOptions::STOPPED);
    }
    let begun = rig.now;
    let mut stop = Stop::begin(&rig.set, &rig.config.supervisor, begun);
    stop.advance(&rig.set, begun.after_ns(2 * SECOND - 1));
    assert!(rig.set.lives(Process::World), "the car gets half the time");
    stop.advance(&rig.set, begun.after_ns(2 * SECOND));
    rig.await_end(Process::World);
    stop.advance(&rig.set, begun.after_ns(4 * SECOND - 1));
    assert!(!stop.was_forced());
    stop.advance(&rig.set, begun.after_ns(4 * SECOND));
    rig.await_end(Process::Controller);
    rig.await_end(Process::Planner);
    assert!(stop.was_forced());
}

#[test]
fn a_stop_without_a_car_asks_all_at_once() {
    let mut rig = Rig::new("idle", |_| ());
    rig.set.start_due(rig.now, Resume::default());
    rig.ready(Process::Planner);
    rig.set.start_due(rig.now, Resume::default());
    Stop::begin(&rig.set, &rig.config.supervisor, rig.now);
    rig.await_end(Process::Planner);
    rig.await_end(Process::Controller);
}

#[test]
fn a_stop_in_progress_can_be_cut_short() {
    let mut rig = Rig::new("idle", |_| ());
    rig.start_all();
    for process in [Process::Controller, Process::Planner, Process::World] {
        rig.set.signal(process, Signal::STOP);
        await_state(rig.pid(process).unwrap(), WaitIdOptions::STOPPED);
    }
    let mut stop = Stop::begin(&rig.set, &rig.config.supervisor, rig.now);
    stop.kill(&rig.set);
    for process in [Process::Controller, Process::Planner, Process::World] {
        rig.await_end(process);
    }
    assert!(stop.was_forced());
}
