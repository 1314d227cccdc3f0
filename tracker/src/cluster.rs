use shm_config::message::BEAMS_MAX;
use vehicle::{Point, Vector};

/// Two neighbouring returns belong together when they are nearer than this, m,
/// and than this share of their range more: at 30 m neighbouring beams are 0.8 m
/// apart across, and more along a body.
const JOIN_M: f64 = 1.2;
const JOIN_SHARE: f64 = 0.05;
/// So many beams between two returns may have hit nothing: more have seen that
/// there is a gap.
const MISSED_MAX: usize = 1;
/// Most clusters of one scan; more are left as single, resting returns.
pub(crate) const CLUSTERS_MAX: usize = 64;

/// What one beam has hit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Return {
    pub(crate) beam: usize,
    pub(crate) point_world: Point,
    pub(crate) range_m: f64,
}

/// The returns of a scan, in order of their beams.
pub(crate) type Returns = heapless::Vec<Return, BEAMS_MAX>;

/// Neighbouring returns that seem to be one body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Cluster {
    /// Index of its first return.
    pub(crate) first: usize,
    /// How many it has; they follow the first, around the circle.
    pub(crate) count: usize,
    /// Middle of the box around it, along the axes of the world, m.
    pub(crate) middle: Point,
    /// Half the diagonal of that box, m.
    pub(crate) radius_m: f64,
}

impl Cluster {
    /// The indices of its returns.
    pub(crate) fn indices(self, returns: usize) -> impl Iterator<Item = usize> {
        (0..self.count).map(move |offset| (self.first + offset) % returns)
    }

    /// Its least and its greatest distance from a place along a direction, m.
    pub(crate) fn extent_m(&self, returns: &Returns, from: Point, axis: Vector) -> (f64, f64) {
        let along = |index: usize| (returns[index].point_world - from).dot(&axis);
        self.indices(returns.len())
            .map(along)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at_m| {
                (low.min(at_m), high.max(at_m))
            })
    }
}

/// Parts the returns of a scan of so many beams into clusters.
pub(crate) fn clusters(returns: &Returns, beams: usize) -> heapless::Vec<Cluster, CLUSTERS_MAX> {
    let mut found = heapless::Vec::new();
    let count = returns.len();
    if count == 0 {
        return found;
    }
    let parted = |index: usize| {
        let Return {
            beam,
            point_world,
            range_m,
        } = returns[index];
        let before = returns[(index + count - 1) % count];
        let gap = (beam + beams - before.beam) % beams;
        gap > MISSED_MAX + 1
            || (point_world - before.point_world).norm() > JOIN_M + JOIN_SHARE * range_m
    };
    let begin = (0..count).find(|&index| parted(index)).unwrap_or(0);
    let mut first = begin;
    for offset in 1..=count {
        let index = begin + offset;
        if offset == count || parted(index % count) {
            // A cluster over the capacity is left out: it rests.
            let _ = found.push(cluster(returns, first % count, index - first));
            first = index;
        }
    }
    found
}

fn cluster(returns: &Returns, first: usize, count: usize) -> Cluster {
    let mut found = Cluster {
        first,
        count,
        middle: Point::origin(),
        radius_m: 0.0,
    };
    let (low_x, high_x) = found.extent_m(returns, Point::origin(), Vector::x());
    let (low_y, high_y) = found.extent_m(returns, Point::origin(), Vector::y());
    let (low, high) = (Point::new(low_x, low_y), Point::new(high_x, high_y));
    found.middle = nalgebra::center(&low, &high);
    found.radius_m = (high - low).norm() / 2.0;
    found
}
