//! The example on a CAN bus, against a machine at the other end of a Unix socket that
//! carries the same frames: a kernel without CAN has no virtual interface. The machine's
//! frames are written here by the table of the example, not by its code.

use std::os::fd::OwnedFd;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use robot::{Action, Observation};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::net::{AddressFamily, SocketAddrUnix, SocketType, accept, bind, listen, socket};
use shm_config::message::Message;
use socketcan::{CanDataFrame, CanFrame, CanSocket, EmbeddedFrame, Frame, Socket, StandardId};
use vlaps_tests::Set;

use crate::frames::{BEAMS_CAN, MOTION, ORDER, PLACE, RANGES, Reports, order};
use crate::machine::{self, BEAMS, Machine, STEP};
use crate::report::Report;

fn frame(id: u16, bytes: &[u8]) -> CanFrame {
    let id = StandardId::new(id).expect("a standard identifier");
    CanDataFrame::new(id, bytes)
        .expect("at most 8 bytes")
        .into()
}

/// The frames of a report.
fn cycle(cycle: u8, report: &Report) -> Vec<CanFrame> {
    let part = |value: f32| (value as i16).to_le_bytes();
    let mut motion = vec![cycle];
    motion.extend(part(report.speed_mps * 100.0));
    motion.extend(part(report.yaw_rate_radps * 1000.0));
    let mut place = vec![cycle];
    place.extend(&((report.x_m * 100.0) as i32).to_le_bytes()[..3]);
    place.extend(part(report.y_m * 100.0));
    place.extend(part(report.heading_rad * 1e4));
    let mut all = vec![frame(MOTION, &motion), frame(PLACE, &place)];
    for (group, ranges_m) in report.ranges_m.chunks(3).enumerate() {
        let mut bytes = vec![cycle, group as u8];
        for range_m in ranges_m {
            let range_cm = if *range_m < 600.0 {
                (range_m * 100.0) as u16
            } else {
                65535
            };
            bytes.extend(range_cm.to_le_bytes());
        }
        bytes.resize(8, 255);
        all.push(frame(RANGES, &bytes));
    }
    all
}

/// Counter and action of an order.
fn ordered(frame: &CanFrame) -> Option<(u8, Action)> {
    if frame.raw_id() != u32::from(ORDER) {
        return None;
    }
    let bytes: [u8; 5] = frame.data().try_into().ok()?;
    let part = |low, high| f64::from(i16::from_le_bytes([low, high])) / 32_767.0;
    let (steer, pedal) = (part(bytes[1], bytes[2]), part(bytes[3], bytes[4]));
    Some((bytes[0], Action { steer, pedal }))
}

/// The machine on the bus, which reports until it is told to end. Returns how far it came,
/// m, and the last order.
fn machine(bus: &CanSocket, hangs: bool, ends: &AtomicBool) -> (f64, Action) {
    bus.set_nonblocking(true).expect("it never waits");
    let (mut machine, mut last) = (Machine::new(), (0, Action::BRAKE));
    for count in 0_u32.. {
        if ends.load(Ordering::Relaxed) {
            break;
        }
        let mut ready = [PollFd::new(bus, PollFlags::IN)];
        let _ = poll(&mut ready, Some(&STEP));
        let mut newest = None;
        while let Ok(frame) = bus.read_frame() {
            newest = ordered(&frame).or(newest);
        }
        let is_new = newest.filter(|(counter, _)| *counter != last.0);
        last = is_new.unwrap_or(last);
        machine.step(is_new.map(|(_, action)| action));
        // A machine that hangs repeats its first cycle.
        let number = if hangs { 7 } else { count as u8 };
        let mut frames = cycle(number, &machine.report(BEAMS));
        // Another device of the bus, a frame of another length, and in each eighth cycle
        // one frame is lost: none of them costs more than its own report.
        frames.insert(1, frame(0x123, &[1, 2, 3]));
        frames.insert(2, frame(PLACE, &[number]));
        if count % 8 == 7 {
            frames.remove(5);
        }
        for frame in frames {
            let _ = bus.write_frame(&frame);
        }
    }
    (machine.driven_m(), last.1)
}

