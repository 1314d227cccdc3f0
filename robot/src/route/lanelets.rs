//! Lanelets, whatever file they are of: which holds a place, and the way over successors.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use vehicle::Point;

use super::{Route, Row};

/// A place may be as far before or after a lanelet and still be on it, m.
const BEYOND_MAX_M: f64 = 0.5;

/// One lanelet: a piece of a lane.
#[derive(Debug)]
pub(super) struct Lanelet {
    pub(super) rows: Vec<Row>,
    pub(super) successors: Vec<i64>,
}

/// The lanelets of a file by their number.
pub(super) type Lanelets = BTreeMap<i64, Lanelet>;

impl Lanelet {
    /// Whether a place is on it.
    fn holds(&self, place: Point) -> bool {
        let Ok(route) = Route::new(self.rows.clone(), false) else {
            return false;
        };
        let located = route.locate(place, None);
        let (map_from_road, left_m, right_m) = route.at(located.along_m);
        let beyond_m = map_from_road.inverse_transform_point(&place).x.abs();
        beyond_m < BEYOND_MAX_M && (-right_m..=left_m).contains(&located.offset_m)
    }
}

/// The lanelets that hold a place.
pub(super) fn holding(lanelets: &Lanelets, place: Point) -> impl Iterator<Item = i64> {
    let held = lanelets
        .iter()
        .filter(move |(_, lanelet)| lanelet.holds(place));
    held.map(|(id, _)| *id)
}

/// The lanelets from one of the first to one of the last over successors, the fewest.
pub(super) fn way(
    lanelets: &Lanelets,
    begins: Vec<i64>,
    ends: &BTreeSet<i64>,
) -> Result<Vec<i64>, String> {
    let mut before: BTreeMap<i64, Option<i64>> = begins.iter().map(|id| (*id, None)).collect();
    let mut due = VecDeque::from(begins);
    while let Some(id) = due.pop_front() {
        if ends.contains(&id) {
            let mut way = vec![id];
            while let Some(Some(previous)) = before.get(&way[way.len() - 1]) {
                way.push(*previous);
            }
            way.reverse();
            return Ok(way);
        }
        for next in &lanelets[&id].successors {
            if lanelets.contains_key(next) && !before.contains_key(next) {
                before.insert(*next, Some(id));
                due.push_back(*next);
            }
        }
    }
    Err("no way over successors leads to the goal; changes of lanes are not planned".into())
}

/// The rows of a way, each lanelet beginning where the one before it ends.
pub(super) fn joined(lanelets: &Lanelets, way: &[i64]) -> Vec<Row> {
    let mut rows: Vec<Row> = Vec::new();
    for id in way {
        let joined = usize::from(!rows.is_empty());
        rows.extend(&lanelets[id].rows[joined..]);
    }
    rows
}
