//! Settings whose default depends on the car.

use vehicle::Vehicle;

use super::{Config, Controller, Informed, Kinodynamic, Mpc, Planner, Simulator};
use crate::settings::planner::DISC_CELLS_MAX;

/// The keys that a file or an option gave, with their sections.
type Given = toml::Table;

/// What the default of `planner.lane_margin_m` leaves beside the body, m.
const BESIDE_M: f64 = 0.074;
/// The highest of the speeds that the expert wants, as a share of the car's top speed:
/// what is left is needed to catch up.
const SPEED_SHARE: f64 = 0.9;
/// Deceleration in plans, as a share of the full brake's.
const BRAKE_SHARE: f64 = 0.25;

impl Config {
    /// The configuration with everything that depends on the car written out: for a car
    /// other than the default, the keys that nothing gave follow its size, its wheelbase
    /// and its limits; for each car, goal and speeds follow the range of its scanner.
    /// Loading a configuration applies it, so the saved configuration is the one that every
    /// process uses.
    ///
    /// Speeds are at most 0.9 of the car's top speed. Lengths ahead of the car grow with
    /// its length; a shorter car keeps the default ones, because they are those of its
    /// speed. Margins beside the car follow its width. Gains keep the yaw rate that an
    /// error of heading gives, and the acceleration that an error of speed gives.
    pub(super) fn fitted_to_vehicle(mut self, given: &Given) -> Self {
        let fit = Fit::new(given, &self.vehicle, self.sight_speed_mps());
        fit.sight(&mut self.planner, &mut self.mpc, self.scanner.range_m);
        let is_default = self.vehicle == Vehicle::default();
        // The paper's inflation belongs to its car on its maps. Between walls that the scanner
        // sees, paths that do not hold the body are vetoed until the last step.
        if !is_default || self.world.simulator == Simulator::IrSim {
            fit.inflations(&mut self.planner, &mut self.informed);
        }
        if is_default {
            return self;
        }
        fit.planner(&mut self.planner);
        fit.kinodynamic(&mut self.kinodynamic);
        fit.mpc(&mut self.mpc);
        fit.controller(&mut self.controller);
        self
    }

    /// The speed at which the car stops within what its scanner sees, m/s, with the brake
    /// of plans.
    fn sight_speed_mps(&self) -> f64 {
        let brake_mps2 = BRAKE_SHARE * self.vehicle.max_brake_mps2;
        let ahead_m = (self.scanner.range_m - self.vehicle.length_m / 2.0).max(0.0);
        let reacted_mps = brake_mps2 * (self.safety.reaction_s + self.vehicle.delay_s());
        (reacted_mps.powi(2) + 2.0 * brake_mps2 * ahead_m).sqrt() - reacted_mps
    }
}

/// A car beside the default one.
struct Fit<'a> {
    given: &'a Given,
    car: &'a Vehicle,
    /// Its length over the default car's, at least 1.
    longer: f64,
    /// Half of what it is longer, m.
    longer_m: f64,
    /// Half of what it is wider, m.
    wider_m: f64,
    /// The highest speed that is wanted, m/s.
    top_mps: f64,
}

impl<'a> Fit<'a> {
    fn new(given: &'a Given, car: &'a Vehicle, sight_mps: f64) -> Self {
        let reference = Vehicle::default();
        Self {
            given,
            car,
            longer: (car.length_m / reference.length_m).max(1.0),
            longer_m: (car.length_m - reference.length_m) / 2.0,
            wider_m: (car.width_m - reference.width_m) / 2.0,
            top_mps: sight_mps.min(SPEED_SHARE * car.max_speed_mps),
        }
    }

    /// Sets a key to what fits the car, unless it was given.
    fn set(&self, key: &str, value: &mut f64, fitted: f64) {
        let (section, name) = key.split_once('.').unwrap_or(("", key));
        let section = self.given.get(section).and_then(toml::Value::as_table);
        if !section.is_some_and(|section| section.contains_key(name)) {
            *value = fitted;
        }
    }

