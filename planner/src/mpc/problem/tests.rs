//! The solution against the problem: what it claims holds, and nothing near it
//! is cheaper.

use proptest::prelude::*;

use super::*;
use crate::mpc::model::Model;

const STEPS: usize = 12;

fn config() -> Config {
    Config {
        steps: STEPS as u32,
        ..Config::default()
    }
}

/// A random problem: a bent road, a corridor that may be impossible, a place to
/// stop at that may be behind the car.
fn random_problem() -> impl Strategy<Value = (Task, Vec<Stage>)> {
    let now = (-4.0..4.0, -1.5..1.5, 0.0..20.0, -1.0..1.0);
    let last = (-0.6..0.6, -8.0..2.5);
    let road = (-0.15..0.15, 0.5..12.0, -5.0..60.0);
    let walls = prop::collection::vec((-4.0..3.0, 0.0..5.0), STEPS);
    (now, last, road, walls).prop_map(|(now, last, road, walls)| {
        let (left_m, heading, speed, rate) = now;
        let (curvature, wanted_mps, stop_m) = road;
        let now = [0.0, left_m, heading, speed, rate];
        let model = Model {
            wheelbase_m: 2.469,
            steering_gain: 1.0,
            step_s: 0.1,
        };
        let mut before = now;
        let stages = walls
            .into_iter()
            .map(|(least_m, width_m)| {
                let input = [0.05, 0.0];
                let stage = Stage {
                    step: model.linear(curvature, &before, &input),
                    wanted: [before[0] + 0.1 * wanted_mps, 0.0, 0.0, wanted_mps, 0.0],
                    wanted_input: input,
                    corridor_m: [(least_m, least_m + width_m); PROBES],
                    stop_m,
                };
                before = stage.wanted;
                stage
            })
            .collect();
        let task = Task {
            now,
            last: last.into(),
            probes_m: [-1.8, 1.8],
            inputs: [(-0.698, 0.698), (-8.0, 2.76)],
        };
        (task, stages)
    })
}

fn after(stage: &Stage, before: &State, input: &Input) -> State {
    let Step {
        state,
        input: by,
        rest,
    } = &stage.step;
    std::array::from_fn(|row| {
        let states: f64 = (0..STATES).map(|at| state[row][at] * before[at]).sum();
        let inputs: f64 = (0..INPUTS).map(|at| by[row][at] * input[at]).sum();
        rest[row] + states + inputs
    })
}

/// The cost of inputs by the book: roll out, then the least slacks that allow it.
/// Infinite when an input, or a speed, is outside its limits.
fn cost(config: &Config, task: &Task, stages: &[Stage], inputs: &[Input]) -> f64 {
    let (mut state, mut last, mut total) = (task.now, task.last, 0.0);
    for (stage, input) in stages.iter().zip(inputs) {
        state = after(stage, &state, input);
        let [along_m, left_m, heading, speed, _] = state;
        let outside = |(value, (least, most)): (&f64, (f64, f64))| !(least..=most).contains(value);
        if speed < 0.0 || input.iter().zip(task.inputs).any(outside) {
            return f64::INFINITY;
        }
        let slack = task
            .probes_m
            .iter()
            .zip(stage.corridor_m)
            .fold(0.0_f64, |slack, probe| {
                let (offset_m, (least_m, most_m)) = probe;
                let at_m = left_m + offset_m * heading;
                slack.max(at_m - most_m).max(least_m - at_m)
            });
        let late = (along_m - stage.stop_m).max(0.0);
        let square = |value: f64| value * value;
        let wanted = &stage.wanted;
        total += config.weight_offset * square(left_m - wanted[1])
            + config.weight_heading * square(heading - wanted[2])
            + config.weight_speed * square(speed - wanted[3])
            + config.weight_steer * square(input[0] - stage.wanted_input[0])
            + config.weight_accel * square(input[1] - stage.wanted_input[1])
            + config.weight_steer_change * square(input[0] - last[0])
            + config.weight_accel_change * square(input[1] - last[1])
            + config.weight_slack * (slack + square(slack) + late + square(late));
        last = *input;
    }
    total
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn there_always_is_an_answer_and_none_near_it_is_cheaper(
        (task, stages) in random_problem(),
        nudges in prop::collection::vec((0..STEPS, 0..INPUTS, -0.2..0.2f64), 60),
    ) {
        let config = config();
        let mut problem = Problem::new(&config, f64::INFINITY);
        let solution = problem.solve(&task, &stages);
        prop_assert!(solution.is_some(), "{:?}", problem.effort());
        let solution = solution.unwrap();
        let mut before = task.now;
        for ((stage, input), state) in stages.iter().zip(&solution.inputs).zip(&solution.states) {
            let expected = after(stage, &before, input);
            for at in 0..STATES {
                prop_assert!((state[at] - expected[at]).abs() < 1e-3, "{state:?} {expected:?}");
            }
            before = *state;
        }
        // Its limits hold to the solver's tolerance; a hair inside they hold exactly.
        let inside = |inputs: &[Input]| -> Vec<Input> {
            let mut speed = task.now[3];
            inputs.iter().map(|input| {
                let [steer, accel] = *input;
                let least = (-8.0_f64).max(-speed / 0.1);
                let accel = accel.clamp(least.min(2.76), 2.76);
                speed = (speed + 0.1 * accel).max(0.0);
                [steer.clamp(-0.698, 0.698), accel]
            }).collect()
        };
        let found = cost(&config, &task, &stages, &inside(&solution.inputs));
        prop_assert!(found.is_finite() || task.now[3] == 0.0);
        for (step, at, nudge) in nudges {
            let mut inputs = solution.inputs.to_vec();
            inputs[step][at] += nudge;
            let other = cost(&config, &task, &stages, &inside(&inputs));
            prop_assert!(found <= other * (1.0 + 1e-3) + 1e-2, "{found} {other}");
        }
    }
}
