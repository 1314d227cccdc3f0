use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSettingsBuilder, DefaultSolver, IPSolver, SolverStatus, SupportedConeT,
};
use shm_config::config::Mpc as Config;
use shm_config::message::PLANNED_MAX;

use crate::mpc::model::{INPUTS, Input, STATES, State, Step};
use crate::mpc::sparse::Sparse;

/// Slacks of a step: of its corridor, and of the place to stop at.
const SLACKS: usize = 2;
/// Variables of a step: the state after it, its input, its slacks.
const STEP: usize = STATES + INPUTS + SLACKS;
/// Places of the car that are kept in the corridor: rear and front. What is between
/// them follows, as both the car and a corridor without a sharp edge are straight.
pub(crate) const PROBES: usize = 2;
/// Inequalities of a step.
const LIMITS: usize = 2 * PROBES + 1 + SLACKS + 2 * INPUTS + 1;

/// One step of the problem: dynamics around a nominal motion, what is wanted,
/// and what is allowed.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Stage {
    /// From the state before the step and its input to the state after it.
    pub(crate) step: Step,
    /// The state wanted after the step.
    pub(crate) wanted: State,
    /// The input wanted in it.
    pub(crate) wanted_input: Input,
    /// Where each probe may be, m to the left: least and most.
    pub(crate) corridor_m: [(f64, f64); PROBES],
    /// No further than this, m along the road.
    pub(crate) stop_m: f64,
}

/// The data of the whole problem.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Task {
    /// The state now.
    pub(crate) now: State,
    /// The input obeyed last.
    pub(crate) last: Input,
    /// Offsets of the probes, m ahead of the car's middle.
    pub(crate) probes_m: [f64; PROBES],
    /// Least and most of each input.
    pub(crate) inputs: [(f64, f64); INPUTS],
}

/// The quadratic programme of the MPC with all its memory: states and inputs of
/// the horizon; linear dynamics; limits of which all but those of the inputs are
/// softened, so that there always is an answer.
pub(crate) struct Problem {
    config: Config,
    steps: usize,
    costs: Sparse,
    rows: Sparse,
    solver: Option<DefaultSolver<f64>>,
    cost_values: Vec<f64>,
    row_values: Vec<f64>,
    linear: Vec<f64>,
    bounds: Vec<f64>,
    effort: Effort,
    /// The next problems are not solved.
    is_given_up: bool,
}

impl std::fmt::Debug for Problem {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Problem").finish_non_exhaustive()
    }
}

/// The answer: states after each step, and the input of each.
#[derive(Debug, Clone, Default)]
pub(crate) struct Solution {
    pub(crate) states: heapless::Vec<State, PLANNED_MAX>,
    pub(crate) inputs: heapless::Vec<Input, PLANNED_MAX>,
}

/// What the solver needed for a problem.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Effort {
    /// Iterations of the interior-point method.
    pub iterations: u32,
    /// It found an answer.
    pub is_solved: bool,
}

impl Problem {
    /// Fixes the pattern; `time_limit_s` may be infinite.
    pub(crate) fn new(config: &Config, time_limit_s: f64) -> Self {
        let steps = config.steps as usize;
        let columns = steps * STEP;
        let mut costs = Vec::new();
        cost_entries(steps, &mut |row, column| costs.push((row, column)));
        let mut rows = Vec::new();
        for step in 0..steps {
            row_entries(steps, step, &mut |row, column| rows.push((row, column)));
        }
        let row_count = steps * (STATES + LIMITS);
        let mut problem = Self {
            config: *config,
            steps,
            cost_values: vec![0.0; costs.len()],
            row_values: vec![0.0; rows.len()],
            costs: Sparse::new(columns, columns, &costs),
            rows: Sparse::new(row_count, columns, &rows),
            solver: None,
            linear: vec![0.0; columns],
            bounds: vec![0.0; row_count],
            effort: Effort::default(),
            is_given_up: false,
        };
        problem.write_costs();
        problem.set_up(time_limit_s);
        problem
    }

