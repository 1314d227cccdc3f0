//! What ends an episode: arriving, leaving the road, or the horizon.
//! Contacts do not.
//!
//! Out of road means: no lane under the car's centre, or the car's box on a
//! sidewalk, or the centre beyond the edges of the current road of the route.
//! Sources: `envs/metadrive_env.py`, PVP4Real's environment, and
//! `pgblock/pg_block.py` for the sidewalks.

use vehicle::Point;

use crate::contact::Placed;
use crate::lane::{Lane, LineType};
use crate::navigation::Navigator;
use crate::nearby::Nearby;
use crate::road::Network;
use crate::surface::Bounds;

/// How far before and beyond the end of the route a car counts as arrived, m.
const ARRIVAL_M: f64 = 5.0;
/// Gap between a lane's edge and the sidewalk, its width, and the distance of
/// its corners along the lane, m.
const SIDEWALK_GAP_M: f64 = 0.2;
const SIDEWALK_WIDTH_M: f64 = 2.0;
const SIDEWALK_STEP_M: f64 = 3.0;
/// Pieces of a strip: two lines of boxes, so that a car beside a strip reads few.
const STRIP_PIECES: usize = 4;
/// A sidewalk ends this far beyond its lane, m.
const SIDEWALK_OVERHANG_M: f64 = 0.1;

/// Where a car is between the edges of its road.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edges {
    /// Distance to the left edge, m; negative beyond it.
    pub left_m: f64,
    /// Distance to the right edge, m; negative beyond it.
    pub right_m: f64,
}

impl Edges {
    /// Between the edges of the navigator's current road. Widths are those of
    /// the lane the car is on, as the simulator reckons.
    pub fn of(network: &Network, navigator: &Navigator, position_world: Point) -> Edges {
        let road = network.road(navigator.road());
        let width_m = network.lane(navigator.lane()).width_m;
        let (_, lateral_m) = navigator.coordinates(network, road.first_lane, position_world);
        let left_m = lateral_m + width_m / 2.0;
        Edges {
            left_m,
            right_m: width_m * f64::from(road.lane_count) - left_m,
        }
    }

    /// Whether the centre is beyond an edge.
    pub fn is_outside(&self) -> bool {
        self.left_m < 0.0 || self.right_m < 0.0
    }
}

/// Whether the car is at the end of its route.
pub fn has_arrived(network: &Network, navigator: &Navigator, position_world: Point) -> bool {
    let last = network.lane(network.road(navigator.final_road()).last_lane());
    let (longitudinal_m, lateral_m) = last.local_coordinates(position_world);
    let width_m = network.lane(navigator.lane()).width_m;
    let count = f64::from(network.road(navigator.road()).lane_count);
    (longitudinal_m - last.length_m).abs() < ARRIVAL_M
        && lateral_m <= width_m / 2.0
        && lateral_m >= (0.5 - count) * width_m
}

/// The sidewalks of a map, as chains of quadrilaterals.
#[derive(Clone, Debug, Default)]
pub struct Sidewalks {
    /// The box around each strip: [`STRIP_PIECES`] neighbouring pieces, or the fewer at
    /// the end of a chain.
    strips: Vec<Bounds>,
    /// The first piece of each strip, and where the last one ends.
    begins: Vec<u32>,
    /// The box around each piece, and its corners.
    pieces: Vec<Bounds>,
    corners_world: Vec<[Point; 4]>,
}

/// Where a car was when its box met no sidewalk's.
#[derive(Clone, Debug, Default)]
#[repr(C)]
pub(crate) struct Beside {
    /// No piece's box meets a box in here.
    clear: Option<Bounds>,
    /// The strips around it.
    nearby: Nearby,
}

impl Sidewalks {
    /// Lays the sidewalks of a map, reusing what is allocated.
    pub fn lay(&mut self, network: &Network) {
        self.strips.clear();
        self.begins.clear();
        self.pieces.clear();
        self.corners_world.clear();
        for road in network.roads() {
            let first = road.first_lane.index();
            let lanes = &network.lanes()[first..first + usize::from(road.lane_count)];
            for (index, lane) in lanes.iter().enumerate() {
                // Lines on the right are only made for a road's last lane. A
                // sidewalk is on the right even when the left line asks for it.
                let last = index + 1 == lanes.len();
                if lane.lines[0] == LineType::Side || (last && lane.lines[1] == LineType::Side) {
                    self.lay_along(lane);
                }
            }
        }
        self.begins.push(self.pieces.len() as u32);
    }

