//! All bodies of an episode, and what happens to them in a tick.

use vehicle::{Action, Footprint, Point, Vector};

use crate::contact::{Placed, Shape, collide, overlap};
use crate::dynamics::{Car, Controls, GRAVITY_MPS2, GROUP, Group, Motion, SUBSTEP_S, SUBSTEPS};
use crate::lidar::BEAM_HEIGHT_M;
use crate::model::VehicleKind;
use crate::prefetch;
use crate::road::LaneId;
use crate::simd::Width;
use crate::spawn::{Obstacle, ObstacleKind};

/// Length and width of a barrier, m; its long side lies across the lane.
const BARRIER: Footprint = Footprint {
    length_m: 0.3,
    width_m: 2.0,
};
/// Radii of a cone and of a warning triangle, m.
const CONE_M: f64 = 0.2;
const WARNING_M: f64 = 0.5;
/// A pair of bodies is checked in a tick if they could meet within it: no body moves
/// faster than its present speed plus this slack, m.
const SLACK_M: f64 = 0.5;

/// A car that may move, on cache lines of its own.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub struct Mover {
    /// What kind of car it is.
    pub kind: VehicleKind,
    /// Its measures and engine.
    pub car: Car,
    /// Where it is.
    pub motion: Motion,
    controls: Controls,
}

/// What is asked of every car in every tick, apart from the rest: most cars are parked,
/// and their motion is not even read.
#[derive(Clone, Copy, Debug)]
pub struct Spot {
    /// Whether it is part of the world; cars that leave the road are removed.
    pub present: bool,
    /// Whether it moves; a parked car stays at rest until it is hit or drives off.
    pub awake: bool,
    /// Centre of its body.
    pub center_world: Point,
    /// Radius of the circle around its body, m.
    pub radius_m: f64,
    /// Speed over the ground, m/s.
    speed_mps: f64,
}

impl Mover {
    /// A car at a place.
    pub fn new(kind: VehicleKind, car: Car, motion: Motion) -> Mover {
        Mover {
            kind,
            car,
            motion,
            controls: Controls::default(),
        }
    }

    /// Its rectangle for contacts and beams.
    pub fn placed(&self) -> Placed {
        Placed::car(&self.car, &self.motion)
    }

    /// Whether the beams can hit its body, whose floor is `floor_m` above the ground.
    pub(crate) fn is_at_beam_height(&self, floor_m: f64) -> bool {
        (floor_m..=floor_m + self.car.model.height_m).contains(&BEAM_HEIGHT_M)
    }
}

/// Height of a car's floor after falling freely for some ticks, m.
pub(crate) fn floor_after_drop_m(from_m: f64, ticks: u64) -> f64 {
    // A longer fall ends on the springs; the limit of 100 keeps the product finite.
    let substeps = (ticks.min(100) * u64::from(SUBSTEPS)) as f64;
    from_m - GRAVITY_MPS2 * SUBSTEP_S * SUBSTEP_S * substeps * (substeps + 1.0) / 2.0
}

/// An object that never moves and that cars pass through.
#[derive(Clone, Copy, Debug)]
pub struct Fixture {
    /// What it is.
    pub kind: ObstacleKind,
    /// Its lane.
    pub lane: LaneId,
    /// Where it stands.
    pub placed: Placed,
    /// Radius of the circle around its shape, m.
    pub(crate) radius_m: f64,
}

impl Fixture {
    /// The fixture of an obstacle; `None` for a broken-down car, which moves
    /// when it is hit.
    pub fn new(obstacle: &Obstacle) -> Option<Fixture> {
        let shape = match obstacle.kind {
            ObstacleKind::Cone => Shape::Disc { radius_m: CONE_M },
            ObstacleKind::Warning => Shape::Disc {
                radius_m: WARNING_M,
            },
            ObstacleKind::Barrier => Shape::Box(BARRIER),
            ObstacleKind::BrokenDown(_) => return None,
        };
        let (sin, cos) = obstacle.heading_rad.sin_cos();
        Some(Fixture {
            kind: obstacle.kind,
            lane: obstacle.lane,
            radius_m: shape.radius_m(),
            placed: Placed {
                shape,
                center_world: obstacle.position_world,
                forward_world: Vector::new(cos, sin),
            },
        })
    }
}

