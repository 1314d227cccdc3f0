#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::{Point, Pose, Vector, Vehicle};

use crate::dubins::{Dubins, Piece, Turn};
use crate::grid::Grid;

/// Discs that stand for the body.
pub(crate) const DISCS: usize = 3;

/// The front and the middle of the car as discs in a row.
///
/// The grid is inflated by their radius and asked at their middles. One disc
/// around the whole car (2.4 m) would not fit beside a parked car; one of half
/// the width lets the corners of the front touch. The rear follows where the
/// rest has been, but for a few centimetres at the beginning of a turn, and the
/// grid does not reach behind the car; so it has no disc.
///
/// Each disc is asked exactly, without sampling: on an arc, its middle moves on
/// an arc around the same point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Body {
    /// Where the middles are, m ahead of the car's.
    pub(crate) ahead_m: [f64; DISCS],
    /// What the discs reach, m.
    pub(crate) radius_m: f64,
}

impl Body {
    /// Discs that cover the rectangle from half a disc behind the middle to the
    /// front bumper.
    pub(crate) fn new(vehicle: &Vehicle) -> Self {
        let apart_m = vehicle.length_m / (2 * DISCS - 1) as f64;
        Self {
            ahead_m: core::array::from_fn(|disc| disc as f64 * apart_m),
            radius_m: (apart_m / 2.0).hypot(vehicle.width_m / 2.0),
        }
    }

    /// Whether the car can stand there.
    pub(crate) fn is_free_at(&self, grid: &Grid, at: &Pose) -> bool {
        self.ahead_m.iter().all(|&ahead_m| {
            let cell = grid.cell_at(at * Point::new(ahead_m, 0.0));
            cell.is_some_and(|cell| !grid.is_occupied(cell))
        })
    }

    /// Whether the car can drive a curve.
    pub(crate) fn is_free_along(&self, grid: &Grid, from: &Pose, curve: &Dubins) -> bool {
        let pieces = || curve.walk(from).filter(|(_, piece)| piece.length_m > 0.0);
        // Most blocked curves are blocked at the beginning or in the middle of a piece,
        // which are cheap to test first.
        let stands_free = |(begin, piece): (Pose, Piece)| {
            let middle = begin * curve.moved(piece.turn, piece.length_m / 2.0);
            self.is_free_at(grid, &middle) && self.is_free_at(grid, &begin)
        };
        pieces().all(stands_free)
            && pieces().all(|(begin, piece)| match piece.turn {
                Turn::Straight => self.ahead_m.iter().all(|&ahead_m| {
                    let disc = |moved_m: f64| begin * Point::new(ahead_m + moved_m, 0.0);
                    grid.is_segment_free(disc(0.0), disc(piece.length_m))
                }),
                Turn::Left | Turn::Right => {
                    let side_m = piece.turn.sign() * curve.radius_m;
                    let centre = begin * Point::from(Vector::new(0.0, side_m));
                    let turn_rad = piece.length_m / side_m;
                    self.ahead_m.iter().all(|&ahead_m| {
                        grid.is_arc_free(centre, begin * Point::new(ahead_m, 0.0), turn_rad)
                    })
                }
            })
    }
}
