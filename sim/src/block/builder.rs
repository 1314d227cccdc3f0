//! A block while its roads are built.

use std::f64::consts::PI;

use vehicle::{Point, Vector};

use super::BlockKind;
use super::overlap::{Overlap, contour};
use crate::lane::{ArcShape, Curve, Lane, LineColor, LineType, Turn, norm};
use crate::road::{Direction, NodeName};
use crate::surface::Bounds;

/// A road by the names of its nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct RoadName {
    pub from: NodeName,
    pub to: NodeName,
}

impl RoadName {
    /// The road of the opposite direction.
    pub fn opposite(self) -> RoadName {
        RoadName {
            from: self.to.opposite(),
            to: self.from.opposite(),
        }
    }
}

/// A road with its lanes, left to right.
#[derive(Clone, Debug)]
pub(crate) struct DraftRoad {
    pub name: RoadName,
    pub lanes: Vec<Lane>,
    /// The axis-aligned box that decides whether another road comes near.
    pub contour: Bounds,
}

/// A pair of roads to which the next block can be attached.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DraftSocket {
    /// Its number in the block; a T-intersection leaves a gap.
    pub number: u8,
    /// The road that leads out of the block.
    pub positive: RoadName,
}

/// The road to which a block is attached.
#[derive(Clone, Debug)]
pub(crate) struct Entry {
    pub positive: RoadName,
    pub lanes: Vec<Lane>,
}

/// A finished block.
#[derive(Clone, Debug, Default)]
pub(crate) struct Draft {
    pub roads: Vec<DraftRoad>,
    pub sockets: Vec<DraftSocket>,
    /// Roads on which traffic enters, in the order in which it is placed.
    pub traffic_entries: Vec<RoadName>,
    /// The ring of a roundabout, on which traffic is placed too.
    pub ring: Vec<RoadName>,
}

/// A bend, relative to the lane that it continues.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bend {
    pub radius_m: f64,
    pub angle_rad: f64,
    pub turn: Turn,
}

/// The side of the given lane on which the other lanes of its road lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Toward {
    Left,
    Right,
}

/// The lines of a road: in the middle of both directions, between its lanes,
/// and at its edge.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lines {
    pub center: LineType,
    pub inner: LineType,
    pub side: LineType,
}

impl Lines {
    pub const ROAD: Lines = Lines {
        center: LineType::Continuous,
        inner: LineType::Broken,
        side: LineType::Side,
    };
    pub const RAMP: Lines = Lines {
        side: LineType::Continuous,
        ..Lines::ROAD
    };
    pub const NONE: Lines = Lines {
        center: LineType::None,
        inner: LineType::None,
        side: LineType::None,
    };
    pub const EDGE_ONLY: Lines = Lines {
        side: LineType::Side,
        ..Lines::NONE
    };
}

/// Builds the roads of one block, and checks each against the earlier blocks.
pub(crate) struct Builder<'a> {
    pub index: u16,
    pub kind: BlockKind,
    pub entry: &'a Entry,
    pub around: &'a [&'a Draft],
    pub out: Draft,
}

