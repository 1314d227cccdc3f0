//! MetaDrive's traffic driver: the intelligent driver model along the lane, a
//! PID pair across it, and lane changes for the route or to overtake.
//!
//! Everything is as in `policy/idm_policy.py`, quirks included: the gains have no time
//! step, the model computes in km/h, and a car that enters a road from another lane
//! count aims at the leftmost lane for one tick. One thing differs: the wait after a
//! lane change (0 to 24 steps) comes from a small generator of its own instead of
//! numpy's.

use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use vehicle::{Action, Point, Vector, wrap_rad};

use crate::navigation::Navigator;
use crate::places::places;
use crate::road::{LaneId, Network, RoadId};

/// Speeds, km/h: desired, while waiting to change lanes, and assumed of an empty lane.
const NORMAL_KMH: f64 = 30.0;
const CREEP_KMH: f64 = 5.0;
const FREE_KMH: f64 = 100.0;
/// The driver looks this far along a lane, m.
const LOOK_M: f64 = 30.0;
/// Gaps that a lane change needs, m; a forced one needs less ahead.
const CHANGE_GAP_M: f64 = 15.0;
const FORCED_GAP_M: f64 = 5.0;
/// Steps between lane changes, and the gain of speed that one must bring.
const CHANGE_STEPS: u32 = 50;
const CHANGE_GAIN_KMH: f64 = 10.0;
/// Within this of the desired speed a driver does not overtake, km/h.
const CONTENT_KMH: f64 = 3.0;
/// Distance to a standing car, m; time gap in units of km/h and m; and the product of
/// the model's two accelerations.
const STANDING_GAP_M: f64 = 10.0;
const TIME_GAP: f64 = 1.5;
const ACCELERATIONS: f64 = 5.0;
/// Gains of the two controllers: proportional, integral, derivative.
const HEADING_GAINS: [f64; 3] = [1.7, 0.01, 3.5];
const LATERAL_GAINS: [f64; 3] = [0.3, 0.002, 0.05];

/// What a driver sees of a body on the road.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// Its centre.
    pub position_world: Point,
    /// Its velocity, m/s.
    pub velocity_world: Vector,
    /// Unit vector along its heading.
    pub forward_world: Vector,
}

impl Neighbour {
    fn speed_kmh(&self) -> f64 {
        self.velocity_world.norm() * 3.6
    }
}

/// A PID controller without a time step.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pid {
    error: f64,
    sum: f64,
}

impl Pid {
    const NEW: Pid = Pid {
        error: 0.0,
        sum: 0.0,
    };

    fn answer(&mut self, gains: [f64; 3], error: f64) -> f64 {
        self.sum += error;
        let change = error - self.error;
        self.error = error;
        -(gains[0] * error + gains[1] * self.sum + gains[2] * change)
    }
}

/// One driver.
#[derive(Clone, Debug, PartialEq)]
pub struct Idm {
    target_lane: Option<LaneId>,
    /// Speed on a free road.
    normal_kmh: f64,
    target_kmh: f64,
    overtake_timer: u32,
    heading: Pid,
    lateral: Pid,
    random: SplitMix64,
}

/// The world around one driver.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// The roads.
    pub network: &'a Network,
    /// The driver's route.
    pub navigator: &'a Navigator,
    /// All bodies on the road.
    pub bodies: &'a [Neighbour],
    /// The lane that each is on, apart from the rest: most bodies are on other lanes than
    /// those that a driver asks for, and only their lanes are read.
    pub lanes: &'a [LaneId],
    /// The index of the driver's own body.
    pub own: usize,
}

/// The nearest bodies on the lane to the left, the own lane and the lane to
/// the right; `None` where there is no lane.
type Sides = [Option<Surroundings>; 3];

/// The nearest bodies along one lane.
#[derive(Clone, Copy, Debug)]
struct Surroundings {
    front: Option<usize>,
    front_m: f64,
    back_m: f64,
}

/// What the driver follows: a body ahead at a distance, and a lane.
type Following = (Option<usize>, f64, LaneId);

impl Idm {
    /// A driver whose lane-change timer begins at `overtake_timer`; `seed`
    /// decides how long it waits after each change.
    pub fn new(overtake_timer: u32, seed: u64) -> Idm {
        Idm {
            target_lane: None,
            normal_kmh: NORMAL_KMH,
            target_kmh: NORMAL_KMH,
            overtake_timer,
            heading: Pid::NEW,
            lateral: Pid::NEW,
            random: SplitMix64::seed_from_u64(seed),
        }
    }

