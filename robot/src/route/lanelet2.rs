//! Routes of Lanelet2 maps (OSM files): over lanelets that are named, or over successors from
//! a start to a goal.
//!
//! A lanelet is driven in its own direction, also one with `one_way=no`. Regulatory elements,
//! centre lines and heights are not used.

mod osm;
mod place;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use shm_config::file::read_text;
use vehicle::Point;

use super::lanelets::{Lanelet, Lanelets, holding, joined, way};
use super::{ROWS_MAX, Route, RouteError, Row};
use osm::Elements;
use place::Frame;

/// Longest file, bytes: 50 times the example map of Lanelet2, which has 371 lanelets.
const BYTES_MAX: u64 = 32 << 20;
/// Most rows of all lanelets together: 32 MB. Lanelets may share their bounds, so the
/// length of a file limits them only by its square.
const ROWS_OF_MAP_MAX: usize = 1 << 20;
/// Two places of a bound nearer to each other than this are one, m.
const SAME_M: f64 = 1e-3;

/// A map of lanelets.
#[derive(Debug)]
pub struct Map {
    path: PathBuf,
    frame: Frame,
    lanelets: Lanelets,
    /// The bounds that a lanelet ends with are those that its successors begin with.
    ends: BTreeMap<i64, [i64; 2]>,
    begins: BTreeMap<i64, [i64; 2]>,
}

impl Map {
    /// Reads a map.
    ///
    /// The frame is that of the tags `local_x` and `local_y`, or `x` and `y`, where the nodes
    /// have them. Otherwise it is the plane that touches the Earth at the node with the least
    /// number, x to the east and y to the north: distances are too short by 4 mm at 10 km from there.
    ///
    /// # Errors
    /// A file that cannot be read or is longer than 32 MiB, that is no OSM file or has a
    /// document type (entities are not expanded), and lanelets whose bounds are missing or
    /// have no direction.
    pub fn read(path: &Path) -> Result<Self, RouteError> {
        let text = read_text(path, BYTES_MAX).map_err(|error| RouteError::File {
            path: path.into(),
            error,
        })?;
        Self::of(&text, path).map_err(|what| RouteError::Scenario {
            path: path.into(),
            what,
        })
    }

    fn of(text: &str, path: &Path) -> Result<Self, String> {
        let elements = Elements::read(text)?;
        let frame = Frame::of(&elements.nodes)?;
        let mut map = Self {
            path: path.into(),
            frame,
            lanelets: Lanelets::new(),
            ends: BTreeMap::new(),
            begins: BTreeMap::new(),
        };
        let mut total = 0;
        for (&id, bounds) in &elements.lanelets {
            let named = |what: String| format!("lanelet {id}: {what}");
            let [left, right] = map.bounds(&elements, *bounds).map_err(named)?;
            let ends = |of: fn(&Bound) -> Option<i64>| Some([of(&left)?, of(&right)?]);
            if let Some(pair) = ends(|bound| bound.first().map(|(node, _)| *node)) {
                map.begins.insert(id, pair);
            }
            if let Some(pair) = ends(|bound| bound.last().map(|(node, _)| *node)) {
                map.ends.insert(id, pair);
            }
            total += left.len() + right.len();
            if total > ROWS_OF_MAP_MAX {
                return Err(format!(
                    "its lanelets have more than {ROWS_OF_MAP_MAX} places; cut out the part that \
                     the route needs"
                ));
            }
            let lanelet = Lanelet {
                rows: rows(&left, &right),
                successors: Vec::new(),
            };
            // The check of a route is that of its lanelets; here it names them.
            Route::new(lanelet.rows.clone(), false).map_err(|error| named(error.to_string()))?;
            map.lanelets.insert(id, lanelet);
        }
        map.join();
        Ok(map)
    }

    /// The places of both bounds, in the direction that has the left one on the left.
    fn bounds(&self, elements: &Elements, ways: [i64; 2]) -> Result<[Bound; 2], String> {
        let [left, right] = ways.map(|way| self.bound(elements, way));
        let (mut left, mut right) = (left?, right?);
        let end = |bound: &Bound| (bound[0].1, bound[bound.len() - 1].1);
        let ((l0, l1), (r0, r1)) = (end(&left), end(&right));
        if (l0 - r0).norm() + (l1 - r1).norm() > (l0 - r1).norm() + (l1 - r0).norm() {
            right.reverse();
        }
        // Round the lanelet, forwards along the left bound: clockwise.
        let round = left.iter().chain(right.iter().rev());
        let next = left
            .iter()
            .skip(1)
            .chain(right.iter().rev())
            .chain(&left[..1]);
        let area: f64 = round
            .zip(next)
            .map(|(a, b)| a.1.coords.perp(&b.1.coords))
            .sum();
        if area > 0.0 {
            left.reverse();
            right.reverse();
        }
        Ok([left, right])
    }

    /// The nodes of a way with their places; of places that are the same, the first, and the
    /// last node of all.
    fn bound(&self, elements: &Elements, way: i64) -> Result<Bound, String> {
        let nodes = elements.ways.get(&way);
        let nodes = nodes.ok_or_else(|| format!("the file has no way {way}"))?;
        let mut bound = Bound::new();
        for id in nodes {
            let node = elements.nodes.get(id);
            let node = node.ok_or_else(|| format!("way {way}: the file has no node {id}"))?;
            let place = self.frame.of_node(node);
            let is_same = bound
                .last()
                .is_some_and(|(_, last)| (place - last).norm() < SAME_M);
            match (is_same, bound.len()) {
                // The first node is the one that the lanelet before it ends with.
                (true, 1) => {}
                (true, _) => *bound.last_mut().ok_or("no node")? = (*id, place),
                (false, _) => bound.push((*id, place)),
            }
        }
        match bound.len() {
            0 | 1 => Err(format!("way {way} has fewer than two places")),
            _ => Ok(bound),
        }
    }

