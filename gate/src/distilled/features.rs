//! The question as numbers.
//!
//! The net is asked about each proposal by itself, so it cannot know which one is the
//! expert's: its features are the scene, the proposal, and where the proposal leads.

use shm_config::layout::{FNV_BASIS, fnv1a};
use shm_config::message::{Bend, Checkpoint, Observation};
use vehicle::{Action, Vehicle};

use super::rollout::{Course, HORIZON_S, Surroundings, WINDOWS};
use crate::query::Question;

/// Numbers of the car, its road and two checkpoints.
const SCENE: usize = 16;
/// Sectors of the scan, of five beams each: no beam lies between two of them, so that a
/// mirrored scan has mirrored sectors.
const SECTORS: usize = 48;
/// Numbers of a proposal and of where it leads.
const PROPOSAL: usize = 10 + 2 * WINDOWS;
/// Numbers that the net takes for one proposal.
pub const INPUTS: usize = SCENE + SECTORS + PROPOSAL;
/// The version of the meaning of [`party_features`]. Raise it whenever a feature changes
/// its meaning, scale or position: files for another version are refused.
const VERSION: u32 = 1;
/// The feature map that a net is trained for, in one number.
pub const QUESTION_LAYOUT: u64 = fnv1a(
    fnv1a(FNV_BASIS, &(INPUTS as u64).to_le_bytes()),
    &VERSION.to_le_bytes(),
);

/// Speed that is shown as 1, m/s.
const SPEED_MPS: f64 = 15.0;
/// Distance to the road's edge that is shown as 1, m.
const ROAD_M: f64 = 10.0;
/// Distance of a checkpoint that is shown as 1, m.
const CHECKPOINT_M: f64 = 50.0;
/// Radius of a bend whose curvature is shown as 1, m.
const RADIUS_M: f64 = 10.0;
/// Distance of a return that is shown as one half, m.
const NEAR_M: f64 = 5.0;
/// Distance along a rollout that is shown as 1, m: farther things do not matter.
const BESIDE_M: f64 = 4.0;
/// Progress that is shown as 1, m.
const PROGRESS_M: f64 = 30.0;

/// Whether left is left. The mirrored scene has the mirrored answer, which doubles the
/// scenes to learn from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// As observed.
    Seen,
    /// Left and right exchanged.
    Mirrored,
}

impl Side {
    fn sign(self) -> f64 {
        match self {
            Self::Seen => 1.0,
            Self::Mirrored => -1.0,
        }
    }
}

/// The features of both proposals of a question, the expert's first; `None` where a
/// proposal is missing or the scan is not the one that policies and this map are made
/// for.
pub fn party_features(
    question: &Question,
    vehicle: &Vehicle,
    side: Side,
) -> Option<[[f32; INPUTS]; 2]> {
    let observation = &question.observation;
    if !observation.fits_policy() {
        return None;
    }
    let actions = [question.expert.action()?, question.policy.action()?];
    let surroundings = Surroundings::new(observation);
    Some(actions.map(|action| {
        let mut writer = Writer {
            out: [0.0; INPUTS],
            next: 0,
        };
        scene(observation, side, &mut writer);
        sectors(observation, side, &mut writer);
        let course = surroundings.course(vehicle, action);
        proposal(action, &course, side, &mut writer);
        writer.out
    }))
}

/// Fills a row from its beginning. Every number is limited, so that nothing outside a
/// known range reaches the net.
struct Writer {
    out: [f32; INPUTS],
    next: usize,
}

impl Writer {
    fn push(&mut self, value: f64) {
        if let Some(place) = self.out.get_mut(self.next) {
            *place = value.clamp(-2.0, 2.0) as f32;
        }
        self.next += 1;
    }
}

fn scene(observation: &Observation, side: Side, writer: &mut Writer) {
    let (ego, road, sign) = (&observation.ego, &observation.road, side.sign());
    let [left_m, right_m] = match side {
        Side::Seen => [road.left_m, road.right_m],
        Side::Mirrored => [road.right_m, road.left_m],
    };
    writer.push(ego.speed_mps / SPEED_MPS);
    writer.push(sign * ego.yaw_rate_radps);
    writer.push(sign * ego.steer);
    writer.push(ego.pedal);
    writer.push(left_m / ROAD_M);
    writer.push(right_m / ROAD_M);
    writer.push(sign * road.heading_rad.sin());
    writer.push(sign * road.offset_m / BESIDE_M);
    for checkpoint in &observation.checkpoints {
        writer.push(checkpoint.x_body_m / CHECKPOINT_M);
        writer.push(sign * checkpoint.y_body_m / CHECKPOINT_M);
        writer.push(sign * curvature(checkpoint));
        writer.push(checkpoint.bend_angle_rad / std::f64::consts::PI);
    }
}

/// The curvature of the road to a checkpoint, positive to the left.
fn curvature(checkpoint: &Checkpoint) -> f64 {
    let curvature = RADIUS_M / checkpoint.bend_radius_m.max(1.0);
    match checkpoint.bend() {
        Bend::Straight => 0.0,
        Bend::Left => curvature,
        Bend::Right => -curvature,
    }
}

/// The nearest return of each sector: 1 at the scanner, towards 0 far away.
fn sectors(observation: &Observation, side: Side, writer: &mut Writer) {
    let fan = observation.fan();
    let mut nearest_m = [f64::from(observation.lidar_max_m); SECTORS];
    for (beam, &range_m) in observation.ranges().iter().enumerate() {
        let turns = side.sign() * fan.angle_rad(beam) / std::f64::consts::TAU;
        let sector = (turns * SECTORS as f64).round() as i64;
        let sector = sector.rem_euclid(SECTORS as i64) as usize;
        nearest_m[sector] = nearest_m[sector].min(f64::from(range_m));
    }
    for range_m in nearest_m {
        writer.push(NEAR_M / (NEAR_M + range_m.max(0.0)));
    }
}

