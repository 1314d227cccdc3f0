use crate::mpc::body::Body;
use crate::mpc::line::{Line, Place};
use tracker::Sighting;
use vehicle::{Point, Sight};

/// Larger clearances count as this one, m.
pub(crate) const FAR_M: f64 = 2.5;
/// The field reaches from here, m along the road from the car.
const BEGIN_M: f64 = -4.0;
/// Sizes of a cell, m along and m across.
const ALONG_M: f64 = 0.5;
pub(crate) const ACROSS_M: f64 = 0.25;
const ROWS: usize = 88;
const COLUMNS: usize = 80;
/// The field reaches this far to either side, m.
const SIDE_M: f64 = ACROSS_M * COLUMNS as f64 / 2.0;
/// No place of the field is farther from the car, m, however the road bends.
const REACH_M: f64 = BEGIN_M + ROWS as f64 * ALONG_M + SIDE_M;
/// A body that shows a face this wide goes on behind it, m.
const FACE_M: f64 = 0.7;
/// How far it goes on, m: so that the way back into the lane is not planned
/// through the unseen part of a standing car.
const BEHIND_M: [f64; 2] = [1.5, 3.0];
/// Least speed for computing arrival times, m/s.
const ARRIVE_MPS: f64 = 3.0;
/// Longest horizon of a prediction, s.
const PREDICT_S: f64 = 3.0;

/// Distance to the nearest obstacle over the places of the road, m, at the time
/// that the car gets there.
#[derive(Debug)]
pub(crate) struct Field {
    clearance_m: Box<[f32]>,
}

impl Field {
    /// The only place that allocates.
    pub(crate) fn new() -> Self {
        Self {
            clearance_m: vec![FAR_M as f32; ROWS * COLUMNS].into_boxed_slice(),
        }
    }

    /// Forgets everything and marks what was sighted.
    ///
    /// What rests is marked where it is. What drives along the road is marked in
    /// each row where it will be when the car gets there at `speed_mps`. What
    /// crosses is not marked: the speed is chosen for it, not the path.
    pub(crate) fn fill(&mut self, line: &Line, sightings: &[Sighting], speed_mps: f64) {
        self.clearance_m.fill(FAR_M as f32);
        for sighting in sightings {
            let place = line.place(sighting.point_body);
            if !sighting.moves() {
                self.mark(place);
                if sighting.radius_m > FACE_M {
                    for behind_m in BEHIND_M {
                        let along_m = place.along_m + behind_m;
                        self.mark(Place { along_m, ..place });
                    }
                }
                continue;
            }
            let road_from_body = line.body_from_road(place.along_m).rotation.inverse();
            let velocity = road_from_body * sighting.velocity_body;
            if velocity.x > 2.0 * velocity.y.abs() {
                for row in 0..ROWS {
                    let row_m = BEGIN_M + (row as f64 + 0.5) * ALONG_M;
                    let arrive_s = (row_m / speed_mps.max(ARRIVE_MPS)).clamp(0.0, PREDICT_S);
                    let then = Place {
                        along_m: place.along_m + velocity.x * arrive_s,
                        left_m: place.left_m + velocity.y * arrive_s,
                    };
                    self.mark_row(row, then);
                }
            }
        }
    }

    /// Marks places of the body frame where something rests.
    pub(crate) fn mark_resting(&mut self, line: &Line, places_body: impl Iterator<Item = Point>) {
        for place_body in places_body {
            self.mark(line.place(place_body));
        }
    }

    /// Marks the places ahead of the front bumper at which no beam looks, or beside which
    /// the side of the body would be where none does: nothing says that they are free. What
    /// is beside the body was ahead of it before.
    pub(crate) fn mark_unseen(&mut self, line: &Line, sight: &Sight, body: &Body) {
        let width_m = 2.0 * body.half_width_m;
        let reach_m = sight.fan().mount_body.coords.norm() + REACH_M;
        if sight.covers_all(reach_m, width_m) {
            return;
        }
        for row in 0..ROWS {
            let along_m = BEGIN_M + (row as f64 + 0.5) * ALONG_M;
            if along_m <= body.half_length_m {
                continue;
            }
            let body_from_road = line.body_from_road(along_m);
            let is_seen =
                |left_m: f64| sight.covers(body_from_road * Point::new(0.0, left_m), width_m);
            for column in 0..COLUMNS {
                let left_m = (column as f64 + 0.5) * ACROSS_M - SIDE_M;
                let beside_m = body.half_width_m - ACROSS_M / 2.0;
                let is_free = [0.0, -beside_m, beside_m]
                    .iter()
                    .all(|across_m| is_seen(left_m + across_m));
                if !is_free {
                    self.clearance_m[row * COLUMNS + column] = 0.0;
                }
            }
        }
    }

