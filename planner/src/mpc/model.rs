use tracker::YAW_LAG_S;

/// Numbers of a state: distance along the road, m; offset to its left, m;
/// heading against it, rad; speed, m/s; turning rate, rad/s.
pub(crate) const STATES: usize = 5;
/// Numbers of an input: angle of the wheels, rad; acceleration, m/s².
pub(crate) const INPUTS: usize = 2;
pub(crate) type State = [f64; STATES];
pub(crate) type Input = [f64; INPUTS];

/// A step of the dynamics, made linear: `next = state * x + input * u + rest`.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Step {
    pub(crate) state: [[f64; STATES]; STATES],
    pub(crate) input: [[f64; INPUTS]; STATES],
    pub(crate) rest: State,
}

/// The bicycle of Eq. 3 to 6 in the frame of the road, with a turning rate that
/// follows the wheels with a lag.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Model {
    pub(crate) wheelbase_m: f64,
    /// How strongly the wheels turn the car, compared with the bicycle.
    pub(crate) steering_gain: f64,
    pub(crate) step_s: f64,
}

impl Model {
    /// The step of a road of this curvature, 1/m, around a state and an input.
    pub(crate) fn linear(&self, curvature: f64, state: &State, input: &Input) -> Step {
        let [_, left_m, heading, speed, _] = *state;
        let dt = self.step_s;
        let (sin, cos) = heading.sin_cos();
        let bend = (1.0 - curvature * left_m).max(0.2);
        // Speed along the road, and its derivatives.
        let by_speed = cos / bend;
        let by_left = speed * cos * curvature / (bend * bend);
        let by_heading = -speed * sin / bend;
        let follow = 1.0 - (-dt / YAW_LAG_S).exp();
        let turn = self.steering_gain / self.wheelbase_m;
        let (tan, secant) = (input[0].tan(), 1.0 / input[0].cos());
        let state_step = [
            [1.0, dt * by_left, dt * by_heading, dt * by_speed, 0.0],
            [0.0, 1.0, dt * speed * cos, dt * sin, 0.0],
            [
                0.0,
                -dt * curvature * by_left,
                1.0 - dt * curvature * by_heading,
                -dt * curvature * by_speed,
                dt,
            ],
            [0.0, 0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0, follow * turn * tan, 1.0 - follow],
        ];
        let input_step = [
            [0.0, 0.0],
            [0.0, 0.0],
            [0.0, 0.0],
            [0.0, dt],
            [follow * turn * speed * secant * secant, 0.0],
        ];
        let mut rest = self.next(curvature, state, input);
        for row in 0..STATES {
            for column in 0..STATES {
                rest[row] -= state_step[row][column] * state[column];
            }
            for column in 0..INPUTS {
                rest[row] -= input_step[row][column] * input[column];
            }
        }
        Step {
            state: state_step,
            input: input_step,
            rest,
        }
    }

    /// The step itself.
    pub(crate) fn next(&self, curvature: f64, state: &State, input: &Input) -> State {
        let [along_m, left_m, heading, speed, rate] = *state;
        let dt = self.step_s;
        let (sin, cos) = heading.sin_cos();
        let along_mps = speed * cos / (1.0 - curvature * left_m).max(0.2);
        let follow = 1.0 - (-dt / YAW_LAG_S).exp();
        let wanted = self.steering_gain * speed * input[0].tan() / self.wheelbase_m;
        [
            along_m + dt * along_mps,
            left_m + dt * speed * sin,
            heading + dt * (rate - curvature * along_mps),
            speed + dt * input[1],
            rate + follow * (wanted - rate),
        ]
    }
}
