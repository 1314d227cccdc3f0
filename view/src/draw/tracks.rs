//! Associates bodies between consecutive ticks.

use sim::world::{Body, BodyKind};
use vehicle::Point;

/// Maximum distance that a car moves in a tick: 40 m/s.
const STEP_MAX_M: f64 = 4.0;
/// A car that has moved less than this is standing, m.
const STOOD_M: f64 = 0.5;

/// The track of one car.
#[derive(Clone, Debug)]
pub struct Track {
    kind: BodyKind,
    /// Its positions, tick by tick.
    pub positions_world: Vec<Point>,
    present: bool,
}

impl Track {
    /// Whether the car has moved.
    pub fn has_moved(&self) -> bool {
        match (self.positions_world.first(), self.positions_world.last()) {
            (Some(first), Some(last)) => (last - first).norm() > STOOD_M,
            _ => false,
        }
    }
}

/// The tracks of all cars of an episode. The world lists its bodies in a fixed order; those
/// that leave the road disappear from it permanently.
#[derive(Clone, Debug, Default)]
pub struct Tracks {
    tracks: Vec<Track>,
}

impl Tracks {
    /// Adds the bodies of a tick.
    pub fn follow(&mut self, bodies: impl Iterator<Item = Body>) {
        let cars = bodies.filter(|body| is_car(body.kind));
        if self.tracks.is_empty() {
            self.tracks.extend(cars.map(|body| Track {
                kind: body.kind,
                positions_world: vec![body.placed.center_world],
                present: true,
            }));
            return;
        }
        let mut waiting = self.tracks.iter_mut().filter(|track| track.present);
        for body in cars {
            let at = body.placed.center_world;
            for track in waiting.by_ref() {
                let last = track.positions_world.last();
                let near = last.is_some_and(|last| (at - last).norm() < STEP_MAX_M);
                if track.kind == body.kind && near {
                    track.positions_world.push(at);
                    break;
                }
                track.present = false;
            }
        }
        for track in waiting {
            track.present = false;
        }
    }

    /// The tracks of all cars.
    pub fn all(&self) -> &[Track] {
        &self.tracks
    }
}

fn is_car(kind: BodyKind) -> bool {
    match kind {
        BodyKind::Traffic(_) => true,
        BodyKind::Obstacle(kind) => matches!(kind, sim::spawn::ObstacleKind::BrokenDown(_)),
    }
}