/// A Unix socket on which the machine waits for the world.
fn bus(path: &Path) -> OwnedFd {
    let line = socket(AddressFamily::UNIX, SocketType::SEQPACKET, None).expect("a socket");
    let name = SocketAddrUnix::new(path).expect("a short path");
    bind(&line, &name)
        .and_then(|()| listen(&line, 1))
        .expect("it listens");
    line
}

fn drive(run: &str, hangs: bool) -> (f64, Action, Set) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("bus");
    let line = bus(&path);
    let ends = Arc::new(AtomicBool::new(false));
    let until = ends.clone();
    let firmware = std::thread::spawn(move || {
        let bus = CanSocket::from(accept(&line).expect("the world joins"));
        machine(&bus, hangs, &until)
    });
    let set = Set::new(run);
    let output = machine::run(&set, "can", "VLAPS_CAN", &path.display().to_string());
    ends.store(true, Ordering::Relaxed);
    machine::ended_well(&set, &output);
    let (driven_m, ordered) = firmware.join().expect("the machine");
    (driven_m, ordered, set)
}

#[test]
fn a_robot_behind_a_bus_drives_until_the_run_ends() {
    let (driven_m, ordered, set) = drive("can", false);
    let json = set.json();
    assert!(driven_m > 3.0, "{driven_m} m: {json}{}", set.logs());
    // On a loaded machine an observation may be too old; none may be invalid.
    let refusals = &json["processes"]["controller"]["refusals"];
    assert!(refusals.is_object(), "{json}");
    assert!(refusals["content"].is_null(), "{json}");
    assert_eq!(ordered, Action::BRAKE, "the last order");
    let line = "a report without the ranges of all beams is dropped";
    assert_eq!(set.logs().matches(line).count(), 1, "{}", set.logs());
}

#[test]
fn a_machine_that_repeats_its_report_stands() {
    let (driven_m, ..) = drive("canhangs", true);
    assert!(driven_m < 0.1, "{driven_m} m");
}

#[test]
fn a_missing_interface_is_one_line() {
    for (line, why) in [
        ("no-can0", "VLAPS_CAN=no-can0: "),
        ("/no/bus", "VLAPS_CAN=/no/bus: "),
    ] {
        let set = Set::new("nocan");
        let output = machine::run(&set, "can", "VLAPS_CAN", line);
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{told}");
        assert!(told.contains(why), "{told}");
    }
}

/// A report that the units of the bus hold exactly, but for the last digit.
fn sample(beams: usize) -> Report {
    Report {
        x_m: -123.45,
        y_m: 6.78,
        heading_rad: -2.5,
        speed_mps: 12.34,
        yaw_rate_radps: -0.5,
        ranges_m: (0..beams).map(|beam| beam as f32 / 4.0).collect(),
    }
}

fn take(reports: &mut Reports, frames: &[CanFrame]) -> Vec<Report> {
    let taken = frames
        .iter()
        .filter_map(|frame| reports.take(frame).cloned());
    taken.collect()
}

#[test]
fn a_cycle_is_the_report_that_was_sent() {
    for beams in [0, 1, 2, 3, 72, 240, BEAMS_CAN] {
        let (sent, mut reports) = (sample(beams), Reports::new(beams));
        let taken = take(&mut reports, &cycle(250, &sent));
        let [taken] = &taken[..] else {
            panic!("{beams} beams: {} reports", taken.len());
        };
        for (taken, sent, unit) in [
            (taken.x_m, sent.x_m, 0.01),
            (taken.y_m, sent.y_m, 0.01),
            (taken.heading_rad, sent.heading_rad, 1e-4),
            (taken.speed_mps, sent.speed_mps, 0.01),
            (taken.yaw_rate_radps, sent.yaw_rate_radps, 0.001),
        ] {
            assert!((taken - sent).abs() <= 1.1 * unit, "{taken} of {sent}");
        }
        assert_eq!(taken.ranges_m, sent.ranges_m, "{beams} beams");
        assert_eq!((reports.incomplete, reports.beyond), (0, 0));
        let mut observation = Observation::default();
        taken.fill(&mut observation);
        assert_eq!(observation.check(), Ok(()));
    }
}

