use shm_config::message::BEAMS_MAX;
use vehicle::Point;

/// Two neighbouring returns belong together when they are nearer than this, m,
/// and than this share of their range more: at 30 m neighbouring beams are 0.8 m
/// apart across, and more along a body.
const JOIN_M: f64 = 1.2;
const JOIN_SHARE: f64 = 0.05;
/// Most clusters of one scan; more are left as single, resting returns.
pub(crate) const CLUSTERS_MAX: usize = 64;

/// Neighbouring returns that seem to be one body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Cluster {
    /// Index of its first return.
    pub(crate) first: usize,
    /// How many it has; they follow the first, around the circle.
    pub(crate) count: usize,
    /// Middle of the box around it, along the axes of the returns' frame, m.
    pub(crate) middle: Point,
    /// Half the diagonal of that box, m.
    pub(crate) radius_m: f64,
}

/// Parts the returns of a scan, in order of their beams, into clusters.
pub(crate) fn clusters(
    returns: &heapless::Vec<(Point, f64), BEAMS_MAX>,
) -> heapless::Vec<Cluster, CLUSTERS_MAX> {
    let mut found = heapless::Vec::new();
    let count = returns.len();
    if count == 0 {
        return found;
    }
    let parted = |index: usize| {
        let (point, range_m) = returns[index];
        let (before, _) = returns[(index + count - 1) % count];
        (point - before).norm() > JOIN_M + JOIN_SHARE * range_m
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

fn cluster(
    returns: &heapless::Vec<(Point, f64), BEAMS_MAX>,
    first: usize,
    count: usize,
) -> Cluster {
    let points = (0..count).map(|offset| returns[(first + offset) % returns.len()].0);
    let (mut low, mut high) = (returns[first].0, returns[first].0);
    for point in points {
        low = low.inf(&point);
        high = high.sup(&point);
    }
    Cluster {
        first,
        count,
        middle: nalgebra::center(&low, &high),
        radius_m: (high - low).norm() / 2.0,
    }
}