    /// Finds the successors of all lanelets.
    fn join(&mut self) {
        let mut beginning: BTreeMap<[i64; 2], Vec<i64>> = BTreeMap::new();
        for (id, pair) in &self.begins {
            beginning.entry(*pair).or_default().push(*id);
        }
        for (id, lanelet) in &mut self.lanelets {
            let next = self.ends.get(id).and_then(|pair| beginning.get(pair));
            lanelet.successors = next.cloned().unwrap_or_default();
        }
    }

    /// The numbers of its lanelets.
    pub fn lanelets(&self) -> impl Iterator<Item = i64> {
        self.lanelets.keys().copied()
    }

    /// The place of a latitude and a longitude, degrees, in the frame of the map; `None` where
    /// the map has local coordinates alone.
    pub fn place(&self, latitude_deg: f64, longitude_deg: f64) -> Option<Point> {
        self.frame.of_degrees(latitude_deg, longitude_deg)
    }

    /// The route over these lanelets, in order; closed when the first follows the last.
    ///
    /// # Errors
    /// A lanelet that the map does not have, or that does not follow the one before it.
    pub fn over(&self, ids: &[i64]) -> Result<Route, RouteError> {
        let refused = |what: String| RouteError::Scenario {
            path: self.path.clone(),
            what,
        };
        if let Some(id) = ids.iter().find(|id| !self.lanelets.contains_key(id)) {
            return Err(refused(format!("no lanelet {id}")));
        }
        let mut length = 0;
        for (k, id) in ids.iter().enumerate() {
            let lanelet = &self.lanelets[id];
            length += lanelet.rows.len();
            if length > ROWS_MAX {
                return Err(refused(format!("the route has more than {ROWS_MAX} rows")));
            }
            if let Some(next) = ids.get(k + 1)
                && !lanelet.successors.contains(next)
            {
                let follow = &lanelet.successors;
                return Err(refused(format!(
                    "lanelet {next} does not follow {id}, which {follow:?} do"
                )));
            }
        }
        let is_closed = match ids {
            [first, .., last] => self.lanelets[last].successors.contains(first),
            [only] => self.lanelets[only].successors.contains(only),
            [] => return Err(refused("a route has at least one lanelet".into())),
        };
        let mut rows = joined(&self.lanelets, ids);
        if is_closed {
            rows.pop();
        }
        Route::new(rows, is_closed).map_err(|error| refused(error.to_string()))
    }

    /// The route over the fewest lanelets from one that holds the start to one that holds the
    /// goal, by successors. It begins and ends with whole lanelets.
    ///
    /// # Errors
    /// A place that is on no lanelet, and a goal that needs a change of lanes.
    pub fn between(&self, start: Point, goal: Point) -> Result<Route, RouteError> {
        let refused = |what: String| RouteError::Scenario {
            path: self.path.clone(),
            what,
        };
        let [begins, ends] = [("start", start), ("goal", goal)].map(|(name, place)| {
            let held: Vec<i64> = holding(&self.lanelets, place).collect();
            match held.is_empty() {
                true => Err(refused(format!("the {name} is on no lanelet"))),
                false => Ok(held),
            }
        });
        let ends: BTreeSet<i64> = ends?.into_iter().collect();
        let ids = way(&self.lanelets, begins?, &ends).map_err(refused)?;
        let rows = joined(&self.lanelets, &ids);
        Route::new(rows, false).map_err(|error| refused(error.to_string()))
    }
}

/// The nodes of a bound, with their places.
type Bound = Vec<(i64, Point)>;

/// Rows between two bounds: one wherever either of them has a place, by its share of the
/// bound's length.
fn rows(left: &Bound, right: &Bound) -> Vec<Row> {
    let bounds = [left, right].map(Shares::of);
    let mut shares: Vec<f64> = bounds.iter().flat_map(|bound| bound.at.clone()).collect();
    shares.sort_by(f64::total_cmp);
    let mut rows: Vec<Row> = Vec::with_capacity(shares.len());
    for share in shares {
        let [left, right] = bounds.each_ref().map(|bound| bound.place(share));
        let half_m = (left - right).norm() / 2.0;
        let row = Row {
            place: nalgebra::center(&left, &right),
            left_m: half_m,
            right_m: half_m,
        };
        let is_same = |last: &Row| (last.place - row.place).norm() < SAME_M;
        match rows.last_mut() {
            // The last row is that of the ends.
            Some(last) if is_same(last) => *last = if share < 1.0 { *last } else { row },
            _ => rows.push(row),
        }
    }
    rows
}

/// A bound with the share of its length at each place.
struct Shares<'a> {
    bound: &'a Bound,
    at: Vec<f64>,
}

impl<'a> Shares<'a> {
    fn of(bound: &'a Bound) -> Self {
        let mut sum_m = 0.0;
        let mut at = vec![0.0];
        for pair in bound.windows(2) {
            sum_m += (pair[1].1 - pair[0].1).norm();
            at.push(sum_m);
        }
        let last = at.len() - 1;
        for share in &mut at {
            *share /= sum_m;
        }
        at[last] = 1.0;
        Self { bound, at }
    }

    fn place(&self, share: f64) -> Point {
        let after = self.at.partition_point(|at| *at <= share);
        let after = after.clamp(1, self.at.len() - 1);
        let (from, to) = (self.at[after - 1], self.at[after]);
        let part = ((share - from) / (to - from)).clamp(0.0, 1.0);
        let [begin, end] = [after - 1, after].map(|k| self.bound[k].1);
        begin + (end - begin) * part
    }
}

#[cfg(test)]
mod tests;