impl<'a> Builder<'a> {
    pub fn new(
        (index, kind): (u16, BlockKind),
        entry: &'a Entry,
        around: &'a [&'a Draft],
    ) -> Builder<'a> {
        Builder {
            index,
            kind,
            entry,
            around,
            out: Draft::default(),
        }
    }

    pub fn finish(mut self) -> Draft {
        for road in &mut self.out.roads {
            road.contour = contour(&road.lanes);
        }
        self.out
    }

    /// The node of this block with that part and number.
    pub fn node(&self, part: u8, number: u8) -> NodeName {
        NodeName {
            direction: Direction::Outbound,
            block: self.index,
            kind: self.kind,
            part,
            number,
        }
    }

    /// Number of lanes of the road that the block continues.
    pub fn lane_count(&self) -> usize {
        self.entry.lanes.len()
    }

    /// The rightmost lane of the road that the block continues.
    pub fn basic_lane(&self) -> Lane {
        rightmost(&self.entry.lanes)
    }

    /// The lanes of a road of this block; empty if there is none.
    pub fn lanes(&mut self, name: RoadName) -> &mut [Lane] {
        match self.out.roads.iter_mut().find(|road| road.name == name) {
            Some(road) => &mut road.lanes,
            None => &mut [],
        }
    }

    /// The rightmost lane of a road of this block.
    pub fn rightmost(&mut self, name: RoadName) -> Lane {
        rightmost(self.lanes(name))
    }

    /// Sets the lines of the rightmost lane of a road.
    pub fn set_right_lines(&mut self, name: RoadName, lines: [LineType; 2]) {
        if let Some(lane) = self.lanes(name).last_mut() {
            lane.lines = lines;
        }
    }

    /// Adds a lane at the right of a road, which begins with its first lane.
    pub fn add_lane(&mut self, name: RoadName, lane: Lane) {
        match self.out.roads.iter_mut().find(|road| road.name == name) {
            Some(road) => road.lanes.push(lane),
            None => self.out.roads.push(DraftRoad {
                name,
                lanes: vec![lane],
                contour: Bounds::EMPTY,
            }),
        }
    }

    /// Adds a socket that ends with this road.
    pub fn add_socket(&mut self, positive: RoadName) {
        let number = self.out.sockets.len() as u8;
        self.out.sockets.push(DraftSocket { number, positive });
    }

    /// Builds a road with this rightmost lane, and checks that its sidewalk overlaps no
    /// earlier road.
    pub fn place(&mut self, lane: Lane, count: usize, name: RoadName, lines: Lines) -> Built {
        self.lay(lane, count, (name, Toward::Left), lines)?;
        // Just outside the sidewalk: half a lane, 0.6 m to the line, 2 m.
        let outside = (2.0 + 0.6 + lane.width_m / 2.0) * 2.0 / lane.width_m;
        self.check(&lane, outside)
    }

    /// Builds the road opposite to one of this block.
    pub fn place_opposite(&mut self, name: RoadName, lines: Lines) -> Built {
        let count = self.lanes(name).len();
        let lane = opposite_rightmost(&self.rightmost(name), count)?;
        self.place(lane, count, name.opposite(), lines)?;
        if let Some(leftmost) = self.lanes(name).first_mut() {
            leftmost.left_color = LineColor::Yellow;
        }
        Ok(())
    }

    /// Builds a road from one lane towards a side, without a check.
    pub fn lay(
        &mut self,
        lane: Lane,
        count: usize,
        (name, toward): (RoadName, Toward),
        lines: Lines,
    ) -> Built {
        let mut lanes = vec![lane];
        for left in (1..count).rev() {
            let mut beside = shifted(&lanes[lanes.len() - 1], toward)?;
            beside.lines = match (left, toward) {
                (1, Toward::Left) => [lines.center, lines.inner],
                (1, Toward::Right) => [lines.inner, lines.side],
                _ => [lines.inner, lines.inner],
            };
            lanes.push(beside);
        }
        match toward {
            Toward::Left if count > 1 => lanes[0].lines = [lines.inner, lines.side],
            Toward::Right if count > 1 => lanes[0].lines[1] = lines.inner,
            _ => lanes[0].lines = [lines.center, lines.side],
        }
        if toward == Toward::Left {
            lanes.reverse();
        }
        lanes[0].left_color = LineColor::Yellow;
        for lane in lanes {
            self.add_lane(name, lane);
        }
        Ok(())
    }

    /// Refuses a lane that would overlap an earlier block. `offset` is in half widths,
    /// positive to the right.
    pub fn check(&self, lane: &Lane, offset: f64) -> Built {
        super::overlap::check(self.around, lane, offset)
    }
}

/// The result of building roads.
pub(crate) type Built = Result<(), Overlap>;