    /// The same driver with another speed on a free road, km/h, in place of MetaDrive's 30.
    #[must_use]
    pub fn at_kmh(self, normal_kmh: f64) -> Idm {
        Idm {
            normal_kmh,
            target_kmh: normal_kmh,
            ..self
        }
    }

    /// The action for this tick; its components may exceed [-1, 1].
    pub fn act(&mut self, view: &View) -> Action {
        let lanes = LanesOf::new(view.network, view.navigator.road());
        let (target, on_route) = self.follow_route(view, lanes);
        self.target_lane = Some(target);
        let (front, front_m, lane) = if on_route {
            self.choose_lane(view, lanes, target)
        } else {
            let here = surroundings(view, target);
            (here.front, here.front_m, target)
        };
        Action {
            steer: self.steer(view, lane),
            pedal: self.pedal(view, front, front_m),
        }
    }

    /// Which lane the route leads through, and whether it is on the current road.
    fn follow_route(&mut self, view: &View, lanes: LanesOf) -> (LaneId, bool) {
        let own = view.navigator.lane();
        let Some(target) = self.target_lane else {
            return (own, lanes.contains(own));
        };
        if !lanes.contains(target) {
            let end = view.network.road(view.network.road_of(target)).to;
            let to = view.network.road(view.navigator.road()).to;
            let connected = view.network.road_between(end, to).is_some();
            let joined = lanes
                .iter()
                .find(|&lane| connected || view.network.leads_to(target, lane));
            return joined.map_or((target, false), |lane| (lane, true));
        }
        if lanes.contains(own) && target != own {
            self.overtake_timer = self.draw(CHANGE_STEPS / 2);
            return (own, true);
        }
        (target, true)
    }

    fn choose_lane(&mut self, view: &View, lanes: LanesOf, target: LaneId) -> Following {
        let index = target.0 - lanes.first;
        let beside = |offset: i32| {
            let lane = i32::from(index) + offset;
            (0..i32::from(lanes.count))
                .contains(&lane)
                .then(|| LaneId(lanes.first + lane as u16))
        };
        let sides: Sides = [-1, 0, 1].map(|offset| beside(offset).map(|l| surroundings(view, l)));
        let [left, Some(here), right] = sides else {
            return (None, LOOK_M, target);
        };
        let stay = (here.front, here.front_m, target);
        let open = self.open_lanes(view, lanes);
        if !open.contains(&index) {
            let (offset, side) = if index >= open.end {
                (-1, left)
            } else {
                (1, right)
            };
            let (Some(side), Some(lane)) = (side, beside(offset)) else {
                return stay;
            };
            if side.back_m < CHANGE_GAP_M || side.front_m < FORCED_GAP_M {
                self.target_kmh = CREEP_KMH;
                return stay;
            }
            self.target_kmh = self.normal_kmh;
            return (side.front, side.front_m, lane);
        }
        let own_kmh = view.bodies[view.own].speed_kmh();
        if let Some(front) = here.front {
            let front_kmh = view.bodies[front].speed_kmh();
            let may_change = (own_kmh - self.normal_kmh).abs() > CONTENT_KMH
                && (front_kmh - self.normal_kmh).abs() > CONTENT_KMH
                && self.overtake_timer > CHANGE_STEPS;
            for (offset, side) in [(-1, left), (1, right)] {
                let gain_kmh = side
                    .and_then(|side| lane_kmh(view, &side))
                    .map(|v| v - front_kmh);
                if let (true, Some(side), Some(lane)) = (may_change, side, beside(offset))
                    && gain_kmh.is_some_and(|gain| gain > CHANGE_GAIN_KMH)
                    && open.contains(&(lane.0 - lanes.first))
                {
                    return (side.front, side.front_m, lane);
                }
            }
        }
        self.target_kmh = self.normal_kmh;
        self.overtake_timer += 1;
        stay
    }

    /// The lanes, by index, that continue in the next road when it has fewer.
    fn open_lanes(&self, view: &View, lanes: LanesOf) -> std::ops::Range<u16> {
        let Some(next) = view.navigator.next_road() else {
            return 0..lanes.count;
        };
        let next = LanesOf::new(view.network, next);
        if next.count >= lanes.count {
            return 0..lanes.count;
        }
        if view
            .network
            .leads_to(LaneId(lanes.first), LaneId(next.first))
        {
            0..next.count
        } else {
            lanes.count - next.count..lanes.count
        }
    }

