use std::array;

use crate::mpc::body::Body;
use crate::mpc::field::{ACROSS_M, FAR_M, Field};
use crate::mpc::line::{Line, Place};
use shm_config::config::Mpc as Config;

/// Distance between two stations, m along the road.
const STATION_M: f64 = 2.0;
/// Stations after the first: the path is 36 m long.
pub(crate) const STATIONS: usize = 18;
/// Lanes on either side of the middle line, each as wide as a cell of the field.
const SIDE: i32 = 32;
const LANES: usize = 2 * SIDE as usize + 1;
/// Steepest slope to either side: lanes per station, so 0.625 m per m.
const STEEP: i32 = 5;
const SLOPES: usize = 2 * STEEP as usize + 1;
/// Most change of slope from station to station: a radius of 5.3 m, twice that
/// of the wheels at their stop.
const CHANGE: i32 = 3;
/// The sidewalk begins 0.2 m outside the road; half of it may be used.
const BEYOND_M: f64 = 0.1;
/// Near an edge, m, costs as much as near an obstacle.
const EDGE_M: f64 = 0.3;

/// Costs of a station: one metre off the middle line, one metre off the last
/// path, squared; a slope of 1, squared; a change of slope by one lane; no
/// clearance left, squared.
const MIDDLE: f32 = 0.02;
const LAST: f32 = 0.1;
const SLOPE: f32 = 1.0;
const BEND: f32 = 0.25;
const TIGHT: f32 = 4.0;

/// A path along the road: how far to the left at each station.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Path {
    left_m: heapless::Vec<f64, { STATIONS + 1 }>,
    /// Whether it ends because no later station is free.
    pub(crate) is_blocked: bool,
}

impl Path {
    /// The path through places in order along the road, by lines between them;
    /// `None` when they do not reach from the car on.
    pub(crate) fn through(places: impl Iterator<Item = Place> + Clone) -> Option<Self> {
        let offset_at = |along_m: f64| {
            let after = places.clone().find(|place| place.along_m >= along_m)?;
            let before = places
                .clone()
                .take_while(|place| place.along_m < along_m)
                .last()?;
            let part = (along_m - before.along_m) / (after.along_m - before.along_m);
            Some(before.left_m + part * (after.left_m - before.left_m))
        };
        let left_m: heapless::Vec<f64, { STATIONS + 1 }> = (0..=STATIONS)
            .map_while(|station| offset_at(station as f64 * STATION_M + 1e-3))
            .collect();
        (!left_m.is_empty()).then_some(Self {
            left_m,
            is_blocked: false,
        })
    }

    /// How long it is, m along the road.
    pub(crate) fn length_m(&self) -> f64 {
        self.left_m.len().saturating_sub(1) as f64 * STATION_M
    }

    /// Its stations as places.
    pub(crate) fn places(&self) -> impl Iterator<Item = Place> + '_ {
        self.left_m
            .iter()
            .enumerate()
            .map(|(station, &left_m)| Place {
                along_m: station as f64 * STATION_M,
                left_m,
            })
    }

    /// Offset at a distance, m to the left, and its slope; beyond its end it goes
    /// on along the road.
    pub(crate) fn at(&self, along_m: f64) -> (f64, f64) {
        let last = self.left_m.len().saturating_sub(1);
        let position = (along_m / STATION_M).max(0.0);
        let station = position as usize;
        match station < last {
            true => {
                let rise_m = self.left_m[station + 1] - self.left_m[station];
                let left_m = self.left_m[station] + rise_m * (position - station as f64);
                (left_m, rise_m / STATION_M)
            }
            false => (self.left_m.last().copied().unwrap_or(0.0), 0.0),
        }
    }

    /// How much its slope changes around a distance, 1/m.
    pub(crate) fn bend_per_m(&self, along_m: f64) -> f64 {
        let half_m = STATION_M / 2.0;
        let (before, after) = (self.at(along_m - half_m).1, self.at(along_m + half_m).1);
        (after - before) / STATION_M
    }
}

/// A number for each lane, from the right to the left. Each step of the search works on a whole
/// row, so that the compiler can use vectors.
type Lanes<T> = [T; LANES];

/// Finds the cheapest path over a lattice of places and slopes by dynamic
/// programming: which side each obstacle is passed on.
#[derive(Debug)]
pub(crate) struct Lattice {
    /// For each slope and lane.
    cost: Box<[Lanes<f32>; SLOPES]>,
    next: Box<[Lanes<f32>; SLOPES]>,
    /// The slope before, for each station, slope and lane.
    from: Box<[[Lanes<i8>; SLOPES]; STATIONS]>,
}

