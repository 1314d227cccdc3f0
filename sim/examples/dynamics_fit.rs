//! How far the car's dynamics are from the recorded ones: step responses on a
//! straight road, then recorded drives replayed open loop in windows.
//!
//! `cargo run --release -p sim --example dynamics_fit`

#[path = "../tests/recorded/mod.rs"]
mod recorded;

use recorded::Rollout;
use sim::dynamics::{Car, Motion};
use sim::model::{Forces, VehicleKind};
use vehicle::{Action, Vector, pose};

fn main() {
    let Some(folder) = recorded::folder() else {
        return;
    };
    step_responses(&folder);
    let golden = recorded::golden(&folder);
    for kind in ["wave", "idm"] {
        let rollouts = (0..recorded::SEEDS).map(|k| recorded::FIRST_SEED + k);
        let mut errors_m: [Vec<f64>; 3] = Default::default();
        for seed in rollouts {
            let rollout = Rollout::read(&folder, kind, seed);
            let ego = &golden[seed.to_string()]["ego"];
            let forces = Forces {
                engine_n: ego["engine"].as_f64().unwrap_or(f64::NAN),
                brake: ego["brake"].as_f64().unwrap_or(f64::NAN),
            };
            replay(
                &Car::new(VehicleKind::Default, forces),
                &rollout,
                &mut errors_m,
            );
        }
        println!("\n{kind}: open-loop position error, m");
        println!("after    windows   median      p90      max      bar");
        for ((after_s, bar_m), errors) in [(1.0, 0.1), (3.0, 0.5), (5.0, 1.5)]
            .iter()
            .zip(&mut errors_m)
        {
            errors.sort_by(f64::total_cmp);
            let at = |share: f64| errors[((errors.len() - 1) as f64 * share) as usize];
            println!(
                "{after_s:3.0} s {:10} {:8.4} {:8.4} {:8.4} {bar_m:8.1}",
                errors.len(),
                at(0.5),
                at(0.9),
                at(1.0)
            );
            assert!(at(0.5) < *bar_m, "the median is over the bar");
        }
    }
}

/// Each response from its start, against every recorded row of 3 s.
fn step_responses(folder: &std::path::Path) {
    let responses = recorded::step_responses(folder);
    let number = |value: &serde_json::Value| value.as_f64().unwrap_or(f64::NAN);
    let parameters = &responses["params"][0];
    let forces = Forces {
        engine_n: number(&parameters["max_engine_force"]),
        brake: number(&parameters["max_brake_force"]),
    };
    println!("step response           position, m   heading, rad   speed, m/s  (largest over 3 s)");
    for (name, rows) in responses.as_object().expect("an object") {
        if name == "params" {
            continue;
        }
        let (action, speed_mps) = meaning(name);
        let car = Car::new(VehicleKind::Default, forces);
        let mut motion = Motion::at_rest(pose(5.0, 7.0, 0.0), car.model)
            .with_velocity(Vector::new(speed_mps, 0.0), 0.0);
        let mut worst = [0.0_f64; 3];
        for row in rows.as_array().expect("rows").iter().take(30) {
            car.tick(&mut motion, action);
            let seen = motion.seen_position();
            let away_m = (seen.x - number(&row[0])).hypot(seen.y - number(&row[1]));
            worst[0] = worst[0].max(away_m);
            worst[1] = worst[1].max((motion.seen_heading_rad() - number(&row[2])).abs());
            worst[2] = worst[2].max((motion.speed_mps() - number(&row[3])).abs());
        }
        println!(
            "{name:22} {:12.4} {:14.4} {:12.4}",
            worst[0], worst[1], worst[2]
        );
    }
}

/// `steer_0.1_v15.0`, `brake_-0.5_from20`, `throttle_0.2`, `coast_20`.
fn meaning(name: &str) -> (Action, f64) {
    let words: Vec<&str> = name.split('_').collect();
    let number = |word: &str| word.trim_start_matches(|c: char| c.is_alphabetic()).parse();
    let number = |index: usize| words.get(index).and_then(|w| number(w).ok()).unwrap_or(0.0);
    let (steer, pedal, speed_mps) = match words[0] {
        "steer" => (number(1), 0.0, number(2)),
        "coast" => (0.0, 0.0, number(1)),
        _ => (0.0, number(1), number(2)),
    };
    (Action { steer, pedal }, speed_mps)
}

/// Windows of 5 s, one a second, warmed up for a second on the recorded
/// actions so that the springs are as they were, then put where the record is.
fn replay(car: &Car, rollout: &Rollout, errors_m: &mut [Vec<f64>; 3]) {
    let contact = |tick: usize| rollout.flags[tick][..3].contains(&true);
    for start in (10..rollout.act.len().saturating_sub(50)).step_by(10) {
        if (start - 10..start + 50).any(contact) {
            continue;
        }
        let place = |tick: usize| {
            let [x, y, heading_rad, vx, vy, yaw_rate, ..] = rollout.ego[tick];
            let ahead = Vector::new(vx, vy) * sim::dynamics::SUBSTEP_S;
            let turned = heading_rad + yaw_rate * sim::dynamics::SUBSTEP_S;
            (
                pose(x + ahead.x, y + ahead.y, turned),
                Vector::new(vx, vy),
                yaw_rate,
            )
        };
        let action = |tick: usize| {
            let [steer, pedal] = rollout.act[tick];
            Action { steer, pedal }
        };
        let (at, velocity, yaw_rate) = place(start - 10);
        let mut motion = Motion::settled(at, car).with_velocity(velocity, yaw_rate);
        for tick in start - 10..start {
            car.tick(&mut motion, action(tick));
        }
        let (at, velocity, yaw_rate) = place(start);
        motion = motion.moved_to(at).with_velocity(velocity, yaw_rate);
        for tick in 0..50 {
            car.tick(&mut motion, action(start + tick));
            if let Some(slot) = [9, 29, 49].iter().position(|&last| last == tick) {
                let [x, y, ..] = rollout.ego[start + tick + 1];
                let seen = motion.seen_position();
                errors_m[slot].push((seen.x - x).hypot(seen.y - y));
            }
        }
    }
}
