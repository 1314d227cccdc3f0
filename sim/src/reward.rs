//! Reward and cost of a tick, as MetaDrive reckons them.
//! Source: `reward_function` and `cost_function` of `envs/metadrive_env.py`.

use serde::{Deserialize, Serialize};
use shm_config::message::Outcome;

use crate::world::World;

/// Speed at which the speed term is one, km/h (`max_speed_km_h` of the vehicle).
const SPEED_MAX_KMH: f64 = 80.0;

/// Weights of the terms; names and defaults are MetaDrive's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RewardConfig {
    /// For each metre along the lane.
    pub driving_reward: f64,
    /// For driving at the greatest speed, in proportion to the speed.
    pub speed_reward: f64,
    /// Replaces the sum at the destination.
    pub success_reward: f64,
    /// Its negative replaces the sum off the road.
    pub out_of_road_penalty: f64,
    /// Its negative replaces the sum in contact with a vehicle.
    pub crash_vehicle_penalty: f64,
    /// Its negative replaces the sum in contact with an object.
    pub crash_object_penalty: f64,
    /// Whether the driving term shrinks towards the lane's edge.
    pub use_lateral_reward: bool,
    /// Cost of a tick off the road.
    pub out_of_road_cost: f64,
    /// Cost of a tick in contact with a vehicle.
    pub crash_vehicle_cost: f64,
    /// Cost of a tick in contact with an object.
    pub crash_object_cost: f64,
}

impl Default for RewardConfig {
    fn default() -> RewardConfig {
        RewardConfig {
            driving_reward: 1.0,
            speed_reward: 0.1,
            success_reward: 10.0,
            out_of_road_penalty: 5.0,
            crash_vehicle_penalty: 5.0,
            crash_object_penalty: 5.0,
            use_lateral_reward: false,
            out_of_road_cost: 1.0,
            crash_vehicle_cost: 1.0,
            crash_object_cost: 1.0,
        }
    }
}

/// What a tick was worth.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reward {
    /// The reward.
    pub reward: f64,
    /// The cost, apart from it; never negative with the default weights.
    pub cost: f64,
    /// Driving and speed terms alone, before an event replaced them (`step_reward`).
    pub step_reward: f64,
}

impl RewardConfig {
    /// Reward and cost of the last tick of a world.
    pub fn of(&self, world: &World) -> Reward {
        let (network, navigator) = (&world.map().network, world.navigator());
        let road = network.road(navigator.road());
        // A car that left the roads of its route is measured along the leftmost lane.
        let own = navigator.lane();
        let lane = match network.road_of(own) == navigator.road() {
            true => own,
            false => road.first_lane,
        };
        let before_m = navigator.before_m(network, lane);
        let (now_m, lateral_m) = navigator.coordinates(network, lane, world.ego_position());
        let width_m = network.lane(own).width_m;
        let lateral_factor = match self.use_lateral_reward {
            true => (1.0 - 2.0 * lateral_m.abs() / width_m).clamp(0.0, 1.0),
            false => 1.0,
        };
        let speed_kmh = world.speed_mps() * 3.6;
        let step_reward = self.driving_reward * (now_m - before_m) * lateral_factor
            + self.speed_reward * speed_kmh / SPEED_MAX_KMH;
        let step = world.last_step();
        let (reward, cost) = match (step.outcome, step.touch) {
            (Outcome::Arrived, touch) => (self.success_reward, self.contact_cost(touch)),
            (Outcome::OutOfRoad, _) => (-self.out_of_road_penalty, self.out_of_road_cost),
            (_, touch) if touch.vehicle => (-self.crash_vehicle_penalty, self.crash_vehicle_cost),
            (_, touch) if touch.object => (-self.crash_object_penalty, self.crash_object_cost),
            _ => (step_reward, 0.0),
        };
        Reward {
            reward,
            cost,
            step_reward,
        }
    }

    fn contact_cost(&self, touch: crate::bodies::Touch) -> f64 {
        match (touch.vehicle, touch.object) {
            (true, _) => self.crash_vehicle_cost,
            (false, true) => self.crash_object_cost,
            (false, false) => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use vehicle::Action;

    use super::*;
    use crate::WorldConfig;
    use crate::idm::Idm;

    const AHEAD: Action = Action {
        steer: 0.0,
        pedal: 1.0,
    };

    fn world(letters: &str) -> World {
        let config = WorldConfig {
            block_sequence: letters.into(),
            traffic_density: 0.0,
            accident_probability: 0.0,
            ..WorldConfig::default()
        };
        let mut world = World::new(config).expect("a world");
        world.reset(100).expect("a map");
        world
    }

    #[test]
    fn a_straight_drive_earns_its_metres_and_its_speed() {
        let mut world = world("SSS");
        let config = RewardConfig::default();
        let (mut reward, mut expected) = (0.0, 0.0);
        for _ in 0..50 {
            let before_m = world.driven_m();
            world.step(AHEAD);
            let worth = config.of(&world);
            assert_eq!((worth.reward, worth.cost), (worth.step_reward, 0.0));
            reward += worth.reward;
            expected += world.driven_m() - before_m + 0.1 * world.speed_mps() * 3.6 / 80.0;
        }
        assert!(world.driven_m() > 20.0);
        assert!(
            (reward - expected).abs() < 1e-3 * expected,
            "{reward} {expected}"
        );
    }

    #[test]
    fn the_navigator_remembers_the_coordinates_that_the_lane_has() {
        let mut world = world("SCrRXO");
        let mut idm = Idm::new(0, 1);
        let (mut lanes, mut changes) = (0, 0);
        loop {
            let (before_world, before_lane) = (world.ego_position(), world.navigator().lane());
            let action = world.advise(&mut idm);
            if world.step(action).has_ended() {
                break;
            }
            let (network, navigator) = (&world.map().network, world.navigator());
            changes += usize::from(navigator.lane() != before_lane);
            for road in [navigator.road(), network.road_of(navigator.lane())] {
                for lane in network.lane_ids(road) {
                    let of = |place| network.lane(lane).local_coordinates(place);
                    let here = world.ego_position();
                    assert_eq!(navigator.coordinates(network, lane, here), of(here));
                    assert_eq!(navigator.before_m(network, lane), of(before_world).0);
                    lanes += 1;
                }
            }
        }
        assert!(
            lanes > 1_000 && changes > 5,
            "{lanes} lanes, {changes} changes"
        );
    }

    #[test]
    fn leaving_the_road_replaces_the_reward_and_costs() {
        let mut world = world("C");
        let config = RewardConfig {
            out_of_road_penalty: 7.0,
            out_of_road_cost: 3.0,
            ..RewardConfig::default()
        };
        while !world.step(AHEAD).has_ended() {}
        assert_eq!(world.last_step().outcome, Outcome::OutOfRoad);
        let worth = config.of(&world);
        assert_eq!((worth.reward, worth.cost), (-7.0, 3.0));
        assert!(worth.step_reward > 0.0);
    }
}
