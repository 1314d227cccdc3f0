//! The paper's tracking controller (Sec. 4.1.2) on a kinematic bicycle: plans
//! are judged by how they drive.

use planner::{PlannerConfig, RrtStar};
use shm_config::message::{Plan, PlanOutcome};
use vehicle::{Action, State, Vehicle, pose, step};

use super::{BARRIER, CAR, CONE, Course, Dice, ROAD_WIDTH_M, Road};

const STEP_S: f64 = 0.1;
/// The paper's limit of an episode.
const TICKS_MAX: u64 = 1500;
/// A course is driven when the car is this near to its end, m.
const END_M: f64 = 5.0;

/// How a drive went.
#[derive(Debug, Clone, Copy)]
pub struct Drive {
    /// The end of the course was reached, in time and on the road.
    pub arrived: bool,
    /// The car's centre left the road.
    pub left_road: bool,
    /// Distance driven along the course, m.
    pub along_m: f64,
    pub ticks: u64,
    /// The car's centre was never nearer to an edge of the road, m.
    pub edge_m: f64,
    /// The car's body was never nearer to an obstacle, m.
    pub clearance_m: f64,
    /// Plans without a path.
    pub blocked: u64,
    /// Plans with a path that ends short of the goal.
    pub partial: u64,
    /// Mean size of the steering, normalised.
    pub steer_mean: f64,
}

/// Drives a course from 5 m after its beginning, this far left of its middle.
pub fn drive(course: &Course, config: PlannerConfig, across_m: f64) -> Drive {
    let vehicle = Vehicle::default();
    let mut planner = RrtStar::new(config).unwrap();
    let mut plan = Plan::default();
    let start = course.pose_at(5.0) * pose(0.0, across_m, 0.0);
    let mut state = State {
        position: start.translation.vector.into(),
        heading_rad: start.rotation.angle(),
        speed_mps: 0.0,
    };
    let mut drive = Drive {
        arrived: false,
        left_road: false,
        along_m: 0.0,
        ticks: 0,
        edge_m: f64::INFINITY,
        clearance_m: f64::INFINITY,
        blocked: 0,
        partial: 0,
        steer_mean: 0.0,
    };
    let mut last = [0.0; 2];
    for tick in 0..TICKS_MAX {
        let place = course.place(state.position);
        drive.ticks = tick;
        drive.along_m = place.along_m;
        drive.edge_m = drive.edge_m.min(ROAD_WIDTH_M / 2.0 - place.across_m.abs());
        drive.clearance_m = drive
            .clearance_m
            .min(course.clearance_m(&vehicle, &state.pose()));
        drive.left_road = drive.edge_m < 0.0;
        drive.arrived = !drive.left_road && place.along_m > course.length_m() - END_M;
        if drive.left_road || drive.arrived {
            break;
        }
        planner.plan(&course.observe(&state, tick), &mut plan);
        drive.blocked += u64::from(plan.outcome() == PlanOutcome::Blocked);
        drive.partial += u64::from(plan.outcome() == PlanOutcome::Partial);
        let action = track(&plan, state.speed_mps, &mut last);
        drive.steer_mean += action.steer.abs();
        state = step(&vehicle, &state, action.control(&vehicle), STEP_S);
    }
    drive.steer_mean /= drive.ticks.max(1) as f64;
    drive
}

/// The PD controller; without a path it brakes.
fn track(plan: &Plan, speed_mps: f64, last: &mut [f64; 2]) -> Action {
    let Some((target_body, target_mps)) = plan.lookahead(&vehicle::Pose::identity(), 2.0) else {
        return Action::BRAKE;
    };
    let errors = [target_body.y.atan2(target_body.x), target_mps - speed_mps];
    let rates = [0, 1].map(|which| (errors[which] - last[which]) / STEP_S);
    *last = errors;
    Action {
        steer: 2.0 * errors[0] + 0.001 * rates[0],
        pedal: 0.1 * errors[1] + 0.05 * rates[1],
    }
    .clamped()
}

/// Three blocks as the paper's maps have them: straight roads of 40 to 80 m,
/// bends of 25 to 60 m radius and 45 to 135 degrees, and turns at junctions.
pub fn random_course(seed: u64, obstacles: bool) -> Course {
    let mut dice = Dice::new(seed);
    let mut roads = vec![Road {
        length_m: 60.0,
        curvature_per_m: 0.0,
    }];
    let mut fit_for_obstacles = Vec::new();
    for _ in 0..3 {
        let side = if dice.below(2) == 0 { 1.0 } else { -1.0 };
        let (radius_m, turn_deg) = match dice.below(3) {
            0 => (f64::INFINITY, 0.0),
            1 => (dice.between(25.0, 60.0), dice.between(45.0, 135.0)),
            _ => (dice.between(13.0, 20.0), 90.0f64),
        };
        if turn_deg > 0.0 {
            roads.push(Road {
                length_m: turn_deg.to_radians() * radius_m,
                curvature_per_m: side / radius_m,
            });
        }
        let before_m: f64 = roads.iter().map(|road| road.length_m).sum();
        let length_m = dice.between(40.0, 80.0);
        fit_for_obstacles.push(before_m + length_m / 2.0);
        roads.push(Road {
            length_m,
            curvature_per_m: 0.0,
        });
    }
    let mut course = Course::new(&roads);
    for along_m in fit_for_obstacles.into_iter().filter(|_| obstacles) {
        let lane_m = 3.5 * (dice.below(3) as f64 - 1.0);
        match dice.below(3) {
            0 => course.put(along_m, lane_m, CAR),
            1 => course.put(along_m, lane_m, BARRIER),
            _ => {
                let lane_m = if lane_m > 0.0 { 3.5 } else { -3.5 };
                (0..5).for_each(|cone| course.put(along_m + 2.0 * f64::from(cone), lane_m, CONE));
            }
        }
    }
    course
}
