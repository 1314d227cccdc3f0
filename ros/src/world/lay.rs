//! A route of the newest path, in the frame of the odometry.

use robot::route::{Route, RouteError, Row};
use vehicle::Pose;

use crate::frames::Place;
use crate::inbound::{Path, Refused};

/// Poses of a path that are nearer to each other than this count once, m. Two paths whose
/// poses are all as near are the same.
const APART_M: f64 = 1e-2;

/// The road along a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Road {
    /// Half of its width, m.
    pub half_width_m: f64,
    /// Whether it goes from its end on to its beginning.
    pub is_closed: bool,
}

/// What a route was made of.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Made {
    path: u64,
    /// See [`Laying::lay`].
    frame: u64,
    world_from_path: Pose,
}

/// The newest path, and what was made of it.
#[derive(Debug, Default)]
pub struct Laying {
    newest: Option<Path>,
    number: u64,
    /// What the tick has; `None` if it has no route.
    made: Option<Made>,
}

impl Laying {
    /// Takes a path in. The same path again, as from a planner that repeats it each second or
    /// from a publisher that keeps its last one, is no other: the robot goes on where it is on
    /// it, and does not drive it again after its end. An empty path between makes it another.
    pub fn note(&mut self, path: Path) {
        if self
            .newest
            .as_ref()
            .is_some_and(|newest| is_same(newest, &path))
        {
            return;
        }
        self.newest = Some(path);
        self.number += 1;
    }

    /// Counts the different paths that came; 0 before the first.
    pub fn number(&self) -> u64 {
        self.number
    }

    /// The route of the newest path, `None` for an empty one; nothing if the tick has it
    /// already. `place` says where a frame is in that of the odometry, and `frame` counts the
    /// frames that the odometry has had.
    ///
    /// # Errors
    /// What is wrong with the path, once, or with the place of its frame, which is tried again
    /// at the next call.
    pub fn lay(
        &mut self,
        (frame, place): (u64, impl FnOnce(&str) -> Place),
        road: Road,
    ) -> Option<Result<Option<Route>, Refused>> {
        let path = self.newest.as_ref()?;
        let refused = match place(&path.header.frame) {
            Place::Known(world_from_path) => {
                let made = Made {
                    path: self.number,
                    frame,
                    world_from_path,
                };
                if self.made.replace(made) == Some(made) {
                    return None;
                }
                return Some(route(path, world_from_path, road));
            }
            Place::Tilted => "by TF its frame is not level",
            Place::Unknown => "TF does not say where its frame is in that of the odometry",
        };
        // The tick has no route now, also where the next place is that of before.
        self.made = None;
        Some(Err(Refused(refused)))
    }
}

fn is_same(a: &Path, b: &Path) -> bool {
    let mut places = a.places.iter().zip(&b.places);
    a.header.frame == b.header.frame
        && a.places.len() == b.places.len()
        && places.all(|(a, b)| (a - b).norm() <= APART_M)
}

fn route(path: &Path, world_from_path: Pose, road: Road) -> Result<Option<Route>, Refused> {
    if path.places.is_empty() {
        return Ok(None);
    }
    let half_width_m = road.half_width_m;
    let mut rows: Vec<Row> = Vec::with_capacity(path.places.len());
    for place in &path.places {
        let place = world_from_path * place;
        let is_apart = |from: Option<&Row>| {
            from.is_none_or(|from: &Row| (from.place - place).norm() > APART_M)
        };
        if is_apart(rows.last()) {
            rows.push(Row {
                place,
                left_m: half_width_m,
                right_m: half_width_m,
            });
        }
    }
    // Many closed paths end with their first pose; the route goes on to it by itself.
    while road.is_closed
        && let [first, .., last] = rows.as_slice()
        && (last.place - first.place).norm() <= APART_M
    {
        rows.pop();
    }
    match Route::new(rows, road.is_closed) {
        Ok(route) => Ok(Some(route)),
        Err(RouteError::Line { what, .. }) => Err(Refused(what)),
        Err(_) => Err(Refused("it makes no route")),
    }
}

#[cfg(test)]
mod tests {
    use vehicle::{Point, pose};

    use super::*;
    use crate::inbound::Header;

