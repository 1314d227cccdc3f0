//! Tests that bytes and files become keys, and keys become the car's action.

use shm_config::Instant;
use shm_config::message::{Message, Takeover};
use supervisor::takeover::driver::HumanDriver;
use supervisor::takeover::key::Key;
use supervisor::takeover::keyboard::Decoder;
use supervisor::takeover::script::KeyScript;

const MS: u64 = 1_000_000;
const BEGIN: Instant = Instant(5_000 * MS);

fn at(ms: u64) -> Instant {
    BEGIN.after_ns(ms * MS)
}

/// A human driver who took over at the start.
fn driving() -> HumanDriver {
    let mut person = HumanDriver::default();
    person.press(Key::Switch, BEGIN);
    assert!(person.has_taken_over());
    person
}

fn steer(person: &mut HumanDriver, ms: u64) -> f64 {
    person.advance(at(ms));
    person.takeover().steer
}

fn pedal(person: &mut HumanDriver, ms: u64) -> f64 {
    person.advance(at(ms));
    person.takeover().pedal
}

#[track_caller]
fn assert_near(value: f64, expected: f64) {
    assert!(
        (value - expected).abs() < 1e-9,
        "{value} instead of {expected}"
    );
}

#[test]
fn keys_have_no_effect_before_a_takeover() {
    let mut person = HumanDriver::default();
    for key in [Key::Left, Key::Gas, Key::GiveBack, Key::Brake] {
        person.press(key, BEGIN);
        person.advance(at(300));
        assert_eq!(person.takeover(), Takeover::default(), "{key:?}");
    }
    for give_back in [Key::Switch, Key::GiveBack] {
        let mut person = driving();
        assert_eq!(person.takeover().active, 1);
        person.press(Key::Left, at(10));
        assert!(steer(&mut person, 200) > 0.0);
        person.press(give_back, at(200));
        assert_eq!(person.takeover(), Takeover::default());
        // A key held before the takeover no longer counts as held.
        person.press(Key::Switch, at(210));
        assert_eq!(steer(&mut person, 300), 0.0);
    }
}

#[test]
fn a_key_steers_while_it_is_held_and_the_wheel_springs_back() {
    let mut person = driving();
    person.press(Key::Left, BEGIN);
    assert_near(steer(&mut person, 250), 0.1);
    assert_near(steer(&mut person, 500), 0.2);
    assert_near(steer(&mut person, 540), 0.1);
    assert_near(steer(&mut person, 600), 0.0);
    assert_near(steer(&mut person, 5_000), 0.0);
    person.press(Key::Right, at(5_000));
    assert_near(steer(&mut person, 5_250), -0.1);
    // The opposite key first brings the wheel back, then turns it outwards: 40 ms and
    // 60 ms.
    person.press(Key::Left, at(5_250));
    assert_near(steer(&mut person, 5_350), 0.4 * 0.06);
}

#[test]
fn repetitions_hold_a_key_without_a_dip_up_to_the_lock() {
    let mut person = driving();
    person.press(Key::Right, BEGIN);
    let mut last = 0.0;
    // The terminal's repeat delay, then its repetitions.
    for ms in (490..3_000).step_by(40) {
        person.press(Key::Right, at(ms));
        let now = person.takeover().steer;
        assert!(now <= last, "{now} after {last} at {ms} ms");
        last = now;
    }
    assert_eq!(last, -1.0);
    // The last repetition, at 2,970 ms, holds for 150 ms more.
    assert_eq!(steer(&mut person, 3_120), -1.0);
    assert!(steer(&mut person, 3_140) > -1.0);
}

#[test]
fn the_brake_comes_faster_than_the_gas() {
    let mut person = driving();
    person.press(Key::Gas, BEGIN);
    assert_near(pedal(&mut person, 400), 0.4);
    person.press(Key::Brake, at(400));
    // 80 ms to release the gas, then 5 a second.
    assert_near(pedal(&mut person, 500), -0.1);
    assert_near(pedal(&mut person, 700), -1.0);
    assert_near(pedal(&mut person, 900), -1.0);
    assert_near(pedal(&mut person, 1_000), -0.5);
    assert_near(pedal(&mut person, 1_100), 0.0);
}

