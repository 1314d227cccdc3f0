//! All bodies of an episode, and what happens to them in a tick.

use vehicle::{Action, Footprint, Point, Vector};

use crate::contact::{Placed, Shape, collide, overlap};
use crate::dynamics::{Car, Controls, GRAVITY_MPS2, Motion, SUBSTEP_S, SUBSTEPS};
use crate::lidar::BEAM_HEIGHT_M;
use crate::model::VehicleKind;
use crate::road::LaneId;
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

/// A car that may move.
#[derive(Clone, Debug)]
pub struct Mover {
    /// What kind of car it is.
    pub kind: VehicleKind,
    /// Its measures and engine.
    pub car: Car,
    /// Where it is.
    pub motion: Motion,
    /// Whether it is part of the world; cars that leave the road are removed.
    pub present: bool,
    /// Whether it moves; a parked car stays at rest until it is hit or drives off.
    pub awake: bool,
    controls: Controls,
}

impl Mover {
    /// A car at a place.
    pub fn new(kind: VehicleKind, car: Car, motion: Motion) -> Mover {
        Mover {
            kind,
            car,
            motion,
            present: true,
            awake: false,
            controls: Controls::default(),
        }
    }

    /// Its rectangle for contacts and beams.
    pub fn placed(&self) -> Placed {
        Placed::car(&self.car, &self.motion)
    }

    /// Sets its action from the next sub-step on.
    pub fn command(&mut self, action: Action) {
        self.awake = true;
        self.controls = self.car.controls(&self.motion, action);
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
    /// The fixtures.
    pub fixtures: Vec<Fixture>,
    /// Pairs that may meet in this tick: a mover with a mover or a fixture. Indices are
    /// short because memory is reserved for all pairs; 65,535 cars would need 600 km of
    /// lanes.
    pairs: Vec<(u16, Other)>,
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
    /// Reserves memory for all pairs, so that no tick allocates: in the worst pile-up
    /// every car meets every other body.
    pub fn reserve(&mut self) {
        let (movers, fixtures) = (self.movers.len(), self.fixtures.len());
        let most = movers * movers.saturating_sub(1) / 2 + movers * fixtures;
        self.pairs.clear();
        self.pairs.reserve_exact(most);
    }

    /// Moves all bodies by one sub-step and adds to `touch` what the ego touched.
    /// [`Bodies::find_pairs`] must have been called for the tick.
    pub fn substep(&mut self, touch: &mut Touch) {
        for mover in self.movers.iter_mut().filter(|mover| mover.awake) {
            mover.car.substep(&mut mover.motion, &mover.controls);
        }
        for k in 0..self.pairs.len() {
            let (first, other) = self.pairs[k];
            let touched = self.meet(first, other) && first == 0;
            match other {
                Other::Mover(_) => touch.vehicle |= touched,
                Other::Fixture(_) => touch.object |= touched,
            }
        }
    }

    /// Lists the pairs that may meet within a tick that begins now.
    pub fn find_pairs(&mut self) {
        self.pairs.clear();
        let Bodies {
            movers,
            fixtures,
            pairs,
        } = self;
        for (i, first) in movers.iter().enumerate() {
            if !first.present {
                continue;
            }
            let (center, reach_m) = reach(first);
            for (j, second) in movers.iter().enumerate().skip(i + 1) {
                if !second.present || !(first.awake || second.awake) {
                    continue;
                }
                let (other_center, other_reach_m) = reach(second);
                if within(center - other_center, reach_m + other_reach_m) {
                    pairs.push((i as u16, Other::Mover(j as u16)));
                }
            }
            if !first.awake {
                continue;
            }
            for (j, fixture) in fixtures.iter().enumerate() {
                let away = center - fixture.placed.center_world;
                if within(away, reach_m + fixture.placed.shape.radius_m()) {
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
                (a.awake, b.awake) = (true, true);
                collide((&a.car, &mut a.motion), (&b.car, &mut b.motion), &found);
                true
            }
            Other::Fixture(fixture) => {
                let car = self.movers[first].placed();
                overlap(&car, &self.fixtures[usize::from(fixture)].placed).is_some()
            }
        }
    }
}

/// Centre of a car, and the radius around it within which it can touch something in a
/// tick, m.
fn reach(mover: &Mover) -> (Point, f64) {
    let model = mover.car.model;
    let radius_m = model.length_m.hypot(model.width_m) / 2.0;
    let drive_m = if mover.awake {
        mover.motion.speed_mps() * 0.1 + SLACK_M
    } else {
        0.0
    };
    (mover.motion.body_position(), radius_m + drive_m)
}

fn within(away: Vector, reach_m: f64) -> bool {
    away.norm_squared() < reach_m * reach_m
}
