//! Model-predictive control: a path along the road by dynamic programming, a
//! speed along it without collisions, and a quadratic programme on the bicycle
//! that follows both (`planner.method = "mpc"`).
//!
//! ```text
//! Observation -> Tracker, EgoFilter -> Line, Field -> Lattice -> Way -> Problem -> Plan
//! ```
//!
//! The lattice decides what a convex programme cannot: on which side an obstacle
//! is passed. Around its path the dynamics are linearised and the free corridor
//! is read from the field; limits are softened with slacks, so that there is
//! always an answer. When the solver fails all the same, the last answer is
//! continued, and when that has ended, the car brakes.
//!
//! The solver (clarabel) keeps its symbolic factorisation and updates its data
//! in place, but allocates a little for each solution; `tests/tests/mpc_alloc.rs`
//! counts it.

mod body;
mod field;
mod lattice;
mod line;
mod model;
mod nearby;
mod problem;
mod sparse;
mod speed;
mod traffic;

use shm_config::config::{Config, Mpc as Settings};
use shm_config::message::{
    Header, Observation, PLANNED_MAX, Plan, PlanOutcome, PlannedAction, Waypoint,
};
use vehicle::{Control, Point, Pose, Vehicle, pose};

use crate::rrt_star::header;
use body::Body;
use field::Field;
use lattice::{Ground, Lattice, Path};
use line::{Line, Place};
use model::{Model, State};
use nearby::Nearby;
use problem::{Problem, Solution, Stage, Task};
use tracker::{EgoFilter, Moving, Tracker};

pub use problem::Effort;
use speed::{Profile, Way};
use traffic::Traffic;

/// Longest time for which the memory is used, s.
const MEMORY_S: f64 = 0.5;
/// Distance kept from the corridor's limits, m, where there is room.
const ROOM_M: f64 = 0.3;
/// The clearance beside the path may be less than the path's own by this, m.
const GIVE_M: f64 = 0.15;
/// Step of the search for the corridor's limits, m.
const LOOK_M: f64 = 0.25;
/// Hardest braking that is planned, m/s²: below where friction ends (11.8).
const BRAKE_MAX_MPS2: f64 = 8.0;

/// The model-predictive expert with all its memory.
#[derive(Debug)]
pub struct Mpc {
    settings: Settings,
    vehicle: Vehicle,
    body: Body,
    tracker: Tracker,
    nearby: Nearby,
    traffic: Box<Traffic>,
    field: Field,
    lattice: Lattice,
    problem: Problem,
    stages: Box<[Stage]>,
    memory: Option<Memory>,
}

/// The memory from one plan to the next.
#[derive(Debug)]
struct Memory {
    header: Header,
    ego: EgoFilter,
    path_world: heapless::Vec<Point, { lattice::STATIONS + 1 }>,
    /// The solver's last answer; empty before the first.
    actions: heapless::Vec<PlannedAction, PLANNED_MAX>,
    /// The instant of the observation that it answers.
    answered_ns: u64,
}

impl Memory {
    /// The part of the last answer that is still ahead, by the time that has passed and
    /// not by the number of plans.
    fn actions_left(&self, now_ns: u64, step_s: f64) -> &[PlannedAction] {
        let passed_s = now_ns.saturating_sub(self.answered_ns) as f64 * 1e-9;
        // The same rule as `Plan::action_at`.
        let passed = (passed_s / step_s + 1e-6) as usize;
        self.actions.get(passed..).unwrap_or_default()
    }
}

impl Mpc {
    /// The only place that allocates, except the solver.
    pub fn new(config: &Config) -> Self {
        let time_limit_s = match config.run.is_lockstep() {
            true => f64::INFINITY,
            false => config.mpc.time_limit_ms * 1e-3,
        };
        Self {
            settings: config.mpc,
            vehicle: config.vehicle,
            body: Body::new(&config.vehicle),
            tracker: Tracker::default(),
            nearby: Nearby::default(),
            traffic: Box::default(),
            field: Field::new(),
            lattice: Lattice::new(),
            problem: Problem::new(&config.mpc, time_limit_s),
            stages: vec![Stage::default(); config.mpc.steps as usize].into(),
            memory: None,
        }
    }