/// The same keys at the same times give the same action, however often the supervisor
/// reads them, and the action passes the controller's checks.
#[test]
fn the_action_does_not_depend_on_how_often_the_keys_are_read() {
    let keys = [Key::Left, Key::Gas, Key::Right, Key::Brake, Key::Left];
    let drive = |look_ms: u64| {
        let mut person = driving();
        let mut path = Vec::new();
        for ms in 0..4_000 {
            if ms % 370 == 0 {
                person.press(keys[(ms / 370) as usize % keys.len()], at(ms));
            }
            if ms % look_ms == 0 {
                person.advance(at(ms));
                assert_eq!(person.takeover().check(), Ok(()), "at {ms} ms");
            }
            if ms % 1_000 == 999 {
                person.advance(at(ms));
                path.extend([person.takeover().steer, person.takeover().pedal]);
            }
        }
        path
    };
    let coarse = drive(1_000);
    assert!(coarse.iter().any(|value| *value != 0.0), "{coarse:?}");
    for (a, b) in coarse.into_iter().zip(drive(1)) {
        assert_near(a, b);
    }
}

#[test]
fn bytes_of_a_terminal_are_keys() {
    let keys = |looks: &[&[u8]]| {
        let mut decoder = Decoder::default();
        let decode = |bytes: &&[u8]| decoder.decode(bytes);
        looks.iter().flat_map(decode).collect::<Vec<_>>()
    };
    let drive = [Key::Gas, Key::Left, Key::Brake, Key::Right];
    assert_eq!(keys(&[b"wasd"]), drive);
    assert_eq!(keys(&[b"WASD"]), drive);
    assert_eq!(keys(&[b"\x1b[A\x1b[D\x1b[B\x1b[C"]), drive);
    assert_eq!(keys(&[b"\x1bOA\x1bOD\x1bOB\x1bOC"]), drive);
    assert_eq!(keys(&[b"\x1b[1;2A"]), [Key::Gas], "with Shift");
    assert_eq!(keys(&[b"\x1b", b"[", b"A"]), [Key::Gas], "over a slow line");
    assert_eq!(keys(&[b" ", b"q"]), [Key::Switch, Key::GiveBack]);
    assert_eq!(keys(&[b"\x1b"]), [], "a sequence may follow");
    assert_eq!(keys(&[b"\x1b", b""]), [Key::GiveBack]);
    assert_eq!(keys(&[b"\x1b", b"", b"w"]), [Key::GiveBack, Key::Gas]);
    assert_eq!(keys(&[b"\x1b\x1b", b""]), [Key::GiveBack, Key::GiveBack]);
    assert_eq!(keys(&[b"\x1bw"]), [Key::GiveBack], "Alt and a key");
    assert_eq!(
        keys(&[b"\x1b[3~xyz\r\n\t\xff\x00"]),
        [],
        "Delete and others"
    );
    let all: Vec<u8> = (0..=255).chain(0..=255).collect();
    // Every byte is decoded; in the second round no escape sequence is left open.
    assert!(keys(&[&all, b"", b" "]).ends_with(&[Key::Switch]));
}

#[test]
fn a_file_of_keys_is_read_line_by_line_or_refused_with_its_line() {
    let text = "# a person\n\n0.5 space\n 1 left \n1.0 W\n1.25 Esc\n";
    let mut script = KeyScript::parse(text).expect("well formed");
    assert_eq!(script.due(499_999_999), None);
    assert_eq!(script.due(500_000_000), Some((500_000_000, Key::Switch)));
    assert_eq!(script.due(500_000_000), None);
    assert_eq!(script.due(u64::MAX), Some((1_000_000_000, Key::Left)));
    assert_eq!(script.due(u64::MAX), Some((1_000_000_000, Key::Gas)));
    assert_eq!(script.due(u64::MAX), Some((1_250_000_000, Key::GiveBack)));
    assert_eq!(script.due(u64::MAX), None);
    for (text, parts) in [
        ("1 space\n2 jump\n", ["2: 2 jump", "the key must be"]),
        ("soon space\n", ["1: soon space", "seconds"]),
        ("nan space\n", ["1: nan space", "seconds"]),
        ("-1 space\n", ["1: -1 space", "seconds"]),
        ("1e9 space\n", ["1: 1e9 space", "seconds"]),
        ("\n2 space\n1 left\n", ["3: 1 left", "in order"]),
        ("1\n", ["1: 1", "TIME_S KEY"]),
        ("1 space 2\n", ["1: 1 space 2", "TIME_S KEY"]),
    ] {
        let error = KeyScript::parse(text).expect_err(text);
        for part in parts {
            assert!(error.contains(part), "'{part}' is missing in: {error}");
        }
    }
}