    /// Makes the solver. Its first data are ones, so that no place of the
    /// pattern is taken for empty and the scaling fits a typical problem.
    fn set_up(&mut self, time_limit_s: f64) {
        let settings: DefaultSettings<f64> = DefaultSettingsBuilder::default()
            .verbose(false)
            .max_iter(self.config.iterations)
            .time_limit(time_limit_s)
            .presolve_enable(false)
            .input_sparse_dropzeros(false)
            // The scaling would stay that of the first data.
            .equilibrate_enable(false)
            // A millimetre and a milliradian are far below the model's error.
            .tol_gap_abs(1e-5)
            .tol_gap_rel(1e-5)
            .tol_feas(1e-5)
            .iterative_refinement_reltol(1e-8)
            .iterative_refinement_abstol(1e-8)
            .max_threads(1)
            .direct_solve_method("qdldl".into())
            .build()
            .unwrap_or_default();
        let equal = self.steps * STATES;
        let limited = self.steps * LIMITS;
        let cones = [
            SupportedConeT::ZeroConeT(equal),
            SupportedConeT::NonnegativeConeT(limited),
        ];
        self.row_values.fill(1.0);
        self.rows.write(&self.row_values);
        let costs: &CscMatrix<f64> = &self.costs.matrix;
        self.solver = DefaultSolver::new(
            costs,
            &self.linear,
            &self.rows.matrix,
            &self.bounds,
            &cones,
            settings,
        )
        .ok();
    }

    /// What the last problem needed.
    pub(crate) fn effort(&self) -> Effort {
        self.effort
    }

    /// Whether the next problems are given up without a solver, as at its limits.
    pub(crate) fn set_given_up(&mut self, is_given_up: bool) {
        self.is_given_up = is_given_up;
    }

    /// Solves; `None` when the solver reaches its limit of time or iterations.
    pub(crate) fn solve(&mut self, task: &Task, stages: &[Stage]) -> Option<Solution> {
        debug_assert_eq!(stages.len(), self.steps, "a stage for each step");
        self.effort = Effort::default();
        if self.is_given_up {
            return None;
        }
        self.write_linear(task, stages);
        self.write_rows(task, stages);
        let solver = self.solver.as_mut()?;
        solver.update_q(&self.linear).ok()?;
        solver.update_A(&self.rows.matrix.nzval).ok()?;
        solver.update_b(&self.bounds).ok()?;
        solver.solve();
        let is_good = matches!(
            solver.solution.status,
            SolverStatus::Solved | SolverStatus::AlmostSolved
        );
        let values = &solver.solution.x;
        self.effort = Effort {
            iterations: solver.solution.iterations,
            is_solved: is_good && values.iter().all(|value| value.is_finite()),
        };
        if !self.effort.is_solved {
            return None;
        }
        let mut solution = Solution::default();
        for step in values.chunks_exact(STEP) {
            // There is room for as many steps as a configuration may have.
            let _ = solution.states.push(std::array::from_fn(|at| step[at]));
            let _ = solution.inputs.push([step[STATES], step[STATES + 1]]);
        }
        Some(solution)
    }

    /// The quadratic costs never change: weights of the configuration.
    fn write_costs(&mut self) {
        let state = self.state_weights();
        let (input, change) = self.input_weights();
        let slack = self.config.weight_slack;
        let mut values = Vec::with_capacity(self.cost_values.len());
        for step in 0..self.steps {
            values.extend(state.map(|weight| 2.0 * weight));
            for at in 0..INPUTS {
                // Each input changes from the one before and to the one after.
                let changes = if step + 1 < self.steps { 2.0 } else { 1.0 };
                values.push(2.0 * (input[at] + changes * change[at]));
            }
            values.extend([2.0 * slack; SLACKS]);
        }
        for _ in 1..self.steps {
            values.extend(change.map(|weight| -2.0 * weight));
        }
        self.cost_values.copy_from_slice(&values);
        self.costs.write(&self.cost_values);
    }

    fn write_linear(&mut self, task: &Task, stages: &[Stage]) {
        let state = self.state_weights();
        let (input, change) = self.input_weights();
        let slack = self.config.weight_slack;
        for (index, (values, stage)) in self.linear.chunks_exact_mut(STEP).zip(stages).enumerate() {
            for at in 0..STATES {
                values[at] = -2.0 * state[at] * stage.wanted[at];
            }
            for at in 0..INPUTS {
                let before = if index == 0 { task.last[at] } else { 0.0 };
                values[STATES + at] =
                    -2.0 * (input[at] * stage.wanted_input[at] + change[at] * before);
            }
            values[STATES + INPUTS..].fill(slack);
        }
    }

