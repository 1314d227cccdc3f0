use shm_config::message::{Observation, Road};
use vehicle::{Point, Pose, pose, wrap_rad};

use super::{RouteError, checkpoint};

/// One row of a route: a place of its middle line and how far the road reaches to the sides.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// The place, m, in the frame of the map.
    pub place: Point,
    /// From the line to the left edge of the road, m.
    pub left_m: f64,
    /// From the line to the right edge of the road, m.
    pub right_m: f64,
}

/// A road with a middle line, which is driven from its first row to its last, or round
/// and round.
#[derive(Debug, Clone, PartialEq)]
pub struct Route {
    rows: Vec<Row>,
    /// Distance of each row along the line, m; of a closed route also that of the first
    /// row after one round.
    along_m: Vec<f64>,
    is_closed: bool,
}

/// A place beside a route.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Located {
    /// Distance along the route, m, [0, length].
    pub along_m: f64,
    /// Offset from the middle line, m, positive left.
    pub offset_m: f64,
}

/// Most rows of a route: a row each 10 cm for 10 km. A place is looked for among all of them
/// where the last one is not known.
pub const ROWS_MAX: usize = 100_000;
/// Rows nearer to each other than this have no direction, m.
const ROW_MIN_M: f64 = 1e-3;
/// Widest road and farthest place, m.
const WIDTH_MAX_M: f64 = 500.0;
const PLACE_MAX_M: f64 = 1e6;
/// How far from its last place along the route a robot is looked for, m: a route may cross
/// itself, and the nearest place of it may be on the other branch.
const NEAR_M: f64 = 20.0;

impl Route {
    /// A route over these rows; a closed one goes from the last row on to the first.
    ///
    /// # Errors
    /// Fewer than two rows or more than [`ROWS_MAX`], numbers that are not finite or out of
    /// range, rows without a distance between them.
    pub fn new(rows: Vec<Row>, is_closed: bool) -> Result<Self, RouteError> {
        if rows.len() < 2 {
            let what = "a route has at least two rows";
            return Err(RouteError::Line {
                row: rows.len(),
                what,
            });
        }
        if rows.len() > ROWS_MAX {
            let what = "a route has at most 100,000 rows";
            let row = ROWS_MAX;
            return Err(RouteError::Line { row, what });
        }
        for (
            row,
            Row {
                place,
                left_m,
                right_m,
            },
        ) in rows.iter().enumerate()
        {
            let refused = |what| Err(RouteError::Line { row, what });
            if !place.iter().all(|along_m| along_m.abs() <= PLACE_MAX_M) {
                return refused("its place is not a number of metres up to 1,000,000");
            }
            if ![left_m, right_m]
                .iter()
                .all(|side_m| (0.0..=WIDTH_MAX_M).contains(*side_m))
            {
                return refused("its widths are not within 0 to 500 m");
            }
        }
        let next = |k: usize| rows[(k + 1) % rows.len()].place;
        let segments = if is_closed {
            rows.len()
        } else {
            rows.len() - 1
        };
        let mut along_m = vec![0.0];
        let mut sum_m = 0.0;
        for (row, from) in rows.iter().take(segments).enumerate() {
            let length_m = (next(row) - from.place).norm();
            if length_m < ROW_MIN_M {
                let what = "it is less than a millimetre from the next one";
                return Err(RouteError::Line { row, what });
            }
            sum_m += length_m;
            along_m.push(sum_m);
        }
        Ok(Self {
            rows,
            along_m,
            is_closed,
        })
    }

    /// Its length, m; of a closed route that of one round.
    pub fn length_m(&self) -> f64 {
        self.along_m[self.along_m.len() - 1]
    }

    /// Whether it goes round and round.
    pub fn is_closed(&self) -> bool {
        self.is_closed
    }

    /// The ends of a segment.
    fn segment(&self, k: usize) -> (&Row, &Row) {
        (&self.rows[k], &self.rows[(k + 1) % self.rows.len()])
    }

    /// A distance along the route, m, within its length.
    fn within(&self, along_m: f64) -> f64 {
        match self.is_closed {
            true => along_m.rem_euclid(self.length_m()),
            false => along_m.clamp(0.0, self.length_m()),
        }
    }

