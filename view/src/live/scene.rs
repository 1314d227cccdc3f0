//! What one step shows: the scene from above, in numbers for the page.
//!
//! Points are in the body frame of the step's observation unless a name says otherwise,
//! x forward, y left, m.

use recorder::standard::{Bodies, Body, rollout};
use serde::Serialize;
use shm_config::config::Config;
use shm_config::message::{Assessment, Lateness, Observation, Plan, Proposal, Step};
use vehicle::Point;

/// Everything the page draws of one step.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scene {
    /// The controller's tick.
    pub tick: u64,
    /// The episode, from 0.
    pub episode: u32,
    /// When the tick admitted its inputs, s on the run's clock.
    pub taken_s: f64,
    /// Pose of the car in the world frame: m, m, rad.
    pub ego_world: [f64; 3],
    /// m/s.
    pub speed_mps: f64,
    /// rad/s, counter-clockwise.
    pub yaw_rate_radps: f64,
    /// The road's left and right edge.
    pub edges: [Vec<[f64; 2]>; 2],
    /// The next checkpoints.
    pub checkpoints: [[f64; 2]; 2],
    /// Range of each beam, m, counter-clockwise.
    pub scan_m: Vec<f64>,
    /// Angle of the first beam from the heading, and from beam to beam, rad.
    pub scan_rad: [f64; 2],
    /// Where the beams begin, m forward and left of the car's centre.
    pub scan_from: [f64; 2],
    /// Range of a beam that hits nothing, m.
    pub scan_max_m: f64,
    /// Bodies that move.
    pub tracks: Vec<Track>,
    /// The plan; `None` before the first.
    pub plan: Option<PlanScene>,
    /// The expert's proposal, or the person's after a takeover.
    pub expert: Option<ProposalScene>,
    /// The policy's proposal.
    pub policy: Option<ProposalScene>,
    /// The driver's word.
    pub driver: &'static str,
    /// The reason's word.
    pub reason: &'static str,
    /// Steering and pedal of the command, normalised.
    pub command: [f64; 2],
    /// Whether a person's action replaces the expert's.
    pub is_takeover: bool,
    /// The stage of the policy, a word.
    pub stage: &'static str,
    /// The lateness of the command, a word.
    pub lateness: &'static str,
    /// The advice in force; `None` before the first.
    pub advice: Option<AdviceScene>,
    /// Version and hash of the weights that proposed; `None` without.
    pub weights: Option<(u64, String)>,
    /// The instants of the tick, as durations.
    pub timing: TimingScene,
}

/// A body that moves.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Track {
    /// Its middle.
    pub at: [f64; 2],
    /// Velocity over ground in the body frame's directions, m/s.
    pub velocity_mps: [f64; 2],
    /// Half the diagonal of its box, m.
    pub radius_m: f64,
}

/// The plan in force.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlanScene {
    /// Pose of its body frame in the world frame: m, m, rad.
    pub origin_world: [f64; 3],
    /// The result of the search, a word.
    pub outcome: &'static str,
    /// Its goal, in its own body frame.
    pub goal: [f64; 2],
    /// Its waypoints, in its own body frame, with their speeds, m/s.
    pub points: Vec<[f64; 3]>,
    /// Length, m.
    pub cost_m: f64,
    /// Time the planner took, ms.
    pub planning_ms: f64,
    /// Nodes of the search tree.
    pub nodes: u32,
    /// Age of its observation, ms; `None` when it has none.
    pub age_ms: Option<f64>,
}

/// A proposal with its rollout and its assessment.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProposalScene {
    /// Normalised, positive left.
    pub steer: f64,
    /// Normalised, negative brakes.
    pub pedal: f64,
    /// The path of a car that holds it for the horizon of the safety check.
    pub rollout: Vec<[f64; 2]>,
    /// The verdict's word.
    pub verdict: &'static str,
    /// Whether the safety check vetoes it.
    pub is_vetoed: bool,
    /// Least distance to a lidar return along the rollout, m.
    pub clearance_m: f64,
    /// Time to contact or to leaving the road, s.
    pub safe_s: f64,
}

/// The advice in force.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AdviceScene {
    /// What the judge prefers, a word.
    pub preference: &'static str,
    /// What kind of judge answered, a word.
    pub judge: &'static str,
    /// Age of its question, s; `None` without a question.
    pub age_s: Option<f64>,
    /// For how long it still holds, s.
    pub holds_s: f64,
    /// Questions answered so far.
    pub answers: u64,
}

/// The instants of a tick as durations from its scheduled instant, ms.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TimingScene {
    /// To the begin of the tick.
    pub started_ms: f64,
    /// To the arrival of the plan, or the end of the wait for it.
    pub planned_ms: f64,
    /// To the decision.
    pub decided_ms: f64,
    /// To the command.
    pub commanded_ms: f64,
    /// Age of the observation, ms; `None` without.
    pub observation_age_ms: Option<f64>,
}

