//! The search by rows against one that asks for each place by itself.

use proptest::prelude::*;
use shm_config::message::Observation;
use vehicle::{Point, Vehicle};

use super::*;

/// Where a car stands and what is around it.
#[derive(Debug, Clone)]
struct Scene {
    half_width_m: f64,
    obstacles: Vec<(f64, f64)>,
    left_m: f64,
    slope: f64,
    last: Option<Path>,
    clearance_m: f64,
    contact_m: f64,
}

fn scenes() -> impl Strategy<Value = Scene> {
    let obstacles = prop::collection::vec((-4.0..42.0, -6.0..6.0), 0..40);
    let last = prop::option::of(prop::collection::vec(-4.0..4.0, STATIONS + 1));
    let room = (0.1..2.0, 0.0..0.3);
    (2.0..9.0, obstacles, -9.0..9.0, -0.9..0.9, last, room).prop_map(
        |(half_width_m, obstacles, left_m, slope, last, (clearance_m, contact_m))| Scene {
            half_width_m,
            obstacles,
            left_m,
            slope,
            clearance_m,
            contact_m,
            last: last.map(|left_m: Vec<f64>| Path {
                left_m: left_m.into_iter().collect(),
                is_blocked: false,
            }),
        },
    )
}

/// As [`Lattice::search`] and [`Ground::costs`] have it, in the plainest words.
struct Slow<'a> {
    ground: &'a Ground<'a>,
    begin_left_m: f64,
    begin_lane: i32,
    clear_least_m: f64,
    edge_least_m: f64,
}

impl<'a> Slow<'a> {
    fn new(ground: &'a Ground<'a>, left_m: f64, slope: f64) -> Self {
        let begin_lane = ((left_m / ACROSS_M).round() as i32).clamp(-SIDE, SIDE);
        let mut slow = Self {
            ground,
            begin_left_m: left_m,
            begin_lane,
            clear_least_m: 0.0,
            edge_least_m: 0.0,
        };
        let along_m = 0.0;
        slow.clear_least_m = slow.clear_m(Place { along_m, left_m }, slope) - 0.02;
        slow.edge_least_m = ground.edge_m(Place { along_m, left_m }, slope) - 0.02;
        slow
    }

    fn left_m(&self, lane: i32) -> f64 {
        self.begin_left_m + f64::from(lane - self.begin_lane) * ACROSS_M
    }

    fn clear_m(&self, place: Place, slope: f64) -> f64 {
        let ahead = 1.0 / slope.hypot(1.0);
        let discs_m = self.ground.body.offsets_m.map(|offset_m| {
            self.ground.field.clearance_m(Place {
                along_m: place.along_m + offset_m * ahead,
                left_m: place.left_m + offset_m * ahead * slope,
            })
        });
        discs_m.into_iter().fold(f64::INFINITY, f64::min) - self.ground.body.radius_m
    }

    /// The cost of being in a lane at a station, having come there with a slope; `None` where
    /// it is not free.
    fn cost(&self, station: usize, lane: i32, steep: i32) -> Option<f64> {
        let slope = f64::from(steep) * ACROSS_M / STATION_M;
        let (along_m, left_m) = (station as f64 * STATION_M, self.left_m(lane));
        let halfway = Place {
            along_m: along_m - STATION_M / 2.0,
            left_m: left_m - slope * STATION_M / 2.0,
        };
        let place = Place { along_m, left_m };
        let clear_m = self.clear_m(place, slope).min(self.clear_m(halfway, slope));
        let edge_m = self.ground.edge_m(place, slope) + BEYOND_M;
        let config = self.ground.config;
        let (clear_least_m, edge_least_m) = match station <= 2 {
            true => (
                self.clear_least_m.min(config.contact_m),
                self.edge_least_m.min(0.0),
            ),
            false => (config.contact_m, 0.0),
        };
        if clear_m < clear_least_m || edge_m < edge_least_m {
            return None;
        }
        let tight = |room_m: f64, wanted_m: f64| {
            f64::from(TIGHT) * (1.0 - room_m / wanted_m).max(0.0).powi(2)
        };
        let off_m = self.ground.last.map(|last| left_m - last.at(along_m).0);
        Some(
            f64::from(MIDDLE) * left_m.powi(2)
                + f64::from(SLOPE) * slope.powi(2)
                + f64::from(LAST) * off_m.unwrap_or(0.0).clamp(-2.0, 2.0).powi(2)
                + tight(clear_m, config.clearance_m)
                + tight(edge_m, EDGE_M),
        )
    }