    fn lay_along(&mut self, lane: &Lane) {
        let near_m = lane.width_m / 2.0 + SIDEWALK_GAP_M;
        let far_m = near_m + SIDEWALK_WIDTH_M;
        if lane
            .bend_radius()
            .is_some_and(|(radius_m, _)| far_m > radius_m)
        {
            return;
        }
        let across = |longitudinal_m: f64| {
            let end_m = longitudinal_m.min(lane.length_m + SIDEWALK_OVERHANG_M);
            [lane.position(end_m, near_m), lane.position(end_m, far_m)]
        };
        let steps = ((lane.length_m + SIDEWALK_STEP_M) / SIDEWALK_STEP_M).ceil() as usize;
        let mut behind = across(0.0);
        for step in 1..steps {
            let ahead = across(step as f64 * SIDEWALK_STEP_M);
            self.push(
                [behind[0], behind[1], ahead[1], ahead[0]],
                (step - 1) % STRIP_PIECES,
            );
            behind = ahead;
        }
    }

    /// Adds a piece, at a place in its strip.
    fn push(&mut self, corners_world: [Point; 4], place: usize) {
        if place == 0 {
            self.begins.push(self.pieces.len() as u32);
            self.strips.push(Bounds::EMPTY);
        }
        let bounds = Bounds::around(&corners_world);
        if let Some(strip) = self.strips.last_mut() {
            strip.include(bounds.min_world);
            strip.include(bounds.max_world);
        }
        self.pieces.push(bounds);
        self.corners_world.push(corners_world);
    }

    /// Whether a car stands on a sidewalk.
    pub fn touch(&self, car: &Placed) -> bool {
        self.touch_near(car, &mut Beside::default())
    }

    /// The same, with what is known from the tick before.
    pub(crate) fn touch_near(&self, car: &Placed, beside: &mut Beside) -> bool {
        let corners = car.corners_world();
        let around = Bounds::around(&corners);
        if beside.clear.is_some_and(|clear| clear.encloses(&around)) {
            return false;
        }
        beside.clear = None;
        let Some((strips, listed)) = beside.nearby.find(&around, self.strips.iter()) else {
            let mut near =
                (0..self.pieces.len()).filter(|&piece| self.pieces[piece].overlaps(&around));
            return near.any(|piece| convex_overlap(&corners, &self.corners_world[piece]));
        };
        let kept = (around.min_world, around.max_world);
        let mut is_clear = true;
        let mut on_sidewalk = false;
        let mut cut = Bounds::EVERYWHERE;
        for &strip in strips {
            let strip = usize::from(strip);
            let bounds = &self.strips[strip];
            if !bounds.overlaps(&around) {
                cut.keep_off(kept, (bounds.min_world, bounds.max_world));
                continue;
            }
            for piece in self.begins[strip] as usize..self.begins[strip + 1] as usize {
                let bounds = &self.pieces[piece];
                if bounds.overlaps(&around) {
                    is_clear = false;
                    on_sidewalk |= convex_overlap(&corners, &self.corners_world[piece]);
                } else {
                    cut.keep_off(kept, (bounds.min_world, bounds.max_world));
                }
            }
        }
        if is_clear {
            beside.clear = Some(cut.within(&listed));
        }
        on_sidewalk
    }

    /// The corners of every piece, for drawings.
    pub fn pieces(&self) -> impl Iterator<Item = &[Point; 4]> {
        self.corners_world.iter()
    }
}

/// Whether two convex polygons overlap, by their sides as separating axes.
fn convex_overlap(a: &[Point; 4], b: &[Point; 4]) -> bool {
    let separates = |from: &[Point; 4], other: &[Point; 4]| {
        (0..4).any(|k| {
            let along = from[(k + 1) % 4] - from[k];
            let inside = along.perp(&(from[(k + 2) % 4] - from[k])).signum();
            other
                .iter()
                .all(|corner| along.perp(&(corner - from[k])) * inside < 0.0)
        })
    };
    !separates(a, b) && !separates(b, a)
}
