//! The example on a serial line, against a machine at the other end of a pseudo terminal.

use std::fs::File;
use std::io::{Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use robot::{Action, Observation};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use shm_config::message::{BEAMS_MAX, Message};
use vlaps_tests::Set;

use crate::link::{Frames, Order, frame};
use crate::machine::{self, BEAMS, Machine, STEP};
use crate::report::Report;

fn action_of(order: Order) -> Action {
    Action {
        steer: order.steer.into(),
        pedal: order.pedal.into(),
    }
}

/// The machine at the end of the line, which reports this many ranges until it is told to
/// end. Returns how far it came, m, and the last order.
fn machine(mut line: File, beams: u32, ends: &AtomicBool) -> (f64, Action) {
    let mut machine = Machine::new();
    let (mut frames, mut bytes) = (Frames::default(), [0; 256]);
    let mut last = Action::BRAKE;
    while !ends.load(Ordering::Relaxed) {
        let mut ready = [PollFd::new(&line, PollFlags::IN)];
        let mut ordered = None;
        if poll(&mut ready, Some(&STEP)).is_ok_and(|ready| ready > 0)
            && let Ok(count) = line.read(&mut bytes)
        {
            ordered = frames.newest(&bytes[..count]).map(action_of);
        }
        last = ordered.unwrap_or(last);
        machine.step(ordered);
        // Noise on the line, which costs no report but its own.
        let noise = [17, 0, 3, 255, 0];
        let _ = line
            .write_all(&noise)
            .and_then(|()| line.write_all(&frame(&machine.report(beams))));
    }
    // Orders that have not been read yet. The line does not wait for more.
    while let Ok(count @ 1..) = line.read(&mut bytes) {
        last = frames.newest(&bytes[..count]).map_or(last, action_of);
    }
    (machine.driven_m(), last)
}

/// A run with a machine whose lidar gives this many ranges: how far it came, m, its last
/// order, and the run.
fn drive(run: &str, beams: u32) -> (f64, Action, Set) {
    let line = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).expect("a pseudo terminal");
    grantpt(&line)
        .and_then(|()| unlockpt(&line))
        .expect("its other end");
    // Nothing reads the line when the world has ended, and the machine must not wait.
    let flags = fcntl_getfl(&line).expect("its flags");
    fcntl_setfl(&line, flags | OFlags::NONBLOCK).expect("its flags");
    let name = ptsname(&line, Vec::new()).expect("its name");
    let name = name.into_string().expect("UTF-8");
    let ends = Arc::new(AtomicBool::new(false));
    let until = ends.clone();
    let firmware = std::thread::spawn(move || machine(File::from(line), beams, &until));
    let set = Set::new(run);
    let output = machine::run(&set, "serial", "VLAPS_SERIAL", &name);
    ends.store(true, Ordering::Relaxed);
    let (driven_m, ordered) = firmware.join().expect("the machine");
    machine::ended_well(&set, &output);
    (driven_m, ordered, set)
}

#[test]
fn a_robot_behind_a_serial_line_drives_until_the_run_ends() {
    let (driven_m, ordered, set) = drive("serial", BEAMS);
    let json = set.json();
    assert!(driven_m > 3.0, "{driven_m} m: {json}");
    // On a loaded machine an observation may be too old; none may be invalid.
    let refusals = &json["processes"]["controller"]["refusals"];
    assert!(refusals.is_object(), "{json}");
    assert!(refusals["content"].is_null(), "{json}");
    assert_eq!(ordered, Action::BRAKE, "the last order");
}

#[test]
fn a_machine_whose_lidar_is_dead_stands() {
    let (driven_m, _, set) = drive("nolidar", 0);
    assert!(driven_m < 0.1, "{driven_m} m");
    let told = set.logs();
    let line = "a report without the ranges of all beams is dropped";
    assert_eq!(told.matches(line).count(), 1, "{told}");
}

#[test]
fn a_report_of_the_largest_lidar_is_a_frame() {
    let report = Report {
        x_m: 1.0,
        y_m: 2.0,
        heading_rad: 3.0,
        speed_mps: 4.0,
        yaw_rate_radps: 5.0,
        ranges_m: vec![6.0; BEAMS_MAX],
    };
    let mut frames = Frames::default();
    assert_eq!(frames.newest(&frame(&report)), Some(report.clone()));
    assert_eq!(frames.too_long, 0);
    // What the line carries in a second, as the example says.
    let rate = |beams| {
        let ranges_m = vec![6.0; beams];
        let report = Report {
            ranges_m,
            ..report.clone()
        };
        11_520 / frame(&report).len()
    };
    assert_eq!([rate(72), rate(240)], [36, 11]);
}

#[test]
fn a_missing_line_is_one_line() {
    let set = Set::new("noline");
    let output = machine::run(&set, "serial", "VLAPS_SERIAL", "/dev/no-line");
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(
        told.contains("VLAPS_SERIAL=/dev/no-line: No such file"),
        "{told}"
    );
}

#[test]
fn a_report_makes_an_observation_that_is_accepted() {
    let mut observation = Observation {
        beam_count: BEAMS,
        ..Observation::default()
    };
    let report = Report {
        y_m: 1.0,
        ..Machine::new().report(BEAMS)
    };
    report.fill(&mut observation);
    assert_eq!(observation.check(), Ok(()));
    assert_eq!(
        (observation.road.left_m, observation.road.right_m),
        (2.0, 4.0)
    );
    // Straight ahead there is no wall, and to the left one at three metres.
    assert_eq!(observation.ranges_m[0], observation.lidar_max_m);
    assert_eq!(observation.ranges_m[18], 3.0);
}

#[test]
fn broken_frames_are_dropped_and_the_next_one_is_found() {
    let order = Order {
        steer: -0.5,
        pedal: 1.0,
    };
    let whole = frame(&order);
    let mut frames = Frames::default();
    for at in 0..whole.len() - 1 {
        for bit in 0..8 {
            let mut broken = whole.clone();
            broken[at] ^= 1 << bit;
            let found: Option<Order> = frames.newest(&broken);
            assert_eq!(found, None, "byte {at}, bit {bit}");
            // A flipped bit may have made an end in the middle.
            let _: Option<Order> = frames.newest(&[0]);
        }
        let cut = &whole[at + 1..];
        assert_eq!(
            frames.newest::<Order>(cut).filter(|_| at > 0),
            None,
            "cut at {at}"
        );
    }
    let long = vec![1; 100_000];
    assert_eq!(frames.newest::<Order>(&long), None);
    assert!(frames.too_long > 0);
    assert_eq!(frames.newest::<Order>(&[0]), None);
    assert_eq!(frames.newest(&whole), Some(order));
    let (begin, end) = whole.split_at(3);
    assert_eq!(frames.newest::<Order>(begin), None);
    assert_eq!(frames.newest(end), Some(order), "in two pieces");
}