fn proposal(action: Action, course: &Course, side: Side, writer: &mut Writer) {
    let sign = side.sign();
    writer.push(sign * action.steer);
    writer.push(action.pedal);
    for k in 0..WINDOWS {
        writer.push(course.clearance_m[k].min(BESIDE_M) / BESIDE_M);
        writer.push(course.edge_m[k].min(BESIDE_M) / BESIDE_M);
    }
    writer.push(course.touch_s / HORIZON_S);
    writer.push(course.out_s / HORIZON_S);
    writer.push(course.nearest_s / HORIZON_S);
    writer.push(course.nearest.x / ROAD_M);
    writer.push(sign * course.nearest.y / ROAD_M);
    writer.push(course.progress_m / PROGRESS_M);
    writer.push(course.driven_m / PROGRESS_M);
    writer.push(course.speed_mps / SPEED_MPS);
}

#[cfg(test)]
mod tests {
    use shm_config::message::{Assessment, Proposal};

    use super::*;

    fn question() -> Question {
        let mut observation = Observation {
            beam_count: 240,
            ..Observation::default()
        };
        observation.ranges_m.fill(50.0);
        // A body ahead and to the left.
        observation.ranges_m[3..9].fill(9.0);
        (observation.road.left_m, observation.road.right_m) = (7.0, 3.5);
        (observation.road.offset_m, observation.road.heading_rad) = (0.4, 0.1);
        observation.ego.speed_mps = 6.0;
        (observation.ego.steer, observation.ego.yaw_rate_radps) = (0.2, 0.3);
        let checkpoint = &mut observation.checkpoints[0];
        (checkpoint.x_body_m, checkpoint.y_body_m) = (30.0, 4.0);
        let proposal = |steer| Proposal::new(Some(Action { steer, pedal: 0.3 }));
        Question {
            observation,
            expert: proposal(-0.3),
            policy: proposal(0.5),
            expert_assessment: Assessment::default(),
            policy_assessment: Assessment::default(),
        }
    }

    fn mirrored(question: &Question) -> Question {
        let mut other = question.clone();
        let observation = &mut other.observation;
        observation.ranges_m[1..240].reverse();
        let road = &mut observation.road;
        (road.left_m, road.right_m) = (road.right_m, road.left_m);
        (road.offset_m, road.heading_rad) = (-road.offset_m, -road.heading_rad);
        let ego = &mut observation.ego;
        (ego.steer, ego.yaw_rate_radps) = (-ego.steer, -ego.yaw_rate_radps);
        observation.checkpoints[0].y_body_m *= -1.0;
        other.expert.steer *= -1.0;
        other.policy.steer *= -1.0;
        other
    }

    #[test]
    fn a_mirrored_scene_has_the_mirrored_features() {
        let question = question();
        let car = Vehicle::default();
        let seen = party_features(&mirrored(&question), &car, Side::Seen).expect("features");
        let turned = party_features(&question, &car, Side::Mirrored).expect("features");
        for (seen, turned) in seen.iter().flatten().zip(turned.iter().flatten()) {
            assert!((seen - turned).abs() < 1e-5, "{seen} {turned}");
        }
    }

    /// When this fails because the meaning of a feature has changed, raise [`VERSION`] and
    /// update the numbers: nets that were trained for the old meaning are then refused
    /// instead of answering wrongly. A change of the rollout's vehicle changes them, too.
    #[test]
    fn the_meaning_of_the_features_is_pinned() {
        let mut question = question();
        question.observation.ego.pedal = -0.25;
        for (checkpoint, bend) in question
            .observation
            .checkpoints
            .iter_mut()
            .zip([Bend::Left, Bend::Right])
        {
            (checkpoint.bend_radius_m, checkpoint.bend_angle_rad) = (20.0, 0.5);
            checkpoint.bend = bend.code();
        }
        let rows = party_features(&question, &Vehicle::default(), Side::Seen);
        let found: Vec<String> = rows
            .expect("features")
            .iter()
            .map(|row| row.map(|value| format!("{value:.6}")).join(" "))
            .collect();
        assert_eq!(VERSION, 1);
        assert_eq!(found.join("\n"), include_str!("features.txt").trim());
        assert_eq!(format!("{QUESTION_LAYOUT:016x}"), "191b3cb04821b37a");
    }

    #[test]
    fn every_place_of_a_row_is_filled_and_limited() {
        let question = question();
        let rows = party_features(&question, &Vehicle::default(), Side::Seen).expect("features");
        assert_ne!(rows[0], rows[1], "two proposals");
        let mut writer = Writer {
            out: [0.0; INPUTS],
            next: 0,
        };
        scene(&question.observation, Side::Seen, &mut writer);
        sectors(&question.observation, Side::Seen, &mut writer);
        let course =
            Surroundings::new(&question.observation).course(&Vehicle::default(), Action::BRAKE);
        proposal(Action::BRAKE, &course, Side::Seen, &mut writer);
        assert_eq!(writer.next, INPUTS);
        assert!(rows.iter().flatten().all(|value| value.abs() <= 2.0));
    }

    #[test]
    fn without_a_pair_or_with_another_scanner_there_are_no_features() {
        let car = Vehicle::default();
        let mut alone = question();
        alone.policy = Proposal::default();
        assert!(party_features(&alone, &car, Side::Seen).is_none());
        let mut sparse = question();
        sparse.observation.beam_count = 60;
        assert!(party_features(&sparse, &car, Side::Seen).is_none());
    }
}