#[test]
fn a_beam_without_a_return_has_no_range() {
    let mut sent = sample(6);
    sent.ranges_m[4] = f32::INFINITY;
    let taken = take(&mut Reports::new(6), &cycle(0, &sent));
    assert!(taken[0].ranges_m[4].is_nan(), "{taken:?}");
    assert_eq!(taken[0].ranges_m[5], sent.ranges_m[5]);
}

#[test]
fn a_lost_frame_costs_its_report_alone() {
    let sent = sample(72);
    let count = cycle(0, &sent).len();
    for lost in 0..count {
        let mut reports = Reports::new(72);
        let mut frames = cycle(1, &sent);
        frames.remove(lost);
        let taken = take(&mut reports, &frames);
        assert!(taken.is_empty(), "without frame {lost}");
        assert_eq!(
            take(&mut reports, &cycle(2, &sent)).len(),
            1,
            "after frame {lost}"
        );
        assert_eq!(
            reports.incomplete,
            u64::from(lost > 0),
            "without frame {lost}"
        );
    }
}

#[test]
fn frames_of_two_cycles_make_no_report() {
    let (sent, mut reports) = (sample(72), Reports::new(72));
    let (old, new) = (cycle(1, &sent), cycle(2, &sent));
    let mixed: Vec<_> = new[..2].iter().chain(&old[2..]).copied().collect();
    assert!(take(&mut reports, &mixed).is_empty());
    // A repeated cycle is not taken again, and a repeated frame counts once.
    assert_eq!(take(&mut reports, &new).len(), 1);
    assert!(take(&mut reports, &new).is_empty());
    let next = cycle(3, &sent);
    let twice: Vec<_> = next.iter().flat_map(|frame| [*frame, *frame]).collect();
    assert_eq!(take(&mut reports, &twice).len(), 1);
}

#[test]
fn other_frames_and_other_lidars_are_refused() {
    let sent = sample(72);
    let mut reports = Reports::new(72);
    for id in 0..=0x7ff {
        for length in 0..=8 {
            let bytes = [7; 8];
            assert!(
                reports.take(&frame(id, &bytes[..length])).is_none(),
                "{id:#x}"
            );
        }
    }
    assert_eq!(take(&mut reports, &cycle(1, &sent)).len(), 1);
    for beams in [1, 70, 71, 73, 75, 240] {
        let mut reports = Reports::new(beams);
        for number in [1, 2] {
            let taken = take(&mut reports, &cycle(number, &sent));
            assert!(taken.is_empty(), "{beams} beams");
        }
        assert!(reports.incomplete > 0, "{beams} beams");
        assert_eq!(reports.beyond > 0, beams < 72, "{beams} beams");
    }
}

#[test]
fn an_order_has_its_counter_and_its_action() {
    for (steer, pedal) in [(0.0, 0.0), (1.0, -1.0), (-1.0, 1.0), (0.25, -0.5)] {
        let sent = order(200, Action { steer, pedal }).expect("it fits");
        let (counter, action) = ordered(&sent.into()).expect("an order");
        assert_eq!(counter, 200);
        assert!((action.steer - steer).abs() < 1e-4, "{action:?}");
        assert!((action.pedal - pedal).abs() < 1e-4, "{action:?}");
    }
}

#[test]
fn a_bus_of_500_kbit_carries_what_the_guide_says() {
    // A frame of 8 bytes has at most 135 bits, stuffed and with the pause after it.
    let rate = |beams| 500_000 / (135 * (cycle(0, &sample(beams)).len() + 1));
    assert_eq!([rate(72), rate(240)], [137, 44]);
}