/// All bodies. The first mover is the ego.
#[derive(Clone, Debug, Default)]
pub struct Bodies {
    /// The cars.
    pub movers: Vec<Mover>,
    /// One for each car.
    pub spots: Vec<Spot>,
    /// The fixtures.
    pub fixtures: Vec<Fixture>,
    /// Pairs that may meet in this tick: a mover with a mover or a fixture. Indices are
    /// short because memory is reserved for all pairs; 65,535 cars would need 600 km of
    /// lanes.
    pairs: Vec<(u16, Other)>,
    /// The cars that are awake, in ascending order.
    awake: Vec<u16>,
    width: Width,
}

#[derive(Clone, Copy, Debug)]
enum Other {
    Mover(u16),
    Fixture(u16),
}

/// What the ego touched in a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Touch {
    /// A car, broken down or not.
    pub vehicle: bool,
    /// A cone, a warning triangle or a barrier.
    pub object: bool,
}

impl Bodies {
    /// Takes all bodies away.
    pub fn clear(&mut self) {
        self.movers.clear();
        self.spots.clear();
        self.fixtures.clear();
        self.awake.clear();
    }

    /// Adds a car, parked.
    pub fn push(&mut self, mover: Mover) {
        self.spots.push(Spot {
            present: true,
            awake: false,
            center_world: mover.motion.body_position(),
            radius_m: mover.car.radius_m(),
            speed_mps: mover.motion.speed_mps(),
        });
        self.movers.push(mover);
    }

    /// Sets the action of a car from the next sub-step on.
    pub fn command(&mut self, index: usize, action: Action) {
        self.wake(index);
        let mover = &mut self.movers[index];
        mover.controls = mover.car.controls(&mover.motion, action);
    }

    /// The cars that are awake, in ascending order.
    pub fn awake(&self) -> impl Iterator<Item = usize> {
        self.awake.iter().map(|&index| usize::from(index))
    }

    /// Asks for what a tick reads of all bodies.
    pub(crate) fn prefetch(&self) {
        prefetch::slice(&self.spots);
        prefetch::slice(&self.fixtures);
        prefetch::slice(&self.awake);
    }

    fn wake(&mut self, index: usize) {
        if !self.spots[index].awake {
            self.spots[index].awake = true;
            let place = self
                .awake
                .partition_point(|&other| usize::from(other) < index);
            self.awake.insert(place, index as u16);
        }
    }

    /// Takes a car away; it keeps its index.
    pub fn remove(&mut self, index: usize) {
        (self.spots[index].present, self.spots[index].awake) = (false, false);
        self.awake.retain(|&other| usize::from(other) != index);
    }

    /// Reserves memory for all pairs and for all cars awake, so that no tick allocates: in
    /// the worst pile-up every car meets every other body.
    pub fn reserve(&mut self) {
        let (movers, fixtures) = (self.movers.len(), self.fixtures.len());
        let most = movers * movers.saturating_sub(1) / 2 + movers * fixtures;
        self.pairs.clear();
        self.pairs.reserve_exact(most);
        self.awake
            .reserve_exact(movers.saturating_sub(self.awake.len()));
    }

    /// Moves all bodies by one sub-step for each entry of `headings_world`, which takes
    /// the ego's seen heading before it, and adds to `touch` what the ego touched.
    /// [`Bodies::find_pairs`] must have been called for the tick.
    pub fn advance(&mut self, headings_world: &mut [Vector], touch: &mut Touch) {
        if self.pairs.is_empty() {
            // No car depends on another before the next tick.
            self.drive(headings_world);
        } else {
            for heading_world in headings_world {
                self.drive(std::slice::from_mut(heading_world));
                self.meet_all(touch);
            }
        }
        for &index in &self.awake {
            let index = usize::from(index);
            let (spot, motion) = (&mut self.spots[index], &self.movers[index].motion);
            spot.center_world = motion.body_position();
            spot.speed_mps = motion.speed_mps();
        }
    }