    /// What the solver needed for the last plan.
    pub fn effort(&self) -> Effort {
        self.problem.effort()
    }

    /// Forgets everything: an episode begins.
    pub fn forget(&mut self) {
        self.memory = None;
        self.tracker.forget();
        self.nearby.forget();
    }

    /// Plans for one admitted observation.
    ///
    /// Writes all of `out` except the producer and sequence number of its header
    /// and the planning time, which are the caller's.
    pub fn plan(&mut self, observation: &Observation, out: &mut Plan) {
        self.plan_in_parts(observation, out, || ());
    }

    /// Plans again as a recorded plan was made: without the solver where it gave up.
    pub(crate) fn plan_again(
        &mut self,
        observation: &Observation,
        recorded: &Plan,
        out: &mut Plan,
    ) {
        self.problem.set_given_up(recorded.iterations == 0);
        self.plan(observation, out);
        self.problem.set_given_up(false);
    }

    /// Plans without a memory, among what is known to move.
    pub(crate) fn plan_anew(
        &mut self,
        observation: &Observation,
        moving: &[Moving],
        out: &mut Plan,
    ) {
        self.forget();
        self.tracker.suppose(observation, moving);
        self.plan_as_seen(observation, EgoFilter::new(&observation.ego), out, || ());
    }

    /// As [`Mpc::plan`]; `prepared` is called before the search begins.
    pub(crate) fn plan_in_parts(
        &mut self,
        observation: &Observation,
        out: &mut Plan,
        prepared: impl FnOnce(),
    ) {
        let ego = self.remember(observation);
        self.plan_as_seen(observation, ego, out, prepared);
    }

    /// Plans with the tracker's sightings of this observation.
    fn plan_as_seen(
        &mut self,
        observation: &Observation,
        ego: EgoFilter,
        out: &mut Plan,
        prepared: impl FnOnce(),
    ) {
        let line = Line::new(observation);
        let (sight, world_from_body) = (observation.fan().sight(), world_from_body(observation));
        let sightings = self.tracker.sightings();
        self.nearby
            .update(&world_from_body, &sight, &self.body, sightings);
        self.field.fill(&line, sightings, ego.speed_mps());
        self.field
            .mark_resting(&line, self.nearby.places_body(&world_from_body));
        self.field.mark_unseen(&line, &sight, &self.body);
        let road = &observation.road;
        let begin = Place {
            along_m: 0.0,
            left_m: (road.right_m - road.left_m) / 2.0,
        };
        let last = self.last_path(observation, &line);
        prepared();
        let path = self.lattice.search(
            &Ground {
                line: &line,
                field: &self.field,
                body: &self.body,
                config: &self.settings,
                last: last.as_ref(),
            },
            begin.left_m,
            road.heading_rad.clamp(-1.2, 1.2).tan(),
        );
        let sightings = self.tracker.sightings();
        let car = (&self.vehicle, &self.settings);
        self.traffic.predict(&line, sightings, car);
        let profile = Way {
            line: &line,
            path: &path,
            config: &self.settings,
            vehicle: &self.vehicle,
            sightings,
            traffic: &self.traffic,
        }
        .choose(ego.speed_mps());
        let now = [
            0.0,
            begin.left_m,
            road.heading_rad,
            ego.speed_mps(),
            ego.yaw_rate_radps(),
        ];
        let solution = self.control(observation, &ego, &line, &path, &profile, now);
        *out = header(observation, out);
        out.outcome = match path.is_blocked {
            true => PlanOutcome::Partial.code(),
            false => PlanOutcome::Reached.code(),
        };
        self.answer(&ego, &line, solution, out);
        let goal_body = line.point_body(path.places().last().unwrap_or(begin));
        (out.goal_x_body_m, out.goal_y_body_m) = (goal_body.x, goal_body.y);
        self.keep(observation, ego, &line, &path, out);
    }