    /// The stations that can be reached, and the least cost of a way to the last of them.
    fn search(&self, begin_steep: i32) -> (usize, f64) {
        let mut reached = vec![(self.begin_lane, begin_steep, 0.0)];
        for station in 1..=STATIONS {
            let mut next: Vec<(i32, i32, f64)> = Vec::new();
            for steep in -STEEP..=STEEP {
                for lane in -SIDE..=SIDE {
                    let ways = reached.iter().filter(|(from, before, _)| {
                        from + steep == lane && (steep - before).abs() <= CHANGE
                    });
                    let least = ways
                        .map(|(_, before, cost)| cost + bend(*before, steep))
                        .fold(f64::INFINITY, f64::min);
                    if least < f64::INFINITY
                        && let Some(here) = self.cost(station, lane, steep)
                    {
                        next.push((lane, steep, least + here));
                    }
                }
            }
            if next.is_empty() {
                return (station - 1, least_of(&reached));
            }
            reached = next;
        }
        (STATIONS, least_of(&reached))
    }

    /// What the path of the search costs; `None` where it is no way of the lattice.
    fn cost_of(&self, path: &Path, begin_steep: i32) -> Option<f64> {
        let (mut lane, mut before, mut sum) = (self.begin_lane, begin_steep, 0.0);
        for (station, place) in path.places().enumerate().skip(1) {
            let to =
                self.begin_lane + ((place.left_m - self.begin_left_m) / ACROSS_M).round() as i32;
            let steep = to - lane;
            if steep.abs() > STEEP || (steep - before).abs() > CHANGE {
                return None;
            }
            sum += bend(before, steep) + self.cost(station, to, steep)?;
            (lane, before) = (to, steep);
        }
        Some(sum)
    }
}

fn bend(before: i32, steep: i32) -> f64 {
    f64::from(BEND) * f64::from(steep - before).powi(2)
}

fn least_of(reached: &[(i32, i32, f64)]) -> f64 {
    reached
        .iter()
        .map(|(_, _, cost)| *cost)
        .fold(f64::INFINITY, f64::min)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_path_is_the_cheapest_of_a_search_place_by_place(scene in scenes()) {
        let mut observation = Observation::default();
        (observation.road.left_m, observation.road.right_m) =
            (scene.half_width_m, scene.half_width_m);
        (observation.checkpoints[0].x_body_m, observation.checkpoints[1].x_body_m) = (60.0, 60.0);
        let line = Line::new(&observation);
        let mut field = Field::new();
        // The road is straight: places along it are those of the body frame.
        let obstacles = scene.obstacles.iter();
        field.mark_resting(&line, obstacles.map(|&(x_m, y_m)| Point::new(x_m, y_m)));
        let config = Config {
            clearance_m: scene.clearance_m,
            contact_m: scene.contact_m,
            ..Config::default()
        };
        let ground = Ground {
            line: &line,
            field: &field,
            body: &Body::new(&Vehicle::default()),
            config: &config,
            last: scene.last.as_ref(),
        };
        let steepness = scene.slope * STATION_M / ACROSS_M;
        let begin_steep = (steepness.round() as i32).clamp(-STEEP, STEEP);
        let slow = Slow::new(&ground, scene.left_m, scene.slope);
        let (reached, least) = slow.search(begin_steep);

        let mut lattice = Lattice::new();
        // What an earlier search leaves behind counts for nothing.
        lattice.search(&ground, -scene.left_m, -scene.slope);
        let path = lattice.search(&ground, scene.left_m, scene.slope);

        prop_assert_eq!(path.is_blocked, reached < STATIONS);
        prop_assert_eq!(path.places().count(), reached + 1);
        let cost = slow.cost_of(&path, begin_steep);
        // The search adds numbers of 32 bits.
        let is_least = cost.is_some_and(|cost| (cost - least).abs() <= 1e-4 * (1.0 + least));
        prop_assert!(is_least, "{:?} in place of {least}", cost);
    }
}