/// The rightmost of these lanes. Roads are never empty; for an empty one the result is
/// a lane of length zero, to which nothing can be attached.
pub(crate) fn rightmost(lanes: &[Lane]) -> Lane {
    lanes.last().copied().unwrap_or(Lane::straight(
        Point::origin(),
        Point::origin() + Vector::x(),
        0.0,
    ))
}

/// A straight lane that continues another.
pub(crate) fn extended(lane: &Lane, length_m: f64, lines: [LineType; 2]) -> Lane {
    let end_world = lane.position(lane.length_m + length_m, 0.0);
    let mut next = Lane::straight(lane.end_world, end_world, lane.width_m);
    next.lines = lines;
    next.left_color = lane.left_color;
    next
}

/// A bend that continues a lane, and the straight lane after it.
pub(crate) fn bend_and_straight(lane: &Lane, bend: Bend, straight_m: f64) -> (Lane, Lane) {
    let Bend {
        radius_m,
        angle_rad,
        turn,
    } = bend;
    let center_world = lane.position(lane.length_m, -turn.sign() * radius_m);
    let forward = lane.forward_at(lane.length_m);
    let half_turn_rad = match turn {
        Turn::Left => 0.0,
        Turn::Right => PI,
    };
    let start_phase_rad = (-forward.x).atan2(forward.y) + half_turn_rad;
    let arc = Lane::arc(
        ArcShape {
            center_world,
            radius_m,
            start_phase_rad,
            angle_rad,
            turn,
        },
        lane.width_m,
    );
    let from_world = arc.position(radius_m * angle_rad, 0.0);
    let spoke = from_world - center_world;
    let along = turn.sign() * Vector::new(-spoke.y, spoke.x) / norm(spoke);
    let straight = Lane::straight(from_world, from_world + straight_m * along, lane.width_m);
    (arc, straight)
}

/// The neighbour of a lane on one side.
fn shifted(lane: &Lane, toward: Toward) -> Result<Lane, Overlap> {
    let to_right_m = match toward {
        Toward::Left => -lane.width_m,
        Toward::Right => lane.width_m,
    };
    match &lane.curve {
        Curve::Straight(_) | Curve::Taper(_) => Ok(Lane {
            start_world: lane.position(0.0, to_right_m),
            end_world: lane.position(lane.length_m, to_right_m),
            ..*lane
        }),
        Curve::Arc(arc) => {
            let moved = ArcShape {
                radius_m: arc.radius_m + arc.turn.sign() * to_right_m,
                ..arc.shape()
            };
            let mut beside = arc_lane(moved, lane.width_m)?;
            beside.left_color = lane.left_color;
            Ok(beside)
        }
    }
}

/// The rightmost lane of the opposite direction, for a road of `count` lanes
/// with this rightmost lane.
fn opposite_rightmost(lane: &Lane, count: usize) -> Result<Lane, Overlap> {
    let across_m = (2 * count - 1) as f64 * lane.width_m;
    let mut opposite = match &lane.curve {
        Curve::Straight(_) | Curve::Taper(_) => Lane::straight(
            lane.position(lane.length_m, -across_m),
            lane.position(0.0, -across_m),
            lane.width_m,
        ),
        Curve::Arc(arc) => {
            let reversed = ArcShape {
                radius_m: arc.radius_m - arc.turn.sign() * across_m,
                start_phase_rad: arc.end_phase_rad(),
                turn: arc.turn.opposite(),
                ..arc.shape()
            };
            arc_lane(reversed, lane.width_m)?
        }
    };
    opposite.lines = lane.lines;
    Ok(opposite)
}

/// A lane wider than its circle has no inner edge: it cannot be built and counts as an
/// overlap.
fn arc_lane(shape: ArcShape, width_m: f64) -> Result<Lane, Overlap> {
    if shape.radius_m <= width_m / 2.0 {
        return Err(Overlap);
    }
    Ok(Lane::arc(shape, width_m))
}
