//! A robot as a plant: when it is told to brake, and what it is given to read.

use std::cell::RefCell;
use std::rc::Rc;

use robot::driven::Driven;
use robot::plant::{Moment, Plant};
use robot::{Action, Config, Observation, Reading, Robot, Status};
use shm_config::Instant;
use shm_config::message::{Command, Driver, Header, Reason};

const FIRST: Moment = Moment {
    index: 1,
    tick: 1,
    now: Instant(0),
    missed: 0,
};

/// Logs its calls.
#[derive(Clone, Default)]
struct Logging(Rc<RefCell<Vec<String>>>);

impl Robot for Logging {
    fn begin(&mut self, seed: u64) -> Result<(), String> {
        self.0.borrow_mut().push(format!("begin {seed}"));
        match seed {
            u64::MAX => Err("no start".into()),
            _ => Ok(()),
        }
    }

    fn obey(&mut self, action: Action, step_s: f64) {
        let call = format!("obey {} {step_s}", action.pedal);
        self.0.borrow_mut().push(call);
    }

    fn brake(&mut self, step_s: f64) {
        self.0.borrow_mut().push(format!("brake {step_s}"));
    }

    fn read(&mut self, _observation: &mut Observation) -> Reading {
        Reading::Fresh
    }

    fn status(&self) -> Status {
        Status::default()
    }
}

/// A robot that begins an episode and obeys a command, with its calls so far.
fn driving(config: &Config) -> (Driven<Logging>, Logging) {
    let log = Logging::default();
    let mut driven = Driven::new(log.clone(), config);
    driven.begin(0, 3).expect("it begins");
    let command = Command {
        header: Header::default(),
        steer: 0.0,
        pedal: 0.5,
        driver: Driver::Expert.code(),
        reason: Reason::Configured.code(),
    };
    assert_eq!(driven.advance(FIRST, Some(&command)), None);
    (driven, log)
}

#[test]
fn an_observation_has_the_scanner_of_the_run() {
    let mut config = Config::default();
    config.scanner.field_of_view_deg = 270.0;
    (config.scanner.beams, config.scanner.range_m) = (1080, 30.0);
    let (mut driven, _) = driving(&config);
    let mut observation = Observation::default();
    assert_eq!(driven.observe(FIRST, &mut observation), Reading::Fresh);
    assert_eq!(observation.fan(), config.scanner.fan());
    assert_eq!(observation.lidar_max_m, 30.0);
}

const DRIVEN: [&str; 3] = ["brake 0", "begin 3", "obey 0.5 0.1"];

#[test]
fn it_brakes_before_each_episode_begins() {
    let (mut driven, log) = driving(&Config::default());
    driven.begin(1, 4).expect("it begins");
    let calls = log.0.borrow().clone();
    assert_eq!(calls[..3], DRIVEN);
    assert_eq!(calls[3..], ["brake 0", "begin 4"]);
}

#[test]
fn it_brakes_when_the_process_ends_or_an_episode_cannot_begin() {
    let (driven, log) = driving(&Config::default());
    drop(driven);
    assert_eq!(log.0.borrow()[..3], DRIVEN);
    assert_eq!(log.0.borrow()[3..], ["brake 0"]);
    let (mut driven, log) = driving(&Config::default());
    assert_eq!(driven.begin(1, u64::MAX), Err("no start".into()));
    drop(driven);
    assert_eq!(log.0.borrow().last().map(String::as_str), Some("brake 0"));
}