/// Rounds, so that the text of a number is short.
pub(crate) fn rounded(value: f64, digits: i32) -> f64 {
    let scale = 10_f64.powi(digits);
    (value * scale).round() / scale
}

fn point([x, y]: [f64; 2]) -> [f64; 2] {
    [rounded(x, 2), rounded(y, 2)]
}

fn ms(ns: u64) -> f64 {
    rounded(ns as f64 / 1e6, 3)
}

/// `None` for the value that stands for no message.
fn age_ms(ns: u64) -> Option<f64> {
    (ns != u64::MAX).then(|| ms(ns))
}

/// Makes scenes of successive steps; it remembers the bodies that it follows.
#[derive(Debug)]
pub struct Painter {
    config: Config,
    bodies: Bodies,
}

impl Painter {
    /// For the steps of a run with this configuration.
    pub fn new(config: &Config) -> Self {
        Self {
            config: config.clone(),
            bodies: Bodies::default(),
        }
    }

    /// Follows the bodies in a step's scan.
    pub fn follow(&mut self, step: &Step) {
        self.bodies.follow(step);
    }

    /// The scene of a step that passed [`shm_config::Message::check`].
    pub fn scene(&mut self, step: &Step) -> Scene {
        self.follow(step);
        let (observation, ego) = (&step.observation, &step.observation.ego);
        let header = &step.header;
        Scene {
            tick: header.tick,
            episode: header.episode,
            taken_s: rounded(header.taken_ns as f64 * 1e-9, 4),
            ego_world: pose_of(ego.x_world_m, ego.y_world_m, ego.heading_world_rad),
            speed_mps: rounded(ego.speed_mps, 3),
            yaw_rate_radps: rounded(ego.yaw_rate_radps, 4),
            edges: edges(observation),
            checkpoints: observation
                .checkpoints
                .map(|checkpoint| point([checkpoint.x_body_m, checkpoint.y_body_m])),
            scan_m: scan(observation),
            scan_rad: beams_rad(observation),
            scan_from: point([observation.scanner_x_body_m, observation.scanner_y_body_m]),
            scan_max_m: rounded(f64::from(observation.lidar_max_m), 2),
            tracks: tracks(&self.bodies),
            plan: plan(step),
            expert: self.proposal(step, &step.expert, &step.expert_assessment),
            policy: self.proposal(step, &step.policy, &step.policy_assessment),
            driver: step.driver().word(),
            reason: step.reason().map_or("unknown", |reason| reason.word()),
            command: point([step.command.steer, step.command.pedal]),
            is_takeover: step.is_taken_over(),
            stage: step.stage().word(),
            lateness: Lateness::from_code(step.lateness).map_or("unknown", Lateness::word),
            advice: advice(step),
            weights: (step.weights_version > 0)
                .then(|| (step.weights_version, format!("{:016x}", step.weights_hash))),
            timing: timing(step),
        }
    }

    fn proposal(
        &self,
        of: &Step,
        proposal: &Proposal,
        assessment: &Assessment,
    ) -> Option<ProposalScene> {
        let action = proposal.action()?;
        Some(ProposalScene {
            steer: rounded(action.steer, 3),
            pedal: rounded(action.pedal, 3),
            rollout: rounded_path(&rollout(&self.config, action, of.observation.ego.speed_mps)),
            verdict: assessment.verdict().word(),
            is_vetoed: assessment.is_vetoed(),
            clearance_m: rounded(assessment.clearance_m, 2),
            safe_s: rounded(assessment.safe_s, 2),
        })
    }
}

fn pose_of(x_m: f64, y_m: f64, heading_rad: f64) -> [f64; 3] {
    [rounded(x_m, 3), rounded(y_m, 3), rounded(heading_rad, 4)]
}

fn edges(observation: &Observation) -> [Vec<[f64; 2]>; 2] {
    recorder::standard::edges(observation).map(|edge| rounded_path(&edge))
}

fn rounded_path(path: &[Point]) -> Vec<[f64; 2]> {
    path.iter().map(|at| point([at.x, at.y])).collect()
}

fn scan(observation: &Observation) -> Vec<f64> {
    let ranges = observation.ranges_m.iter();
    ranges
        .take(observation.beam_count as usize)
        .map(|range_m| rounded(f64::from(*range_m), 2))
        .collect()
}

/// Angle of the first beam and the angle from beam to beam, rad.
fn beams_rad(observation: &Observation) -> [f64; 2] {
    let fan = observation.fan();
    [fan.angle_rad(0), fan.spacing_rad()]
}

fn tracks(bodies: &Bodies) -> Vec<Track> {
    let track = |body: Body| Track {
        at: point([body.at.x, body.at.y]),
        velocity_mps: point([body.velocity_mps.x, body.velocity_mps.y]),
        radius_m: rounded(body.radius_m, 2),
    };
    bodies.moving().map(track).collect()
}

