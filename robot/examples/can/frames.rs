//! The frames on the bus: standard identifiers, little-endian numbers.
//!
//! | id | from | bytes |
//! |---|---|---|
//! | 0x100 | host | counter u8; steer, pedal i16, 1/32767 |
//! | 0x200 | machine | cycle u8; speed i16, cm/s; turning rate i16, mrad/s |
//! | 0x201 | machine | cycle u8; x i24, cm; y i16, cm; heading i16, 1e-4 rad |
//! | 0x202 | machine | cycle u8; group u8; ranges of three beams u16, cm; 65535 is no return |
//!
//! A report is the frames of one cycle, and 0x200 begins it: the bus sends the lowest
//! identifier first. CAN has a checksum of its own, so a frame that arrives is whole; one that
//! was lost costs its report, and a machine that hangs and repeats a cycle reports nothing.

use robot::Action;
use socketcan::{CanDataFrame, CanFrame, EmbeddedFrame, Frame, StandardId};

use super::report::Report;

pub const ORDER: u16 = 0x100;
pub const MOTION: u16 = 0x200;
pub const PLACE: u16 = 0x201;
pub const RANGES: u16 = 0x202;

/// Ranges in a frame: two bytes are the cycle and the group.
const GROUP: usize = 3;
/// Beams of which a group's number, one byte, can tell.
pub const BEAMS_CAN: usize = 256 * GROUP;
/// A beam without a return.
const NO_RETURN: u16 = u16::MAX;

fn number(bytes: [u8; 2], unit: f32) -> f32 {
    f32::from(i16::from_le_bytes(bytes)) * unit
}

/// What the machine is to do until the next order. One that gets none for a quarter of a
/// second, or none with another counter, has to brake by itself: the host may be gone.
pub fn order(counter: u8, action: Action) -> Option<CanDataFrame> {
    let part = |part: f64| ((part * 32_767.0).round() as i16).to_le_bytes();
    let ([s0, s1], [p0, p1]) = (part(action.steer), part(action.pedal));
    CanDataFrame::new(StandardId::new(ORDER)?, &[counter, s0, s1, p0, p1])
}

/// The bytes of a data frame with this standard identifier.
fn data(frame: &CanFrame, id: u16) -> Option<&[u8]> {
    match frame {
        CanFrame::Data(frame) if !frame.is_extended() && frame.raw_id() == u32::from(id) => {
            Some(frame.data())
        }
        _ => None,
    }
}

/// Makes reports of the frames as they arrive.
pub struct Reports {
    cycle: Option<u8>,
    report: Report,
    has_place: bool,
    /// Which groups of ranges of this cycle are there, and how many are not.
    groups: Vec<bool>,
    missing: usize,
    /// Reports of which frames were missing when the next one began.
    pub incomplete: u64,
    /// Frames with ranges of beams that the scanner does not have.
    pub beyond: u64,
}

impl Reports {
    /// For a lidar with this many beams.
    pub fn new(beams: usize) -> Self {
        let groups = beams.div_ceil(GROUP);
        Self {
            cycle: None,
            report: Report {
                ranges_m: vec![f32::NAN; beams],
                ..Report::default()
            },
            has_place: false,
            groups: vec![true; groups],
            missing: 0,
            incomplete: 0,
            beyond: 0,
        }
    }

    /// Takes a frame; returns the report that is whole with it. Other frames are ignored.
    pub fn take(&mut self, frame: &CanFrame) -> Option<&Report> {
        if let Some([cycle, v0, v1, w0, w1]) = data(frame, MOTION) {
            self.begin(*cycle)?;
            self.report.speed_mps = number([*v0, *v1], 0.01);
            self.report.yaw_rate_radps = number([*w0, *w1], 0.001);
        } else if let Some([cycle, x0, x1, x2, y0, y1, h0, h1]) = data(frame, PLACE) {
            self.is_open(*cycle).then_some(())?;
            // The sign is in the highest byte.
            let x_cm = i32::from_le_bytes([0, *x0, *x1, *x2]) >> 8;
            self.report.x_m = x_cm as f32 / 100.0;
            self.report.y_m = number([*y0, *y1], 0.01);
            self.report.heading_rad = number([*h0, *h1], 1e-4);
            self.has_place = true;
        } else {
            let [cycle, group, ranges @ ..] = data(frame, RANGES)? else {
                return None;
            };
            self.is_open(*cycle).then_some(())?;
            self.ranges(usize::from(*group), ranges)?;
        }
        (self.has_place && self.missing == 0).then_some(&self.report)
    }

    /// Begins a cycle, unless it is the one that is there.
    fn begin(&mut self, cycle: u8) -> Option<()> {
        if self.cycle == Some(cycle) {
            return None;
        }
        let was_whole = self.has_place && self.missing == 0;
        self.incomplete += u64::from(self.cycle.is_some() && !was_whole);
        self.cycle = Some(cycle);
        self.has_place = false;
        self.groups.fill(false);
        self.missing = self.groups.len();
        Some(())
    }

    /// Whether frames of a cycle still belong to a report.
    fn is_open(&self, cycle: u8) -> bool {
        self.cycle == Some(cycle) && !(self.has_place && self.missing == 0)
    }

    fn ranges(&mut self, group: usize, ranges: &[u8]) -> Option<()> {
        let [a0, a1, b0, b1, c0, c1] = *ranges else {
            return None;
        };
        let ranges_cm = [[a0, a1], [b0, b1], [c0, c1]].map(u16::from_le_bytes);
        let places = self.report.ranges_m.iter_mut().skip(group * GROUP);
        let beams = places.len().min(GROUP);
        if beams == 0
            || ranges_cm[beams..]
                .iter()
                .any(|range_cm| *range_cm != NO_RETURN)
        {
            self.beyond += 1;
            return None;
        }
        for (place, range_cm) in places.zip(ranges_cm) {
            *place = match range_cm {
                NO_RETURN => f32::NAN,
                range_cm => f32::from(range_cm) / 100.0,
            };
        }
        self.missing -= usize::from(!std::mem::replace(&mut self.groups[group], true));
        Some(())
    }
}