    const OPEN: Road = Road {
        half_width_m: 2.0,
        is_closed: false,
    };
    const CLOSED: Road = Road {
        is_closed: true,
        ..OPEN
    };

    fn path(places: &[[f64; 2]], stamp_ns: u64) -> Path {
        let places = places.iter().map(|[x_m, y_m]| Point::new(*x_m, *y_m));
        Path {
            header: Header {
                stamp_ns,
                frame: "map".into(),
            },
            places: places.collect(),
        }
    }

    fn known(_frame: &str) -> Place {
        Place::Known(pose(1.0, 2.0, 0.0))
    }

    #[test]
    fn the_same_path_again_is_no_other() {
        let mut laying = Laying::default();
        assert_eq!(laying.lay((1, known), OPEN), None);
        laying.note(path(&[[0.0, 0.0], [9.0, 0.0]], 1));
        assert!(matches!(laying.lay((1, known), OPEN), Some(Ok(Some(_)))));
        for stamp_ns in 2..5 {
            laying.note(path(&[[0.0, 0.0], [9.0, 0.004]], stamp_ns));
            assert_eq!(laying.number(), 1);
            assert_eq!(laying.lay((1, known), OPEN), None);
        }
        for (number, places) in [
            (2, &[[0.0, 0.0], [9.0, 0.5]][..]),
            (3, &[[0.0, 0.0]]),
            (4, &[]),
            (5, &[[0.0, 0.0], [9.0, 0.0]]),
        ] {
            laying.note(path(places, 9));
            assert_eq!(laying.number(), number);
        }
        // An empty path in between, so that it is driven again.
        laying.note(path(&[], 9));
        assert_eq!(laying.lay((1, known), OPEN), Some(Ok(None)));
        laying.note(path(&[[0.0, 0.0], [9.0, 0.0]], 9));
        assert_eq!(laying.number(), 7);
    }

    #[test]
    fn a_frame_that_was_lost_for_a_moment_gives_the_route_again() {
        let mut laying = Laying::default();
        laying.note(path(&[[0.0, 0.0], [9.0, 0.0]], 1));
        assert!(matches!(laying.lay((1, known), OPEN), Some(Ok(Some(_)))));
        for lost in [Place::Unknown, Place::Tilted] {
            let refused = laying.lay((1, |_: &str| lost), OPEN);
            assert!(matches!(refused, Some(Err(_))), "{refused:?}");
            assert!(matches!(laying.lay((1, known), OPEN), Some(Ok(Some(_)))));
            assert_eq!(laying.lay((1, known), OPEN), None);
        }
        // Another frame of the odometry, and back, although the path has the same place in both.
        assert!(matches!(laying.lay((3, known), OPEN), Some(Ok(Some(_)))));
    }

    #[test]
    fn a_closed_path_may_end_with_its_first_pose() {
        let square = [[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]];
        let mut again = square.to_vec();
        again.extend([[0.0, 0.0], [0.0, 0.003]]);
        for places in [&square[..], &again] {
            let laid = route(&path(places, 0), Pose::identity(), CLOSED);
            let laid = laid.expect("a path").expect("a route");
            assert_eq!(laid.length_m(), 36.0);
        }
        // An open one ends there.
        let laid = route(&path(&again, 0), Pose::identity(), OPEN);
        let laid = laid.expect("a path").expect("a route");
        assert_eq!(laid.length_m(), 36.0);
        assert!(!laid.is_closed());
    }

    #[test]
    fn what_is_wrong_with_a_path_is_told_as_it_is() {
        let told = |places: &[[f64; 2]], world_from_path, road| {
            route(&path(places, 0), world_from_path, road).expect_err("no route")
        };
        let two = Refused("a route has at least two rows");
        assert_eq!(told(&[[0.0, 0.0]], Pose::identity(), OPEN), two);
        let twice = [[0.0, 0.0], [0.0, 0.0]];
        assert_eq!(told(&twice, Pose::identity(), CLOSED), two);
        let far = told(&[[0.0, 0.0], [9e5, 0.0]], pose(9e5, 0.0, 0.0), OPEN);
        assert!(far.0.contains("1,000,000"), "{far}");
    }
}