fn plan(step: &Step) -> Option<PlanScene> {
    let plan: &Plan = &step.plan;
    (step.plan_age_ns != u64::MAX).then(|| PlanScene {
        origin_world: pose_of(
            plan.origin_x_world_m,
            plan.origin_y_world_m,
            plan.origin_heading_world_rad,
        ),
        outcome: plan.outcome().word(),
        goal: point([plan.goal_x_body_m, plan.goal_y_body_m]),
        points: plan
            .waypoints()
            .iter()
            .map(|at| {
                [
                    rounded(at.x_body_m, 2),
                    rounded(at.y_body_m, 2),
                    rounded(at.speed_mps, 2),
                ]
            })
            .collect(),
        cost_m: rounded(plan.cost_m, 2),
        planning_ms: ms(plan.planning_ns),
        nodes: plan.nodes,
        age_ms: age_ms(step.plan_age_ns),
    })
}

fn advice(step: &Step) -> Option<AdviceScene> {
    let advice = &step.advice;
    let judge = shm_config::message::Judge::from_code(advice.judge);
    (advice.header.sequence > 0).then(|| AdviceScene {
        preference: advice.preference().word(),
        judge: judge.map_or("unknown", |judge| judge.word()),
        age_s: age_ms(step.advice_age_ns).map(|ms| rounded(ms / 1e3, 2)),
        holds_s: rounded(
            advice.holds_until_ns.saturating_sub(step.header.taken_ns) as f64 * 1e-9,
            2,
        ),
        answers: advice.answers,
    })
}

fn timing(step: &Step) -> TimingScene {
    let timings = &step.timings;
    let after = |at_ns: u64| ms(at_ns.saturating_sub(timings.scheduled_ns));
    TimingScene {
        started_ms: after(timings.started_ns),
        planned_ms: after(timings.planned_ns),
        decided_ms: after(timings.decided_ns),
        commanded_ms: after(timings.commanded_ns),
        observation_age_ms: age_ms(step.observation_age_ns),
    }
}

#[cfg(test)]
mod tests {
    use vehicle::Action;

    use super::*;

    fn driving() -> Step {
        let mut step = Step::default();
        (step.header.tick, step.header.sequence) = (7, 7);
        let observation = &mut step.observation;
        (observation.road.left_m, observation.road.right_m) = (5.0, 3.0);
        observation.checkpoints[0].x_body_m = 40.0;
        observation.checkpoints[0].y_body_m = 1.0;
        observation.checkpoints[1].x_body_m = 60.0;
        observation.checkpoints[1].y_body_m = 12.0;
        observation.beam_count = 4;
        observation.ranges_m[..4].copy_from_slice(&[50.0, 3.25, 50.0, 12.5]);
        observation.ego.speed_mps = 5.0;
        step.expert = Proposal::new(Some(Action {
            steer: 0.5,
            pedal: 0.0,
        }));
        step
    }

    #[test]
    fn the_edges_lie_beside_the_car_and_follow_the_bend() {
        let scene = Painter::new(&Config::default()).scene(&driving());
        let [left, right] = &scene.edges;
        let beside = |edge: &[[f64; 2]]| {
            let nearest = edge.iter().min_by(|a, b| a[0].abs().total_cmp(&b[0].abs()));
            nearest.expect("an edge")[1]
        };
        assert!((beside(left) - 5.0).abs() < 0.05, "{left:?}");
        assert!((beside(right) + 3.0).abs() < 0.05, "{right:?}");
        let last = left.last().expect("an edge");
        assert!(last[1] > 10.0, "the second checkpoint bends left: {last:?}");
    }

    #[test]
    fn a_rollout_bends_as_it_steers_and_absence_is_no_proposal() {
        let scene = Painter::new(&Config::default()).scene(&driving());
        let expert = scene.expert.expect("a proposal");
        let end = expert.rollout.last().expect("a path");
        assert!(end[0] > 1.0 && end[1] > 0.5, "{end:?}");
        assert_eq!(scene.policy, None);
        assert_eq!(scene.scan_m, [50.0, 3.25, 50.0, 12.5]);
        assert_eq!((scene.plan, scene.advice), (None, None));
    }

    #[test]
    fn a_car_that_drives_by_becomes_a_track() {
        let mut painter = Painter::new(&Config::default());
        let mut tracks = Vec::new();
        for k in 0..12_u32 {
            let mut step = driving();
            step.observation.header.taken_ns = u64::from(k) * 100_000_000;
            step.observation.beam_count = 240;
            step.observation.ranges_m = [50.0; 2048];
            // A body on the left that moves forward at 10 m/s.
            let x_m = -6.0 + f64::from(k);
            let middle = (4.0_f64.atan2(x_m) / std::f64::consts::TAU * 240.0).round() as usize;
            for beam in middle - 2..=middle + 2 {
                step.observation.ranges_m[beam] = x_m.hypot(4.0) as f32;
            }
            tracks = painter.scene(&step).tracks;
        }
        assert_eq!(tracks.len(), 1, "{tracks:?}");
        let [ahead, aside] = tracks[0].velocity_mps;
        assert!(
            (6.0..14.0).contains(&ahead) && aside.abs() < 4.0,
            "{tracks:?}"
        );
    }
}