    fn mark(&mut self, place: Place) {
        let row = |along_m: f64| (along_m - BEGIN_M) / ALONG_M;
        let first = row(place.along_m - FAR_M).max(0.0) as usize;
        let end = (row(place.along_m + FAR_M).max(0.0) as usize + 1).min(ROWS);
        for row in first..end {
            self.mark_row(row, place);
        }
    }

    fn mark_row(&mut self, row: usize, place: Place) {
        let along_m = BEGIN_M + (row as f64 + 0.5) * ALONG_M - place.along_m;
        if along_m.abs() >= FAR_M {
            return;
        }
        let column = |left_m: f64| (left_m + SIDE_M) / ACROSS_M;
        let first = column(place.left_m - FAR_M).max(0.0) as usize;
        let end = ((column(place.left_m + FAR_M).max(0.0)) as usize + 1).min(COLUMNS);
        let cells = &mut self.clearance_m[row * COLUMNS..][..COLUMNS];
        for (column, cell) in cells.iter_mut().enumerate().take(end).skip(first) {
            let left_m = (column as f64 + 0.5) * ACROSS_M - SIDE_M - place.left_m;
            // Not `hypot`, which takes one cell at a time.
            let away_m = (along_m * along_m + left_m * left_m).sqrt() as f32;
            *cell = if away_m < *cell { away_m } else { *cell };
        }
    }

    /// Lowers each number to the clearance, m, of places beside each other: the first one, and
    /// each by [`ACROSS_M`] to the left of the one before.
    pub(crate) fn lower_to_clearance(&self, first: Place, clearance_m: &mut [f32]) {
        let row = (first.along_m - BEGIN_M) / ALONG_M;
        if row < 0.0 || row >= ROWS as f64 {
            return;
        }
        let row = &self.clearance_m[row as usize * COLUMNS..][..COLUMNS];
        // Negative where the first places lie to the right of the field.
        let column = ((first.left_m + SIDE_M) / ACROSS_M).floor() as isize;
        let beside = column.saturating_neg().max(0) as usize;
        let from = column.max(0) as usize;
        let cells = row.get(from..).unwrap_or_default();
        let places = clearance_m.get_mut(beside..).unwrap_or_default();
        for (least, &cell) in places.iter_mut().zip(cells) {
            *least = if cell < *least { cell } else { *least };
        }
    }

    /// Distance from a place to the nearest obstacle, m, at most [`FAR_M`]; to
    /// half a cell.
    pub(crate) fn clearance_m(&self, place: Place) -> f64 {
        let row = (place.along_m - BEGIN_M) / ALONG_M;
        let column = (place.left_m + SIDE_M) / ACROSS_M;
        if row < 0.0 || column < 0.0 {
            return FAR_M;
        }
        let (row, column) = (row as usize, column as usize);
        if row >= ROWS || column >= COLUMNS {
            return FAR_M;
        }
        f64::from(self.clearance_m[row * COLUMNS + column])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places beside each other are read as each of them alone, on the field and beside it.
    #[test]
    fn a_row_of_places_has_the_clearance_of_each() {
        let mut field = Field::new();
        for (along_m, left_m) in [(3.1, -2.7), (12.0, 4.4), (39.9, 9.9), (-3.9, -9.9)] {
            field.mark(Place { along_m, left_m });
        }
        let (mut near, mut far) = (0, 0);
        for along in -14..=100 {
            for left in -130..=130 {
                let (along_m, first_m) = (f64::from(along) * 0.43, f64::from(left) * 0.117);
                let mut row_m = [FAR_M as f32; 65];
                let first = Place {
                    along_m,
                    left_m: first_m,
                };
                field.lower_to_clearance(first, &mut row_m);
                for (place, &clearance_m) in row_m.iter().enumerate() {
                    let left_m = first_m + place as f64 * ACROSS_M;
                    let alone_m = field.clearance_m(Place { along_m, left_m });
                    assert_eq!(f64::from(clearance_m), alone_m, "{along_m} {left_m}");
                    near += u32::from(alone_m < FAR_M);
                    far += u32::from(alone_m == FAR_M);
                }
            }
        }
        assert!(near > 10_000 && far > 10_000, "{near} {far}");
    }
}