    /// Updates tracker and filter with this observation; forgets a memory of another
    /// episode, or one that is too old.
    fn remember(&mut self, observation: &Observation) -> EgoFilter {
        let header = &observation.header;
        let since_s = self.memory.as_ref().and_then(|memory| {
            let passed_ns = header.taken_ns.checked_sub(memory.header.taken_ns)?;
            let passed_s = passed_ns as f64 * 1e-9;
            let is_same = memory.header.episode == header.episode;
            (is_same && passed_s > 0.0 && passed_s <= MEMORY_S).then_some(passed_s)
        });
        if since_s.is_none() {
            self.forget();
        }
        self.tracker.update(observation, since_s.unwrap_or(0.0));
        match (&self.memory, since_s) {
            (Some(memory), Some(since_s)) => {
                let mut ego = memory.ego;
                ego.update(&observation.ego, &self.vehicle, since_s);
                ego
            }
            _ => EgoFilter::new(&observation.ego),
        }
    }

    /// The last path as it lies along the road of now.
    fn last_path(&self, observation: &Observation, line: &Line) -> Option<Path> {
        let memory = self.memory.as_ref()?;
        let body_from_world = world_from_body(observation).inverse();
        let places = memory
            .path_world
            .iter()
            .map(|point| line.place(body_from_world * point));
        Path::through(places)
    }

    /// States the problem around path and profile, and solves it.
    fn control(
        &mut self,
        observation: &Observation,
        ego: &EgoFilter,
        line: &Line,
        path: &Path,
        profile: &Profile,
        now: State,
    ) -> Option<Solution> {
        let model = Model {
            wheelbase_m: self.vehicle.wheelbase_m,
            steering_gain: ego.steering_gain(),
            step_s: self.settings.step_s,
        };
        let probes_m = [self.body.offsets_m[0], self.body.offsets_m[body::DISCS - 1]];
        let mut before = now;
        for step in 0..self.stages.len() {
            let (along_m, speed_mps) = profile.at(step + 1);
            let (left_m, slope) = path.at(along_m);
            let curvature = line.curvature_per_m(along_m);
            let bend = (1.0 - curvature * left_m).max(0.2);
            let heading_rad = (slope / bend).atan();
            let rate_radps = curvature / bend * speed_mps;
            let wanted = [along_m, left_m, heading_rad, speed_mps, rate_radps];
            let steer_rad = (self.vehicle.wheelbase_m * curvature / bend).atan();
            let input = [steer_rad, (speed_mps - before[3]) / model.step_s];
            self.stages[step] = Stage {
                step: model.linear(line.curvature_per_m(before[0]), &before, &input),
                wanted,
                wanted_input: input,
                corridor_m: probes_m.map(|probe_m| self.corridor_m(line, path, along_m + probe_m)),
                stop_m: profile.stop_m,
            };
            before = wanted;
        }
        let last = vehicle::Action {
            steer: observation.ego.steer,
            pedal: observation.ego.pedal,
        }
        .control(&self.vehicle);
        // A brake only stops the car: held at rest it is no acceleration, and to
        // let go of it is no change. Otherwise a car that another driver has stopped
        // would be told to stay at rest.
        let stopping_mps2 = -ego.speed_mps().max(0.0) / model.step_s;
        let task = Task {
            now,
            last: [last.steer_rad, last.accel_mps2.max(stopping_mps2)],
            probes_m,
            inputs: [
                (-self.vehicle.max_steer_rad(), self.vehicle.max_steer_rad()),
                (
                    -BRAKE_MAX_MPS2.min(self.vehicle.max_brake_mps2),
                    self.vehicle.max_accel_mps2 * ego.engine_gain(),
                ),
            ],
        };
        self.problem.solve(&task, &self.stages)
    }

