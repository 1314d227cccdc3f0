use shm_config::message::{BEAMS_MAX, Observation};
use vehicle::{Fan, Point, Pose, pose, rem_euclid};

/// A beam has seen through a place when it reached farther than that place by this, m, and
/// by this share of its distance more.
const BEYOND_M: f64 = 0.4;
const BEYOND_SHARE: f64 = 0.02;
/// Scans that are remembered.
const SCANS: usize = 7;
/// So many of the last of them are too recent to show what moves.
const RECENT: usize = 2;

/// The last scans, and the one of now.
#[derive(Debug)]
pub(crate) struct Past {
    /// A ring with one place more than is remembered: that of now.
    scans: Box<[Scan]>,
    now: usize,
    remembered: usize,
}

impl Default for Past {
    /// The only place that allocates.
    fn default() -> Self {
        Self {
            scans: (0..=SCANS).map(|_| Scan::default()).collect(),
            now: 0,
            remembered: 0,
        }
    }
}

impl Past {
    /// Nothing was seen yet.
    pub(crate) fn forget(&mut self) {
        self.remembered = 0;
    }

    /// A scan comes in.
    pub(crate) fn begin(&mut self, observation: &Observation) {
        self.scans[self.now].set(observation);
    }

    /// The scan of now is done: it is remembered, and the earliest one no longer.
    pub(crate) fn end(&mut self) {
        self.now = (self.now + 1) % self.scans.len();
        self.remembered = (self.remembered + 1).min(SCANS);
    }

    /// Notes the track of a return of now.
    pub(crate) fn own(&mut self, beam: usize, track: u32) {
        if let Some(owner) = self.scans[self.now].tracks.get_mut(beam) {
            *owner = track;
        }
    }

    /// Whether something is at a place where nothing was: all earlier scans saw through it,
    /// as far as they are not too recent. One scan can miss a cone between two beams.
    pub(crate) fn is_new(&self, place_world: Point) -> bool {
        let earlier = RECENT + 1..=self.remembered;
        !earlier.is_empty()
            && earlier
                .rev()
                .all(|age| self.scan(age).saw_through(place_world))
    }

    /// The tracks of the earliest scan's returns where nothing is any more, one for each.
    pub(crate) fn left(&self) -> impl Iterator<Item = u32> {
        let is_long = self.remembered > 1;
        let first = is_long.then(|| self.scan(self.remembered));
        let owned = first.into_iter().flat_map(Scan::owned);
        owned
            .filter(|&(place, _)| {
                self.scan(0).saw_through(place) && self.scan(1).saw_through(place)
            })
            .map(|(_, track)| track)
    }

    /// The scan so many before that of now.
    fn scan(&self, age: usize) -> &Scan {
        &self.scans[(self.now + self.scans.len() - age) % self.scans.len()]
    }
}

/// A scan, with the track of each of its beams.
#[derive(Debug, Default)]
struct Scan {
    world_from_body: Pose,
    fan: Option<Fan>,
    max_m: f64,
    ranges_m: heapless::Vec<f32, BEAMS_MAX>,
    /// The track that a beam's return belongs to; 0 without one.
    tracks: heapless::Vec<u32, BEAMS_MAX>,
}

impl Scan {
    fn set(&mut self, observation: &Observation) {
        let ego = &observation.ego;
        self.world_from_body = pose(ego.x_world_m, ego.y_world_m, ego.heading_world_rad);
        self.fan = Some(observation.fan());
        self.max_m = f64::from(observation.lidar_max_m);
        self.ranges_m.clear();
        self.ranges_m.extend(observation.ranges().iter().copied());
        self.tracks.clear();
        self.tracks.extend(self.ranges_m.iter().map(|_| 0));
    }

    /// The returns that belong to tracks: where, and to which.
    fn owned(&self) -> impl Iterator<Item = (Point, u32)> {
        let beams = self.ranges_m.iter().zip(&self.tracks).enumerate();
        beams
            .filter(|(_, (_, track))| **track != 0)
            .filter_map(|(beam, (&range_m, &track))| {
                let point_body = self.fan?.point_body(beam, f64::from(range_m));
                Some((self.world_from_body * point_body, track))
            })
    }

    /// Whether nothing was at a place: both beams beside it reached beyond it.
    fn saw_through(&self, place_world: Point) -> bool {
        let Some(fan) = self.fan else {
            return false;
        };
        let from_mount = self.world_from_body.inverse() * place_world - fan.mount_body;
        let beyond_m = from_mount.norm() * (1.0 + BEYOND_SHARE) + BEYOND_M;
        // Where a beam ends without a return, it saw nothing farther.
        if beyond_m > self.max_m {
            return false;
        }
        let beam = fan.beam_at(from_mount.y.atan2(from_mount.x)).floor();
        let reaches = |beam: f64| {
            let index = match fan.is_circle() {
                true => rem_euclid(beam, fan.beams as f64) as usize,
                false if beam < 0.0 => return false,
                false => beam as usize,
            };
            let range_m = self.ranges_m.get(index);
            range_m.is_some_and(|&range_m| f64::from(range_m) > beyond_m)
        };
        reaches(beam) && reaches(beam + 1.0)
    }
}