    fn write_rows(&mut self, task: &Task, stages: &[Stage]) {
        let equal = self.steps * STATES;
        let mut at = 0;
        let mut entry = |value: f64| {
            self.row_values[at] = value;
            at += 1;
        };
        for (index, stage) in stages.iter().enumerate() {
            let Step { state, input, rest } = &stage.step;
            for row in 0..STATES {
                entry(-1.0);
                let mut known = rest[row];
                for (&weight, &now) in state[row].iter().zip(&task.now) {
                    match index {
                        0 => known += weight * now,
                        _ => entry(weight),
                    }
                }
                input[row].into_iter().for_each(&mut entry);
                self.bounds[index * STATES + row] = -known;
            }
            let limits = &mut self.bounds[equal + index * LIMITS..][..LIMITS];
            let mut rows = limits.iter_mut();
            let mut bound = |value: f64| {
                // As many as `row_entries` declares.
                if let Some(row) = rows.next() {
                    *row = value;
                }
            };
            for (probe_m, (least_m, most_m)) in task.probes_m.into_iter().zip(stage.corridor_m) {
                [1.0, probe_m, -1.0].into_iter().for_each(&mut entry);
                bound(most_m);
                [-1.0, -probe_m, -1.0].into_iter().for_each(&mut entry);
                bound(-least_m);
            }
            [1.0, -1.0].into_iter().for_each(&mut entry);
            // The solver does not take infinities here.
            bound(stage.stop_m.min(1e4));
            for _ in 0..SLACKS {
                entry(-1.0);
                bound(0.0);
            }
            for (least, most) in task.inputs {
                entry(1.0);
                bound(most);
                entry(-1.0);
                bound(-least);
            }
            entry(-1.0);
            bound(0.0);
        }
        self.rows.write(&self.row_values);
    }

    fn state_weights(&self) -> State {
        let config = &self.config;
        [
            0.0,
            config.weight_offset,
            config.weight_heading,
            config.weight_speed,
            0.0,
        ]
    }

    fn input_weights(&self) -> (Input, Input) {
        let config = &self.config;
        (
            [config.weight_steer, config.weight_accel],
            [config.weight_steer_change, config.weight_accel_change],
        )
    }
}

/// Places of the quadratic costs: the diagonal, and between inputs that follow
/// each other.
fn cost_entries(steps: usize, entry: &mut impl FnMut(usize, usize)) {
    for variable in 0..steps * STEP {
        entry(variable, variable);
    }
    for step in 1..steps {
        for at in 0..INPUTS {
            let input = step * STEP + STATES + at;
            entry(input - STEP, input);
        }
    }
}

/// Places of a step's rows, in the order that `write_rows` fills them.
fn row_entries(steps: usize, step: usize, entry: &mut impl FnMut(usize, usize)) {
    let here = step * STEP;
    for at in 0..STATES {
        let row = step * STATES + at;
        entry(row, here + at);
        if step > 0 {
            for before in 0..STATES {
                entry(row, here - STEP + before);
            }
        }
        for input in 0..INPUTS {
            entry(row, here + STATES + input);
        }
    }
    let mut row = steps * STATES + step * LIMITS;
    let mut next = |columns: &[usize]| {
        for &column in columns {
            entry(row, column);
        }
        row += 1;
    };
    let (along, left, heading, speed) = (here, here + 1, here + 2, here + 3);
    let (slack, stop) = (here + STATES + INPUTS, here + STATES + INPUTS + 1);
    for _ in 0..2 * PROBES {
        next(&[left, heading, slack]);
    }
    next(&[along, stop]);
    next(&[slack]);
    next(&[stop]);
    for input in 0..INPUTS {
        next(&[here + STATES + input]);
        next(&[here + STATES + input]);
    }
    next(&[speed]);
}

#[cfg(test)]
mod tests;