    /// How far a disc of the car may be to the left and to the right of the path.
    fn corridor_m(&self, line: &Line, path: &Path, along_m: f64) -> (f64, f64) {
        let (path_m, _) = path.at(along_m);
        let edge_m = (line.half_width_m(along_m) - self.body.half_width_m).max(0.0);
        let here_m = self.field.clearance_m(Place {
            along_m,
            left_m: path_m,
        });
        // Where the path itself has less clearance, the corridor is not a single line: a
        // path that costs slack at each step would stop the car.
        let needed_m = (self.body.radius_m + ROOM_M)
            .min(here_m - GIVE_M)
            .max(self.body.half_width_m);
        let look = |direction: f64| {
            let mut free_m = path_m;
            loop {
                let left_m = free_m + direction * LOOK_M;
                let clearance_m = self.field.clearance_m(Place { along_m, left_m });
                if left_m * direction > edge_m || clearance_m < needed_m {
                    return free_m;
                }
                free_m = left_m;
            }
        };
        (look(-1.0), look(1.0))
    }

    /// Writes actions and waypoints: of the solution, else of the last one, else
    /// the brake.
    fn answer(&self, ego: &EgoFilter, line: &Line, solution: Option<Solution>, out: &mut Plan) {
        out.action_step_s = self.settings.step_s;
        let Some(solution) = solution else {
            let left = self.memory.as_ref().map_or(&[][..], |memory| {
                memory.actions_left(out.header.taken_ns, out.action_step_s)
            });
            for (action, &kept) in out.actions.iter_mut().zip(left) {
                *action = kept;
            }
            out.action_count = left.len().max(1) as u32;
            if left.is_empty() {
                out.actions[0] = PlannedAction {
                    steer: 0.0,
                    pedal: -1.0,
                };
                out.outcome = PlanOutcome::Blocked.code();
            }
            return;
        };
        out.iterations = self.problem.effort().iterations;
        for (slot, input) in out.actions.iter_mut().zip(&solution.inputs) {
            let [steer_rad, accel_mps2] = *input;
            let gain = if accel_mps2 > 0.0 {
                ego.engine_gain()
            } else {
                1.0
            };
            let action = Control {
                steer_rad,
                accel_mps2: accel_mps2 / gain,
            }
            .action(&self.vehicle);
            *slot = PlannedAction {
                steer: action.steer,
                pedal: action.pedal,
            };
        }
        out.action_count = solution.inputs.len() as u32;
        let mut before = Point::origin();
        for (index, state) in solution.states.iter().enumerate() {
            let [along_m, left_m, _, speed_mps, _] = *state;
            let point_body = line.point_body(Place { along_m, left_m });
            out.cost_m += (point_body - before).norm();
            before = point_body;
            out.waypoints[index + 1] = Waypoint {
                x_body_m: point_body.x,
                y_body_m: point_body.y,
                speed_mps: speed_mps.max(0.0),
            };
        }
        out.waypoints[0].speed_mps = ego.speed_mps();
        out.waypoint_count = solution.states.len() as u32 + 1;
    }

    fn keep(
        &mut self,
        observation: &Observation,
        ego: EgoFilter,
        line: &Line,
        path: &Path,
        out: &Plan,
    ) {
        let world_from_body = world_from_body(observation);
        let (actions, answered_ns) = match self.memory.take() {
            _ if self.problem.effort().is_solved => (
                out.actions().iter().copied().collect(),
                observation.header.taken_ns,
            ),
            Some(memory) => (memory.actions, memory.answered_ns),
            None => Default::default(),
        };
        self.memory = Some(Memory {
            header: observation.header,
            ego,
            path_world: path
                .places()
                .map(|place| world_from_body * line.point_body(place))
                .collect(),
            actions,
            answered_ns,
        });
    }
}

fn world_from_body(observation: &Observation) -> Pose {
    let ego = &observation.ego;
    pose(ego.x_world_m, ego.y_world_m, ego.heading_world_rad)
}

#[cfg(test)]
mod tests;
