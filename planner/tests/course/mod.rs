//! A small world to plan in: a road of arcs, boxes standing on it, and what a
//! car on it observes. Used by the tests and the example, each a part of it.
#![allow(dead_code)]

pub mod driver;

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use shm_config::message::{Checkpoint, Observation};
use vehicle::{Footprint, Point, Pose, State, Vector, Vehicle, pose, wrap_rad};

/// Three lanes of 3.5 m.
pub const ROAD_WIDTH_M: f64 = 10.5;
const LIDAR_MAX_M: f64 = 50.0;
const BEAMS: usize = 240;

/// One road of the course: its middle line, from its beginning.
#[derive(Debug, Clone, Copy)]
pub struct Road {
    pub length_m: f64,
    /// Counter-clockwise, 1/m; 0 for a straight road.
    pub curvature_per_m: f64,
}

/// A box that stands on the road.
#[derive(Debug, Clone, Copy)]
pub struct Obstacle {
    pub world_from_obstacle: Pose,
    pub footprint: Footprint,
}

#[derive(Debug, Clone)]
pub struct Course {
    roads: Vec<(Pose, Road)>,
    pub obstacles: Vec<Obstacle>,
}

/// Where a point is on the course.
#[derive(Debug, Clone, Copy)]
pub struct Place {
    road: usize,
    pub along_m: f64,
    /// Positive left of the middle line.
    pub across_m: f64,
    pub road_heading_world_rad: f64,
}

fn along(road: &Road, distance_m: f64) -> Pose {
    let turn_rad = road.curvature_per_m * distance_m;
    if turn_rad == 0.0 {
        return pose(distance_m, 0.0, 0.0);
    }
    let radius_m = 1.0 / road.curvature_per_m;
    pose(
        radius_m * turn_rad.sin(),
        radius_m * (1.0 - turn_rad.cos()),
        turn_rad,
    )
}

impl Course {
    pub fn new(roads: &[Road]) -> Self {
        let mut at = pose(0.0, 0.0, 0.0);
        let roads = roads
            .iter()
            .map(|road| {
                let start = at;
                at *= along(road, road.length_m);
                (start, *road)
            })
            .collect();
        Self {
            roads,
            obstacles: Vec::new(),
        }
    }

    pub fn length_m(&self) -> f64 {
        self.roads.iter().map(|(_, road)| road.length_m).sum()
    }

    /// The middle line at this distance; x along the road.
    pub fn pose_at(&self, mut distance_m: f64) -> Pose {
        for (start, road) in &self.roads {
            if distance_m <= road.length_m {
                return start * along(road, distance_m);
            }
            distance_m -= road.length_m;
        }
        let (start, road) = self.roads[self.roads.len() - 1];
        start * along(&road, road.length_m) * pose(distance_m, 0.0, 0.0)
    }

    /// Puts a box beside the middle line, along the road.
    pub fn put(&mut self, along_m: f64, across_m: f64, footprint: Footprint) {
        self.obstacles.push(Obstacle {
            world_from_obstacle: self.pose_at(along_m) * pose(0.0, across_m, 0.0),
            footprint,
        });
    }

    /// The nearest place of the middle line, searched every metre and then
    /// every 2 cm.
    pub fn place(&self, point_world: Point) -> Place {
        let nearest_of = |from_m: f64, to_m: f64, step_m: f64| {
            let square = |along_m: f64| {
                (self.pose_at(along_m).translation.vector - point_world.coords).norm_squared()
            };
            (0..=((to_m - from_m) / step_m) as usize)
                .map(|step| (from_m + step as f64 * step_m).clamp(0.0, self.length_m()))
                .min_by(|&a, &b| square(a).total_cmp(&square(b)))
                .unwrap()
        };
        let coarse_m = nearest_of(0.0, self.length_m(), 1.0);
        let nearest = nearest_of(coarse_m - 1.0, coarse_m + 1.0, 0.02);
        let world_from_road = self.pose_at(nearest);
        let mut begin_m = 0.0;
        let road = self
            .roads
            .iter()
            .position(|(_, road)| {
                begin_m += road.length_m;
                nearest < begin_m
            })
            .unwrap_or(self.roads.len() - 1);
        Place {
            road,
            along_m: nearest,
            across_m: world_from_road.inverse_transform_point(&point_world).y,
            road_heading_world_rad: world_from_road.rotation.angle(),
        }
    }

    /// Smallest distance between the car's body and an obstacle, m, by points
    /// every 10 cm of the car's outline; negative when they overlap.
    pub fn clearance_m(&self, vehicle: &Vehicle, world_from_body: &Pose) -> f64 {
        let corners = vehicle.footprint().corners(world_from_body);
        (0..4)
            .flat_map(|side| {
                let (a, b) = (corners[side], corners[(side + 1) % 4]);
                (0..46).map(move |step| a + (b - a) * (f64::from(step) / 46.0))
            })
            .flat_map(|point| {
                self.obstacles.iter().map(move |obstacle| {
                    obstacle
                        .footprint
                        .distance_m(obstacle.world_from_obstacle.inverse_transform_point(&point))
                })
            })
            .fold(f64::INFINITY, f64::min)
    }