    /// The line so far along the route: its pose, and the distances to the edges, m.
    pub fn at(&self, along_m: f64) -> (Pose, f64, f64) {
        let along_m = self.within(along_m);
        let last = self.along_m.len() - 2;
        let k = self.along_m.partition_point(|&start_m| start_m <= along_m);
        let k = k.saturating_sub(1).min(last);
        let (from, to) = self.segment(k);
        let (start_m, end_m) = (self.along_m[k], self.along_m[k + 1]);
        let share = (along_m - start_m) / (end_m - start_m);
        let place = from.place + (to.place - from.place) * share;
        let mix = |from: f64, to: f64| from + (to - from) * share;
        (
            pose(place.x, place.y, self.direction_rad(k, share)),
            mix(from.left_m, to.left_m),
            mix(from.right_m, to.right_m),
        )
    }

    /// Direction of the line within a segment, rad: at a row it is between those of its two
    /// segments, so that it changes gradually.
    fn direction_rad(&self, k: usize, share: f64) -> f64 {
        let segments = self.along_m.len() - 1;
        let own = |k: usize| {
            let (from, to) = self.segment(k);
            let way = to.place - from.place;
            way.y.atan2(way.x)
        };
        let here = own(k);
        let (neighbour, weight) = match share < 0.5 {
            true => (k.checked_sub(1), 0.5 - share),
            false => (Some(k + 1), share - 0.5),
        };
        let neighbour = match neighbour {
            Some(k) if k < segments => k,
            Some(_) if self.is_closed => 0,
            None if self.is_closed => segments - 1,
            _ => return here,
        };
        here + weight * wrap_rad(own(neighbour) - here)
    }

    /// The nearest place of the route. With the distance along it of a moment ago only the
    /// 20 m around it are looked at, because a route may cross itself.
    pub fn locate(&self, place: Point, last_m: Option<f64>) -> Located {
        let mut best = (
            f64::INFINITY,
            Located {
                along_m: 0.0,
                offset_m: 0.0,
            },
        );
        for k in 0..self.along_m.len() - 1 {
            let (start_m, end_m) = (self.along_m[k], self.along_m[k + 1]);
            if last_m.is_some_and(|last_m| self.distance_m(last_m, start_m, end_m) > NEAR_M) {
                continue;
            }
            let (from, to) = self.segment(k);
            let way = (to.place - from.place) / (end_m - start_m);
            let beside = place - from.place;
            let ahead_m = beside.dot(&way).clamp(0.0, end_m - start_m);
            let away_m = (beside - way * ahead_m).norm();
            if away_m < best.0 {
                // Positive left of the segment.
                let offset_m = away_m.copysign(way.perp(&beside));
                let along_m = start_m + ahead_m;
                best = (away_m, Located { along_m, offset_m });
            }
        }
        best.1
    }

    /// How far a place along the route is from a segment of it, m.
    fn distance_m(&self, last_m: f64, start_m: f64, end_m: f64) -> f64 {
        let last_m = self.within(last_m);
        let direct_m = (start_m - last_m).max(last_m - end_m).max(0.0);
        match self.is_closed {
            true => direct_m
                .min(self.length_m() - direct_m - (end_m - start_m))
                .max(0.0),
            false => direct_m,
        }
    }

    /// Fills road and checkpoints of an observation for a pose on the map: the checkpoints are
    /// `spacing_m` and twice that along the route. Give the distance along the route that the
    /// last call returned, or `None` at first. Returns where on the route the robot is.
    pub fn fill(
        &self,
        observation: &mut Observation,
        map_from_body: &Pose,
        spacing_m: f64,
        last_m: Option<f64>,
    ) -> Located {
        let located = self.locate(map_from_body.translation.vector.into(), last_m);
        let (map_from_road, left_m, right_m) = self.at(located.along_m);
        let heading_rad = map_from_body.rotation.angle() - map_from_road.rotation.angle();
        observation.road = Road {
            left_m: left_m - located.offset_m,
            right_m: right_m + located.offset_m,
            heading_rad: wrap_rad(heading_rad),
            offset_m: located.offset_m,
            lane_width_m: 0.0,
        };
        let mut from = map_from_road;
        observation.checkpoints = [1.0, 2.0].map(|times| {
            let (to, ..) = self.at(located.along_m + times * spacing_m);
            let place_body = map_from_body.inverse_transform_point(&to.translation.vector.into());
            let found = checkpoint(&(map_from_body.inverse() * from), place_body, left_m);
            from = to;
            found
        });
        located
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, TAU};

    use shm_config::message::{Bend, Message as _};

    use super::*;

    fn row(x: f64, y: f64) -> Row {
        Row {
            place: Point::new(x, y),
            left_m: 2.0,
            right_m: 3.0,
        }
    }