/// What a path is searched in.
pub(crate) struct Ground<'a> {
    pub(crate) line: &'a Line,
    pub(crate) field: &'a Field,
    pub(crate) body: &'a Body,
    pub(crate) config: &'a Config,
    /// The path of the last plan, seen from here.
    pub(crate) last: Option<&'a Path>,
}

impl Lattice {
    /// The only place that allocates.
    pub(crate) fn new() -> Self {
        Self {
            cost: Box::new([[f32::INFINITY; LANES]; SLOPES]),
            next: Box::new([[f32::INFINITY; LANES]; SLOPES]),
            from: Box::new([[[0; LANES]; SLOPES]; STATIONS]),
        }
    }

    /// The cheapest path from `left_m` beside the middle line, with this slope
    /// against the road; the farthest one when none is free to the end.
    pub(crate) fn search(&mut self, ground: &Ground, left_m: f64, slope: f64) -> Path {
        let begin_lane = (left_m / ACROSS_M).round().clamp(-SIDE as f64, SIDE as f64);
        // The lattice is shifted so that the car stands on a lane of it.
        let shift_m = left_m - begin_lane * ACROSS_M;
        let lanes_m: Lanes<f64> =
            array::from_fn(|lane| f64::from(lane as i32 - SIDE) * ACROSS_M + shift_m);
        let steepness = slope * STATION_M / ACROSS_M;
        let begin_slope = steepness.round().clamp(-STEEP as f64, STEEP as f64) as i32;
        let begin = Place {
            along_m: 0.0,
            left_m,
        };
        let mut nearest_m = [FAR_M as f32];
        ground.lower_to_nearest(begin, slope, &mut nearest_m);
        let slack = Slack {
            clear_m: ground.clear_m(nearest_m[0]) - 0.02,
            edge_m: ground.edge_m(begin, slope) - 0.02,
        };
        for row in self.cost.iter_mut() {
            row.fill(f32::INFINITY);
        }
        self.cost[(begin_slope + STEEP) as usize][(begin_lane as i32 + SIDE) as usize] = 0.0;
        let mut reached = 0;
        for station in 1..=STATIONS {
            if !self.advance(ground, station, &lanes_m, &slack) {
                break;
            }
            reached = station;
        }
        self.trace(reached, &lanes_m, left_m)
    }

    /// Extends the search by one station; returns whether any state of it is reachable.
    fn advance(
        &mut self,
        ground: &Ground,
        station: usize,
        lanes_m: &Lanes<f64>,
        slack: &Slack,
    ) -> bool {
        let along_m = station as f64 * STATION_M;
        let last_m = ground.last.map(|path| path.at(along_m).0);
        let mut any = false;
        for steep in -STEEP..=STEEP {
            let slot = (steep + STEEP) as usize;
            let (least, slopes) = self.cheapest(steep);
            let (next, from) = (&mut self.next[slot], &mut self.from[station - 1][slot]);
            next.fill(f32::INFINITY);
            if least.iter().all(|&cost| cost == f32::INFINITY) {
                continue;
            }
            let here = ground.costs((along_m, lanes_m), steep, last_m, slack.at(station));
            // With this slope, lane `k` leads to lane `k + steep`.
            let (begin, end) = (steep.max(0) as usize, LANES - (-steep).max(0) as usize);
            let (left, right) = ((-steep).max(0) as usize, LANES - begin);
            for (next, (least, here)) in next[begin..end]
                .iter_mut()
                .zip(least[left..right].iter().zip(&here[begin..end]))
            {
                *next = least + here;
            }
            from[begin..end].copy_from_slice(&slopes[left..right]);
            any |= next.iter().any(|&cost| cost < f32::INFINITY);
        }
        if any {
            std::mem::swap(&mut self.cost, &mut self.next);
        }
        any
    }

    /// The cheapest way to be in each lane and to go on from it with a slope, and the slope of
    /// that way.
    fn cheapest(&self, steep: i32) -> (Lanes<f32>, Lanes<i8>) {
        let (low, high) = ((steep - CHANGE).max(-STEEP), (steep + CHANGE).min(STEEP));
        let (mut least, mut slopes) = ([f32::INFINITY; LANES], [0_i32; LANES]);
        for before in low..=high {
            let change = (steep - before) as f32;
            let bend = BEND * change * change;
            let row = &self.cost[(before + STEEP) as usize];
            for (cost, (least, slope)) in row.iter().zip(least.iter_mut().zip(&mut slopes)) {
                let cost = cost + bend;
                let is_less = cost < *least;
                *least = if is_less { cost } else { *least };
                *slope = if is_less { before } else { *slope };
            }
        }
        (least, slopes.map(|slope| slope as i8))
    }