    /// What the car perceives.
    pub fn observe(&self, state: &State, tick: u64) -> Observation {
        let place = self.place(state.position);
        let body_from_world = state.pose().inverse();
        let mut observation = Observation {
            lidar_max_m: LIDAR_MAX_M as f32,
            beam_count: BEAMS as u32,
            ..Observation::default()
        };
        observation.header.tick = tick;
        observation.ego.x_world_m = state.position.x;
        observation.ego.y_world_m = state.position.y;
        observation.ego.heading_world_rad = state.heading_rad;
        observation.ego.speed_mps = state.speed_mps;
        observation.road.left_m = ROAD_WIDTH_M / 2.0 - place.across_m;
        observation.road.right_m = ROAD_WIDTH_M / 2.0 + place.across_m;
        observation.road.heading_rad = wrap_rad(state.heading_rad - place.road_heading_world_rad);
        for (ahead, checkpoint) in observation.checkpoints.iter_mut().enumerate() {
            let (start, road) = self.roads[(place.road + ahead).min(self.roads.len() - 1)];
            let end = body_from_world * start * along(&road, road.length_m);
            *checkpoint = Checkpoint {
                x_body_m: end.translation.x,
                y_body_m: end.translation.y,
                ..Checkpoint::default()
            };
        }
        for (beam, range_m) in observation.ranges_m[..BEAMS].iter_mut().enumerate() {
            let angle_rad = std::f64::consts::TAU * beam as f64 / BEAMS as f64;
            let ray = state.pose() * pose(0.0, 0.0, angle_rad);
            *range_m = self
                .obstacles
                .iter()
                .filter_map(|obstacle| obstacle.hit_m(&ray))
                .fold(LIDAR_MAX_M, f64::min) as f32;
        }
        observation
    }
}

impl Obstacle {
    /// Distance along a ray (the x axis of its pose) to the box, m.
    fn hit_m(&self, world_from_ray: &Pose) -> Option<f64> {
        let ray = self.world_from_obstacle.inverse() * world_from_ray;
        let direction = ray.rotation * Vector::x();
        let half = Vector::new(self.footprint.length_m, self.footprint.width_m) / 2.0;
        let (mut enter, mut leave) = (0.0f64, f64::INFINITY);
        for axis in 0..2 {
            let (from, slope) = (ray.translation.vector[axis], direction[axis]);
            let (a, b) = ((-half[axis] - from) / slope, (half[axis] - from) / slope);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
        (enter <= leave).then_some(enter)
    }
}

pub const CAR: Footprint = Footprint {
    length_m: 4.6,
    width_m: 1.85,
};
pub const CONE: Footprint = Footprint {
    length_m: 0.4,
    width_m: 0.4,
};
pub const BARRIER: Footprint = Footprint {
    length_m: 0.3,
    width_m: 2.0,
};

/// Reproducible choices.
pub struct Dice(Xoshiro256PlusPlus);

impl Dice {
    pub fn new(seed: u64) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(seed))
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn below(&mut self, count: u64) -> u64 {
        (self.between(0.0, count as f64) as u64).min(count - 1)
    }
}

/// A straight road or a bend, a road after it, up to four obstacles ahead, and
/// a car somewhere on the first road, not quite along it.
pub fn random_scene(seed: u64) -> Observation {
    let mut dice = Dice::new(seed);
    let curvature_per_m = match dice.below(3) {
        0 => 0.0,
        1 => 1.0 / dice.between(15.0, 60.0),
        _ => -1.0 / dice.between(15.0, 60.0),
    };
    let mut course = Course::new(&[
        Road {
            length_m: dice.between(30.0, 60.0),
            curvature_per_m,
        },
        Road {
            length_m: 40.0,
            curvature_per_m: 0.0,
        },
    ]);
    let along_m = dice.between(0.0, 30.0);
    for _ in 0..dice.below(5) {
        let lane_m = 3.5 * (dice.below(3) as f64 - 1.0);
        let ahead_m = along_m + dice.between(6.0, 25.0);
        match dice.below(3) {
            0 => course.put(ahead_m, lane_m, CAR),
            1 => course.put(ahead_m, lane_m, BARRIER),
            _ => (0..5).for_each(|cone| {
                course.put(ahead_m + 2.0 * f64::from(cone), lane_m, CONE);
            }),
        }
    }
    let world_from_body =
        course.pose_at(along_m) * pose(0.0, dice.between(-4.2, 4.2), dice.between(-0.25, 0.25));
    let state = State {
        position: world_from_body.translation.vector.into(),
        heading_rad: world_from_body.rotation.angle(),
        speed_mps: 5.0,
    };
    course.observe(&state, seed)
}