    fn ring(radius_m: f64, rows: usize) -> Route {
        let rows = (0..rows).map(|k| {
            let angle_rad = TAU * k as f64 / rows as f64;
            row(radius_m * angle_rad.cos(), radius_m * angle_rad.sin())
        });
        Route::new(rows.collect(), true).expect("a ring")
    }

    #[test]
    fn a_straight_road_is_seen_as_it_is() {
        let route = Route::new(vec![row(0.0, 0.0), row(100.0, 0.0)], false).expect("a route");
        let mut observation = Observation::default();
        let located = route.fill(&mut observation, &pose(10.0, 0.5, 0.1), 20.0, None);
        assert_eq!((located.along_m, located.offset_m), (10.0, 0.5));
        let road = &observation.road;
        assert_eq!((road.left_m, road.right_m, road.offset_m), (1.5, 3.5, 0.5));
        assert!((road.heading_rad - 0.1).abs() < 1e-12);
        let [first, second] = &observation.checkpoints;
        let expected = pose(10.0, 0.5, 0.1).inverse_transform_point(&Point::new(30.0, 0.0));
        assert!((first.x_body_m - expected.x).abs() < 1e-9);
        assert!((first.y_body_m - expected.y).abs() < 1e-9);
        assert_eq!([first.bend, second.bend], [Bend::Straight.code(); 2]);
        assert_eq!(observation.check(), Ok(()));
        // At its end both are the end.
        route.fill(&mut observation, &pose(95.0, 0.0, 0.0), 20.0, None);
        assert_eq!(observation.checkpoints[0].x_body_m, 5.0);
        assert_eq!(observation.checkpoints[1].x_body_m, 5.0);
    }

    #[test]
    fn a_ring_bends_left_with_its_radius_all_the_way_round() {
        let route = ring(30.0, 720);
        let (mut last_m, mut observation) = (None, Observation::default());
        for k in 0..100 {
            let angle_rad = TAU * f64::from(k) / 90.0;
            let (x, y) = (30.0 * angle_rad.cos(), 30.0 * angle_rad.sin());
            let here = pose(x, y, angle_rad + FRAC_PI_2);
            let located = route.fill(&mut observation, &here, 10.0, last_m);
            last_m = Some(located.along_m);
            assert!(located.offset_m.abs() < 1e-2, "{located:?}");
            assert!(observation.road.heading_rad.abs() < 1e-2, "{k}");
            for checkpoint in &observation.checkpoints {
                assert_eq!(checkpoint.bend, Bend::Left.code());
                // Of the left edge, 2 m from the middle line.
                let off_m = checkpoint.bend_radius_m - 28.0;
                assert!(off_m.abs() < 0.5, "{checkpoint:?}");
            }
        }
    }

    #[test]
    fn a_route_that_crosses_itself_is_followed_on_its_own_branch() {
        let eight = vec![
            row(0.0, 0.0),
            row(60.0, 0.0),
            row(60.0, 60.0),
            row(30.0, 60.0),
            row(30.0, -60.0),
        ];
        let route = Route::new(eight, false).expect("a route");
        let crossing = Point::new(30.0, 0.0);
        let first = route.locate(crossing, Some(28.0));
        let second = route.locate(crossing, Some(205.0));
        assert!((first.along_m - 30.0).abs() < 1e-9, "{first:?}");
        assert!((second.along_m - 210.0).abs() < 1e-9, "{second:?}");
    }

    #[test]
    fn what_is_no_line_is_refused_with_its_row() {
        let refused = |rows: Vec<Row>| match Route::new(rows, false) {
            Err(RouteError::Line { row, .. }) => row,
            other => panic!("{other:?}"),
        };
        assert_eq!(refused(vec![]), 0);
        assert_eq!(refused(vec![row(0.0, 0.0)]), 1);
        let rows = |count: usize| (0..count).map(|k| row(k as f64, 0.0)).collect();
        assert_eq!(refused(rows(ROWS_MAX + 1)), ROWS_MAX);
        assert!(Route::new(rows(ROWS_MAX), false).is_ok());
        assert_eq!(refused(vec![row(0.0, 0.0), row(0.0, 0.0)]), 0);
        assert_eq!(refused(vec![row(0.0, 0.0), row(f64::NAN, 0.0)]), 1);
        assert_eq!(refused(vec![row(0.0, 0.0), row(1.0, f64::INFINITY)]), 1);
        let mut narrow = row(1.0, 0.0);
        narrow.left_m = -1.0;
        assert_eq!(refused(vec![row(0.0, 0.0), narrow]), 1);
    }
}
