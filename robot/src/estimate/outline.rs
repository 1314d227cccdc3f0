use vehicle::{BEAMS_MAX, Fan, Point, Vector};

/// Neighbours on each side that a line is fitted to: seven points have a third of the noise
/// in direction of three.
const NEIGHBOURS: usize = 3;
/// Fewest points of a line.
const POINTS_MIN: usize = 5;
/// Two neighbours are on one surface when they are at most this far from each other, m, and
/// as many gaps of their beams at their range: a surface 10 degrees from the beam has six.
const GAP_M: f64 = 0.3;
const GAPS: f64 = 6.0;
/// Points this far from their line, m, and twice the noise of a range, are of a corner or of
/// foliage (root mean square).
const OFF_LINE_M: f64 = 0.02;

/// The line through a point of an outline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Line {
    /// The point that it is through: of a curved wall the mean of its neighbours would be
    /// beside the wall.
    pub(super) place: Point,
    /// Its unit normal.
    pub(super) normal: Vector,
    /// Variance of its direction from the noise of the ranges, rad².
    pub(super) tilt_rad2: f64,
    /// Mean square distance of the neighbours from it, m²: by noise, or by a curve.
    pub(super) off_m2: f64,
    /// How far from the place it is known, m.
    pub(super) reach_m: f64,
}

/// The return of a beam.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Mark {
    pub(super) place: Point,
    /// Where its surface is straight.
    pub(super) line: Option<Line>,
}

/// The points of a scan in the frame of the body, each with the line through its neighbours.
/// All beams count as taken at one instant: at 8 m/s a scan of 25 ms is distorted by 0.2 m,
/// which is the caller's to undo.
#[derive(Debug, Clone)]
pub struct Outline {
    pub(super) fan: Fan,
    pub(super) range_std_m: f64,
    /// One for each beam.
    pub(super) marks: Vec<Option<Mark>>,
}

impl Default for Outline {
    fn default() -> Self {
        Self::new()
    }
}

impl Outline {
    /// An outline without points; its memory is for [`BEAMS_MAX`] beams.
    pub fn new() -> Self {
        Self {
            fan: Fan {
                beams: 0,
                field_of_view_rad: std::f64::consts::TAU,
                heading_rad: 0.0,
                mount_body: Point::origin(),
            },
            range_std_m: 0.0,
            marks: Vec::with_capacity(BEAMS_MAX),
        }
    }

    /// Takes a scan: the range of each beam of the fan, m, in the order of the beams, at most
    /// [`BEAMS_MAX`], and the standard deviation of a range, m. A range that is not above 0
    /// and below `max_m` is no return; so is one that is not finite. Returns the number of
    /// points with a line. A scan of a map, of ranges computed from it, has a deviation of 0.
    pub fn fill(
        &mut self,
        fan: &Fan,
        ranges_m: impl IntoIterator<Item = f64>,
        max_m: f64,
        range_std_m: f64,
    ) -> usize {
        self.fan = *fan;
        self.range_std_m = range_std_m;
        self.marks.clear();
        let beams = fan.beams.min(BEAMS_MAX);
        for (beam, range_m) in ranges_m.into_iter().take(beams).enumerate() {
            let mark = (range_m > 0.0 && range_m < max_m).then(|| Mark {
                place: fan.point_body(beam, range_m),
                line: None,
            });
            self.marks.push(mark);
        }
        self.fan.beams = self.marks.len();
        let mut lines = 0;
        for beam in 0..self.marks.len() {
            let line = self.line(beam);
            lines += usize::from(line.is_some());
            if let Some(mark) = &mut self.marks[beam] {
                mark.line = line;
            }
        }
        lines
    }

    /// The beam so many after another, where there is one.
    fn beside(&self, beam: usize, by: isize) -> Option<usize> {
        let beams = self.marks.len() as isize;
        let beside = beam as isize + by;
        match self.fan.is_circle() {
            true => Some(beside.rem_euclid(beams) as usize),
            false => (0..beams).contains(&beside).then_some(beside as usize),
        }
    }

    /// The next point of the same surface on a side.
    fn neighbour(&self, beam: usize, side: isize) -> Option<usize> {
        let beside = self.beside(beam, side)?;
        let (here, there) = (self.marks[beam]?.place, self.marks[beside]?.place);
        let range_m = (here - self.fan.mount_body).norm();
        let limit_m = GAP_M.min(range_m) + GAPS * range_m * self.fan.spacing_rad();
        ((there - here).norm() < limit_m).then_some(beside)
    }

    /// The line through a point and its neighbours, by least squares of the distances.
    fn line(&self, beam: usize) -> Option<Line> {
        let own = self.marks[beam]?.place;
        let mut places = [own; 2 * NEIGHBOURS + 1];
        let mut count = 1;
        for side in [-1, 1] {
            let mut at = beam;
            for _ in 0..NEIGHBOURS {
                let Some(beside) = self.neighbour(at, side) else {
                    break;
                };
                places[count] = self.marks[beside]?.place;
                count += 1;
                at = beside;
            }
        }
        if count < POINTS_MIN {
            return None;
        }
        let places = &places[..count];
        let sum = places
            .iter()
            .fold(Vector::zeros(), |sum, place| sum + place.coords);
        let middle = Point::from(sum / count as f64);
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for place in places {
            let away = place - middle;
            xx += away.x * away.x;
            xy += away.x * away.y;
            yy += away.y * away.y;
        }
        // The axes of the scatter: the greater is along the line.
        let (half, apart) = ((xx + yy) / 2.0, ((xx - yy) / 2.0).hypot(xy));
        let (along_m2, across_m2) = (half + apart, (half - apart).max(0.0));
        let limit_m = OFF_LINE_M + 2.0 * self.range_std_m;
        let off_m2 = across_m2 / count as f64;
        if along_m2 <= 0.0 || off_m2 > limit_m * limit_m {
            return None;
        }
        let (sin, cos) = ((2.0 * xy).atan2(xx - yy) / 2.0).sin_cos();
        let reach = |place: &Point| (place - own).norm();
        Some(Line {
            place: own,
            normal: Vector::new(-sin, cos),
            off_m2,
            tilt_rad2: self.range_std_m.powi(2) / along_m2,
            reach_m: places.iter().map(reach).fold(0.0, f64::max),
        })
    }

    /// The return nearest to a place of the body frame, with its line, m away at most: of
    /// the beams that look within `beside_rad` of the place.
    pub(super) fn nearest(&self, place: Point, away_m: f64, beside_rad: f64) -> Option<Line> {
        let from_mount = place - self.fan.mount_body;
        let angle_rad = from_mount.y.atan2(from_mount.x);
        let middle = self.fan.beam_at(angle_rad);
        let beams = self.marks.len();
        let half = (beside_rad / self.fan.spacing_rad()).ceil().max(2.0);
        // Half of the circle on each side is all of it.
        let half = half.min(beams as f64 / 2.0) as isize;
        let middle = middle.round().clamp(-1e6, 1e6) as isize;
        let mut best = (away_m * away_m, None);
        for by in -half..=half {
            let beam = match self.fan.is_circle() {
                true => (middle + by).rem_euclid(beams.max(1) as isize),
                false => middle + by,
            };
            let mark = usize::try_from(beam)
                .ok()
                .and_then(|beam| self.marks.get(beam));
            let Some(Some(mark)) = mark else { continue };
            let away_m2 = (mark.place - place).norm_squared();
            if away_m2 < best.0 && mark.line.is_some() {
                best = (away_m2, mark.line);
            }
        }
        best.1
    }
}