    fn steer(&mut self, view: &View, lane: LaneId) -> f64 {
        let own = &view.bodies[view.own];
        let (longitudinal_m, lateral_m) =
            view.navigator
                .coordinates(view.network, lane, own.position_world);
        let lane_rad = view.network.lane(lane).heading_at(longitudinal_m + 1.0);
        let own_rad = own.forward_world.y.atan2(own.forward_world.x);
        let turn = self
            .heading
            .answer(HEADING_GAINS, -wrap_rad(lane_rad - own_rad));
        turn + self.lateral.answer(LATERAL_GAINS, -lateral_m)
    }

    fn pedal(&self, view: &View, front: Option<usize>, front_m: f64) -> f64 {
        let own = &view.bodies[view.own];
        let own_kmh = own.speed_kmh();
        let free = 1.0 - (own_kmh / self.target_kmh).powi(10);
        let Some(front) = front.map(|front| &view.bodies[front]) else {
            return free;
        };
        let closing_kmh = 3.6 * (own.velocity_world - front.velocity_world).dot(&own.forward_world);
        let wanted = STANDING_GAP_M
            + own_kmh * TIME_GAP
            + own_kmh * closing_kmh / (2.0 * ACCELERATIONS.sqrt());
        free - (wanted / front_m.max(1e-2)).powi(2)
    }

    /// A number below `count`: the upper half of SplitMix64's number, before its last
    /// step changes the lowest bit of that half. All recorded runs depend on this bit.
    fn draw(&mut self, count: u32) -> u32 {
        let drawn = self.random.next_u64();
        ((drawn >> 32) ^ (drawn >> 63)) as u32 % count.max(1)
    }
}

/// The lanes of a road, by their consecutive ids.
#[derive(Clone, Copy, Debug)]
struct LanesOf {
    first: u16,
    count: u16,
}

impl LanesOf {
    fn new(network: &Network, road: RoadId) -> LanesOf {
        let road = network.road(road);
        LanesOf {
            first: road.first_lane.0,
            count: road.lane_count,
        }
    }

    fn contains(self, lane: LaneId) -> bool {
        (self.first..self.first + self.count).contains(&lane.0)
    }

    fn iter(self) -> impl Iterator<Item = LaneId> {
        (self.first..self.first + self.count).map(LaneId)
    }
}

/// Speed that a neighbouring lane offers, km/h: that of its first car, or the free
/// speed when its gaps are wide enough.
fn lane_kmh(view: &View, side: &Surroundings) -> Option<f64> {
    match side.front {
        Some(front) => Some(view.bodies[front].speed_kmh()),
        None => (side.front_m > CHANGE_GAP_M && side.back_m > CHANGE_GAP_M).then_some(FREE_KMH),
    }
}

/// The nearest bodies ahead and behind on a lane, or on the lanes that join it.
fn surroundings(view: &View, lane_id: LaneId) -> Surroundings {
    let network = view.network;
    let (lane, joins) = (network.lane(lane_id), network.joins(lane_id));
    let own = &view.bodies[view.own];
    let (own_m, _) = view
        .navigator
        .coordinates(network, lane_id, own.position_world);
    let left_m = lane.length_m - own_m;
    let mut found = Surroundings {
        front: None,
        front_m: LOOK_M,
        back_m: LOOK_M,
    };
    let (mut front_here, mut back_here) = (false, false);
    for index in places(view.lanes, |&lane| joins.may_hold(lane)) {
        let body_lane = view.lanes[index];
        if index == view.own {
            continue;
        }
        let along_m = || {
            let position_world = view.bodies[index].position_world;
            network.lane(body_lane).local_coordinates(position_world).0
        };
        if body_lane == lane_id {
            let ahead_m = along_m() - own_m;
            if ahead_m > 0.0 && ahead_m < found.front_m {
                (found.front_m, found.front, front_here) = (ahead_m, Some(index), true);
            }
            if ahead_m < 0.0 && -ahead_m < found.back_m {
                (found.back_m, back_here) = (-ahead_m, true);
            }
        } else if !front_here && joins.leads_to(body_lane) {
            let ahead_m = along_m() + left_m;
            if ahead_m > 0.0 && ahead_m < found.front_m {
                (found.front_m, found.front) = (ahead_m, Some(index));
            }
        } else if !back_here && joins.follows(body_lane) {
            let length_m = network.lane(body_lane).length_m;
            found.back_m = found.back_m.min(length_m - along_m() + own_m);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All recorded runs depend on these numbers.
    #[test]
    fn a_seed_draws_the_numbers_it_always_drew() {
        let mut driver = Idm::new(0, 1234);
        let drawn = [(); 4].map(|()| driver.draw(1000));
        assert_eq!(drawn, [826, 551, 84, 258]);
    }
}
