//! New weights: in shadow, in charge and watched, settled; or given up.

mod road;

use controller::{
    Begin, Controller, Exchange, Hand, Inputs, Intent, Look, News, Offer, Policy, PolicySlot,
};
use shm_config::Instant;
use shm_config::config::{Config, GateMode};
use shm_config::message::{Observation, Reason};
use vehicle::Action;

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

fn offer(version: u64, actions: [f64; 2]) -> Offer {
    Offer {
        policy: Box::new(Two {
            actions,
            version,
            count: 0,
        }),
        begin: Begin::Shadow,
    }
}

struct Car {
    controller: Controller,
    hand: Hand,
    exchange: Exchange,
    tick: u64,
}

impl Car {
    fn new() -> Self {
        let mut config = Config::default();
        config.gate.mode = GateMode::Policy;
        config.policy.watch_ticks = 50;
        Self {
            controller: Controller::new(config, PolicySlot::new(None)),
            hand: Hand::default(),
            exchange: Exchange::default(),
            tick: 1,
        }
    }

    fn adopt(&mut self, offer: Offer) {
        self.controller.adopt(offer, self.tick, &mut self.hand);
    }

    /// Ticks, and what was said meanwhile.
    fn drive(&mut self, ticks: u64) -> Vec<News> {
        let mut news = Vec::new();
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
                observation: Some(observation),
                ..Inputs::default()
            };
            self.controller.tick(&inputs, self.tick, now, Intent::Drive);
            self.controller.propose_in_shadow();
            self.controller.try_policies(&mut self.hand);
            assert!(matches!(self.hand.look(&self.exchange), Look::Seen(None)));
            let mut desk = self.exchange.desk.lock().expect("a desk");
            desk.returned = Default::default();
            news.extend(std::mem::take(&mut desk.news).into_iter().flatten());
            self.tick += 1;
        }
        news
    }

    fn version(&self) -> u64 {
        self.controller.step().weights_version
    }
}

/// Ticks once with all that the expert needs; why it drove who drove.
fn reason(car: &mut Car) -> Option<Reason> {
    let now = Instant(car.tick * 100_000_000);
    let inputs = Inputs {
        observation: Some(road::observation(now)),
        plan: Some(road::plan(now, 0.0)),
        ..Inputs::default()
    };
    car.controller.tick(&inputs, car.tick, now, Intent::Drive);
    car.controller.propose_in_shadow();
    car.controller.try_policies(&mut car.hand);
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
fn good_weights_drive_after_their_probation_and_no_tick_sooner() {
    let mut car = Car::new();
    car.adopt(offer(1, [0.0, 0.01]));
    let news = car.drive(20);
    assert_eq!(car.version(), 0, "in shadow, they have proposed nothing");
    assert_eq!(
        news,
        [
            News::Adopted {
                version: 1,
                tick: 1
            },
            News::Promoted {
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
    let news = car.drive(20);
    assert!(
        matches!(
            news[1],
            News::RolledBack {
                version: 2,
                charged: (1, 1),
                ..
            }
        ),
        "{news:?}"
    );
    car.drive(1);
    assert_eq!(car.version(), 1);
}

/// Smooth for its probation, then not.
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
    car.adopt(Offer {
        policy: Box::new(Turncoat(0)),
        begin: Begin::Shadow,
    });
    car.drive(21);
    assert_eq!(car.version(), 9, "the probation is passed");
    let news = car.drive(11);
    let [
        News::RolledBack {
            version: 9,
            charged: (1, 1),
            fault,
            ..
        },
    ] = news[..]
    else {
        panic!("{news:?}");
    };
    assert_eq!(fault.to_string(), "an answer was not finite");
    car.drive(1);
    assert_eq!(car.version(), 1, "those before are back");
}