    fn trace(&self, reached: usize, lanes_m: &Lanes<f64>, begin_left_m: f64) -> Path {
        let mut best = (f32::INFINITY, 0, 0);
        for lane in 0..LANES {
            for (slope, row) in self.cost.iter().enumerate() {
                if row[lane] < best.0 {
                    best = (row[lane], lane as i32, slope as i32 - STEEP);
                }
            }
        }
        let (_, mut lane, mut steep) = best;
        let mut left_m = [begin_left_m; STATIONS + 1];
        for station in (1..=reached).rev() {
            left_m[station] = lanes_m[lane as usize];
            let before = self.from[station - 1][(steep + STEEP) as usize][lane as usize];
            lane -= steep;
            steep = i32::from(before);
        }
        Path {
            left_m: left_m.iter().copied().take(reached + 1).collect(),
            is_blocked: reached < STATIONS,
        }
    }
}

/// The first stations need no more clearance than the car has now.
struct Slack {
    clear_m: f64,
    edge_m: f64,
}

impl Slack {
    fn at(&self, station: usize) -> (f64, f64) {
        match station <= 2 {
            true => (self.clear_m, self.edge_m),
            false => (f64::INFINITY, f64::INFINITY),
        }
    }
}

impl Ground<'_> {
    /// Lowers each number to the distance between the nearest obstacle and the middles of the
    /// car's discs, m, for places beside each other: the first one, and each by [`ACROSS_M`] to
    /// the left of the one before.
    fn lower_to_nearest(&self, first: Place, slope: f64, nearest_m: &mut [f32]) {
        let ahead = 1.0 / slope.hypot(1.0);
        for offset_m in self.body.offsets_m {
            let first = Place {
                along_m: first.along_m + offset_m * ahead,
                left_m: first.left_m + offset_m * ahead * slope,
            };
            self.field.lower_to_clearance(first, nearest_m);
        }
    }

    /// Clearance of the car's discs, m; negative inside an obstacle.
    fn clear_m(&self, nearest_m: f32) -> f64 {
        f64::from(nearest_m) - self.body.radius_m
    }

    /// Distance from the car's corners to the nearer edge of the road, m.
    fn edge_m(&self, place: Place, slope: f64) -> f64 {
        let reach_m = self.body.half_width_m + self.body.half_length_m * slope.abs();
        self.line.half_width_m(place.along_m) - place.left_m.abs() - reach_m
    }

    /// The cost of a place in each lane; infinite where it is not free.
    fn costs(
        &self,
        (along_m, lanes_m): (f64, &Lanes<f64>),
        steep: i32,
        last_m: Option<f64>,
        (clear_slack_m, edge_slack_m): (f64, f64),
    ) -> Lanes<f32> {
        let slope = f64::from(steep) * ACROSS_M / STATION_M;
        let mut nearest_m = [FAR_M as f32; LANES];
        let first = Place {
            along_m,
            left_m: lanes_m[0],
        };
        self.lower_to_nearest(first, slope, &mut nearest_m);
        let halfway = Place {
            along_m: along_m - STATION_M / 2.0,
            left_m: first.left_m - slope * STATION_M / 2.0,
        };
        self.lower_to_nearest(halfway, slope, &mut nearest_m);
        let edge_least_m = edge_slack_m.min(0.0);
        let clear_least_m = clear_slack_m.min(self.config.contact_m);
        let tight = |room_m: f64, wanted_m: f64| {
            let missing = (1.0 - room_m / wanted_m).max(0.0) as f32;
            TIGHT * missing * missing
        };
        let wanted_m = self.config.clearance_m.max(1e-3);
        array::from_fn(|lane| {
            let left_m = lanes_m[lane];
            let edge_m = self.edge_m(Place { along_m, left_m }, slope) + BEYOND_M;
            let clear_m = self.clear_m(nearest_m[lane]);
            let (left_m, slope) = (left_m as f32, slope as f32);
            let mut cost = MIDDLE * left_m * left_m + SLOPE * slope * slope;
            if let Some(last_m) = last_m {
                let off_m = (left_m - last_m as f32).clamp(-2.0, 2.0);
                cost += LAST * off_m * off_m;
            }
            cost = cost + tight(clear_m, wanted_m) + tight(edge_m, EDGE_M);
            match edge_m < edge_least_m || clear_m < clear_least_m {
                true => f32::INFINITY,
                false => cost,
            }
        })
    }
}

#[cfg(test)]
mod tests;
