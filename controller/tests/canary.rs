//! New weights: in shadow, active and watched, settled; or rolled back.

use controller::{
    Candidate, Controller, Exchanged, Inputs, Intent, Mailbox, Policy, PolicySlot, StartStage,
    SwapEvent, TickEnd,
};
use shm_config::Instant;
use shm_config::config::{Config, GateMode};
use shm_config::message::{Observation, Reason};
use vehicle::Action;

use crate::road;

/// Answers alternately.
struct Two {
    actions: [f64; 2],
    version: u64,
    count: usize,
}

impl Policy for Two {
    fn infer(&mut self, _: &[f32]) -> Option<Action> {
        self.count += 1;
        Some(Action {
            steer: self.actions[self.count % 2],
            pedal: 0.0,
        })
    }
    fn version(&self) -> u64 {
        self.version
    }
    fn hash(&self) -> u64 {
        self.version
    }
}

fn offer(version: u64, actions: [f64; 2]) -> Candidate {
    Candidate {
        policy: Box::new(Two {
            actions,
            version,
            count: 0,
        }),
        start: StartStage::Shadow,
    }
}

struct Car {
    controller: Controller,
    end: TickEnd,
    mailbox: Mailbox,
    tick: u64,
}

impl Car {
    fn new() -> Self {
        let mut config = Config::default();
        config.gate.mode = GateMode::Policy;
        config.policy.watch_ticks = 50;
        Self {
            controller: Controller::new(config, PolicySlot::new(None)),
            end: TickEnd::default(),
            mailbox: Mailbox::default(),
            tick: 1,
        }
    }

    fn adopt(&mut self, offer: Candidate) {
        self.controller.adopt(offer, self.tick, &mut self.end);
    }

    /// Ticks, and what was reported meanwhile.
    fn drive(&mut self, ticks: u64) -> Vec<SwapEvent> {
        let mut events = Vec::new();
        for _ in 0..ticks {
            let now = Instant(self.tick * 100_000_000);
            let mut observation = Observation {
                beam_count: 240,
                lidar_max_m: 50.0,
                ..Observation::default()
            };
            observation.ranges_m[..240].fill(50.0);
            (observation.road.left_m, observation.road.right_m) = (5.0, 5.0);
            observation.header.taken_ns = now.0;
            let inputs = Inputs {
                observation: observation.into(),
                ..Inputs::default()
            };
            self.controller.tick(&inputs, self.tick, now, Intent::Drive);
            self.controller.propose_in_shadow();
            self.controller.run_canary(&mut self.end);
            assert!(matches!(
                self.end.exchange(&self.mailbox),
                Exchanged::Done(None)
            ));
            let mut contents = self.mailbox.contents.lock().expect("a mailbox");
            contents.returned = Default::default();
            events.extend(std::mem::take(&mut contents.events).into_iter().flatten());
            self.tick += 1;
        }
        events
    }

    fn version(&self) -> u64 {
        self.controller.step().weights_version
    }
}

/// Ticks once with all that the expert needs; why it drove who drove.
fn reason(car: &mut Car) -> Option<Reason> {
    let now = Instant(car.tick * 100_000_000);
    let inputs = Inputs {
        observation: road::observation(now).into(),
        plan: road::plan(now, 0.0).into(),
        ..Inputs::default()
    };
    car.controller.tick(&inputs, car.tick, now, Intent::Drive);
    car.controller.propose_in_shadow();
    car.controller.run_canary(&mut car.end);
    car.tick += 1;
    car.controller.step().reason()
}

#[test]
fn that_the_only_weights_are_in_shadow_is_a_reason_of_its_own() {
    let mut car = Car::new();
    assert_eq!(reason(&mut car), Some(Reason::Unloaded));
    car.adopt(offer(1, [0.0, 0.01]));
    for _ in 0..20 {
        assert_eq!(reason(&mut car), Some(Reason::Shadow));
    }
    assert_eq!(reason(&mut car), Some(Reason::Configured));
}

#[test]
fn good_weights_drive_after_their_canary_period_and_no_tick_sooner() {
    let mut car = Car::new();
    car.adopt(offer(1, [0.0, 0.01]));
    let events = car.drive(20);
    assert_eq!(car.version(), 0, "in shadow, they have proposed nothing");
    assert_eq!(
        events,
        [
            SwapEvent::Adopted {
                version: 1,
                tick: 1
            },
            SwapEvent::Promoted {
                version: 1,
                tick: 21
            }
        ]
    );
    car.drive(1);
    assert_eq!(car.version(), 1);
    assert_eq!(car.controller.step().policy.present, 1);
}

#[test]
fn weights_that_jump_are_given_up_in_shadow_and_those_before_drive_on() {
    let mut car = Car::new();
    car.adopt(offer(1, [0.0, 0.01]));
    car.drive(100);
    car.adopt(offer(2, [-1.0, 1.0]));
    let events = car.drive(20);
    assert!(
        matches!(
            events[1],
            SwapEvent::RolledBack {
                version: 2,
                active: (1, 1),
                ..
            }
        ),
        "{events:?}"
    );
    car.drive(1);
    assert_eq!(car.version(), 1);
}

/// Smooth for its canary period, then not.
struct Turncoat(u64);

impl Policy for Turncoat {
    fn infer(&mut self, _: &[f32]) -> Option<Action> {
        self.0 += 1;
        let steer = match self.0 {
            0..=20 => 0.0,
            21..=30 => 1.0 - 2.0 * (self.0 % 2) as f64,
            _ => f64::NAN,
        };
        Some(Action { steer, pedal: 0.0 })
    }
    fn version(&self) -> u64 {
        9
    }
    fn hash(&self) -> u64 {
        9
    }
}

#[test]
fn watched_weights_are_rolled_back_to_those_before() {
    let mut car = Car::new();
    car.adopt(offer(1, [0.0, 0.01]));
    car.drive(100);
    car.adopt(Candidate {
        policy: Box::new(Turncoat(0)),
        start: StartStage::Shadow,
    });
    car.drive(21);
    assert_eq!(car.version(), 9, "the canary period is passed");
    let events = car.drive(11);
    let [
        SwapEvent::RolledBack {
            version: 9,
            active: (1, 1),
            fault,
            ..
        },
    ] = events[..]
    else {
        panic!("{events:?}");
    };
    assert_eq!(fault.to_string(), "an answer was not finite");
    car.drive(1);
    assert_eq!(car.version(), 1, "those before are back");
}