    /// Moves the cars that are awake, several at once, without regard to each other.
    fn drive(&mut self, headings_world: &mut [Vector]) {
        let Bodies {
            movers,
            awake,
            width,
            ..
        } = self;
        let mut rest = &awake[..];
        if let Some(ego) = movers.first_mut() {
            headings_world.fill(ego.motion.seen_forward());
            if ego.car.is_bicycle() && rest.first() == Some(&0) {
                rest = &rest[1..];
                for heading_world in headings_world.iter_mut() {
                    *heading_world = ego.motion.seen_forward();
                    ego.car.substep(&mut ego.motion, &ego.controls);
                }
            }
        }
        let mut group = Group::default();
        for members in rest.chunks(GROUP) {
            group.clear();
            for &index in members {
                let mover = &movers[usize::from(index)];
                group.push(&mover.car, &mover.motion, &mover.controls);
            }
            for substep in 0..headings_world.len() {
                group.substep(*width);
                if members[0] == 0
                    && let Some(next) = headings_world.get_mut(substep + 1)
                {
                    *next = group.seen_direction(0).normalize();
                }
            }
            for (column, &index) in members.iter().enumerate() {
                movers[usize::from(index)].motion = group.motion(column);
            }
        }
    }

    /// Lets the pairs that overlap collide.
    fn meet_all(&mut self, touch: &mut Touch) {
        for k in 0..self.pairs.len() {
            let (first, other) = self.pairs[k];
            let touched = self.meet(first, other) && first == 0;
            match other {
                Other::Mover(_) => touch.vehicle |= touched,
                Other::Fixture(_) => touch.object |= touched,
            }
        }
    }

    /// Whether any car that is awake may meet anything within a tick that begins now. In
    /// most ticks none does, so this tests all bodies without a branch for each.
    fn may_meet(&self) -> bool {
        let mut meets = false;
        for &index in &self.awake {
            let own = &self.spots[usize::from(index)];
            let (center, reach_m) = (own.center_world, own.reach_m());
            for (other, spot) in self.spots.iter().enumerate() {
                let is_near = within(center - spot.center_world, reach_m + spot.reach_m());
                meets |= (other != usize::from(index)) & spot.present & is_near;
            }
            for fixture in &self.fixtures {
                let away = center - fixture.placed.center_world;
                meets |= within(away, reach_m + fixture.radius_m);
            }
        }
        meets
    }

    /// Lists the pairs that may meet within a tick that begins now.
    pub fn find_pairs(&mut self) {
        self.pairs.clear();
        if !self.may_meet() {
            return;
        }
        let Bodies {
            spots,
            fixtures,
            pairs,
            ..
        } = self;
        for (i, first) in spots.iter().enumerate() {
            if !first.present {
                continue;
            }
            let (center, reach_m) = (first.center_world, first.reach_m());
            for (j, second) in spots.iter().enumerate().skip(i + 1) {
                if !second.present || !(first.awake || second.awake) {
                    continue;
                }
                if within(center - second.center_world, reach_m + second.reach_m()) {
                    pairs.push((i as u16, Other::Mover(j as u16)));
                }
            }
            if !first.awake {
                continue;
            }
            for (j, fixture) in fixtures.iter().enumerate() {
                let away = center - fixture.placed.center_world;
                if within(away, reach_m + fixture.radius_m) {
                    pairs.push((i as u16, Other::Fixture(j as u16)));
                }
            }
        }
    }

    /// Whether the pair overlaps; if they are cars, they collide.
    fn meet(&mut self, first: u16, other: Other) -> bool {
        let first = usize::from(first);
        match other {
            Other::Mover(second) => {
                let pair = [first, usize::from(second)];
                let Ok([a, b]) = self.movers.get_disjoint_mut(pair) else {
                    return false;
                };
                let Some(found) = overlap(&a.placed(), &b.placed()) else {
                    return false;
                };
                collide((&a.car, &mut a.motion), (&b.car, &mut b.motion), &found);
                for index in pair {
                    self.wake(index);
                }
                true
            }
            Other::Fixture(fixture) => {
                let car = self.movers[first].placed();
                overlap(&car, &self.fixtures[usize::from(fixture)].placed).is_some()
            }
        }
    }
}

impl Spot {
    /// The radius around its centre within which it can touch something in a tick, m.
    fn reach_m(&self) -> f64 {
        let drive_m = self.speed_mps * 0.1 + SLACK_M;
        self.radius_m + if self.awake { drive_m } else { 0.0 }
    }
}

fn within(away: Vector, reach_m: f64) -> bool {
    away.norm_squared() < reach_m * reach_m
}