    /// Speeds and the goal: none where the scanner sees nothing.
    fn sight(&self, planner: &mut Planner, mpc: &mut Mpc, range_m: f64) {
        let (p, m) = (*planner, *mpc);
        let speed_mps = p.speed_mps.min(self.top_mps);
        self.set("planner.speed_mps", &mut planner.speed_mps, speed_mps);
        let speed_mps = m.speed_mps.min(self.top_mps);
        self.set("mpc.speed_mps", &mut mpc.speed_mps, speed_mps);
        let near_m = p.goal_near_m * self.longer;
        let goal_m = (p.goal_distance_m * self.longer.sqrt()).min(range_m.max(near_m));
        self.set(
            "planner.goal_distance_m",
            &mut planner.goal_distance_m,
            goal_m,
        );
    }

    /// What a path of the body's middle keeps from a return: half the width, the margin of
    /// the safety check and the tracking error, as `informed.inflation_m` of the default car;
    /// at most what the grid can draw.
    fn inflations(&self, planner: &mut Planner, informed: &mut Informed) {
        let grid_m = planner.cell_m * DISC_CELLS_MAX as f64;
        let inflation_m = (Informed::default().inflation_m + self.wider_m).min(grid_m);
        self.set("planner.inflation_m", &mut planner.inflation_m, inflation_m);
        self.set(
            "informed.inflation_m",
            &mut informed.inflation_m,
            inflation_m,
        );
    }

    fn planner(&self, planner: &mut Planner) {
        let p = *planner;
        let margin_m = self.car.width_m / 2.0 + BESIDE_M;
        self.set(
            "planner.lane_margin_m",
            &mut planner.lane_margin_m,
            margin_m,
        );
        let near_m = p.goal_near_m * self.longer;
        self.set("planner.goal_near_m", &mut planner.goal_near_m, near_m);
        let partial_m = (p.partial_min_m + self.longer_m).max(0.0);
        self.set(
            "planner.partial_min_m",
            &mut planner.partial_min_m,
            partial_m,
        );
    }

    fn kinodynamic(&self, settings: &mut Kinodynamic) {
        let margin_m = (settings.lane_margin_m + self.wider_m).max(0.0);
        self.set(
            "kinodynamic.lane_margin_m",
            &mut settings.lane_margin_m,
            margin_m,
        );
    }

    fn mpc(&self, mpc: &mut Mpc) {
        let m = *mpc;
        let brake_mps2 = m.brake_mps2.min(BRAKE_SHARE * self.car.max_brake_mps2);
        self.set("mpc.brake_mps2", &mut mpc.brake_mps2, brake_mps2);
        let standoff_m = (m.standoff_m + self.longer_m).max(0.0);
        self.set("mpc.standoff_m", &mut mpc.standoff_m, standoff_m);
    }

    fn controller(&self, controller: &mut Controller) {
        let c = *controller;
        let reference = Vehicle::default();
        let turn = |of: &Vehicle| of.max_steer_rad().tan() / of.wheelbase_m;
        let steer = turn(&reference) / turn(self.car);
        let pedal = reference.max_accel_mps2 / self.car.max_accel_mps2;
        let lookahead_m = c.lookahead_m * self.longer;
        self.set(
            "controller.lookahead_m",
            &mut controller.lookahead_m,
            lookahead_m,
        );
        self.set(
            "controller.steer_kp",
            &mut controller.steer_kp,
            c.steer_kp * steer,
        );
        self.set(
            "controller.steer_kd",
            &mut controller.steer_kd,
            c.steer_kd * steer,
        );
        self.set(
            "controller.pedal_kp",
            &mut controller.pedal_kp,
            c.pedal_kp * pedal,
        );
        self.set(
            "controller.pedal_kd",
            &mut controller.pedal_kd,
            c.pedal_kd * pedal,
        );
    }
}
