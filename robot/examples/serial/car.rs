//! The car: a thread reads its reports, and a tick takes the newest.

use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::sync::{Arc, Mutex, Once};
use std::thread;

use robot::{Action, Observation, Reading, Robot, Status};
use rustix::fs::OFlags;
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

use super::link::{Frames, Order, frame};
use super::report::Report;

/// 11.5 kB/s: 11 reports a second with 240 ranges, which have 1.0 kB, or 36 with 72. The
/// run's rate has to be lower, or ticks without a report are skipped: `run.rate_hz`.
const BAUD: u32 = 115_200;

/// The machine at the end of the line.
pub struct Car {
    orders: File,
    /// The newest report that was not read yet.
    newest: Arc<Mutex<Option<Report>>>,
}

impl Car {
    /// Opens the line and starts the thread that reads it: a read waits for the machine,
    /// and the tick must not. A report has as many ranges as the lidar has beams.
    ///
    /// # Errors
    /// When the line is not named or cannot be opened.
    pub fn open(beams: usize) -> Result<Self, String> {
        let path = std::env::var_os("VLAPS_SERIAL").ok_or("VLAPS_SERIAL: name the serial line")?;
        let open = |options: &mut OpenOptions, flags: OFlags| -> Result<File, String> {
            let flags = (flags | OFlags::NOCTTY).bits() as i32;
            let file = options.custom_flags(flags).open(&path);
            file.map_err(|error| format!("VLAPS_SERIAL={}: {error}", path.display()))
        };
        // An order that the line cannot take at once is dropped: the next one is newer.
        let orders = open(File::options().write(true), OFlags::NONBLOCK)?;
        let mut reports = open(File::options().read(true), OFlags::empty())?;
        let raw = || -> rustix::io::Result<()> {
            let mut settings = tcgetattr(&reports)?;
            settings.make_raw();
            settings.set_speed(BAUD)?;
            tcsetattr(&reports, OptionalActions::Flush, &settings)
        };
        raw().map_err(|error| format!("VLAPS_SERIAL={}: {error}", path.display()))?;
        let newest = Arc::new(Mutex::new(None));
        let place = newest.clone();
        thread::spawn(move || listen(&mut reports, beams, &place));
        Ok(Self { orders, newest })
    }
}

/// Keeps the newest report until the line ends; the car is then braked as blind. It is
/// blind, too, without the ranges of all beams: what is not seen must not look free.
fn listen(reports: &mut File, beams: usize, place: &Mutex<Option<Report>>) {
    let (mut frames, mut bytes) = (Frames::default(), [0; 256]);
    let (told_long, told_count) = (Once::new(), Once::new());
    while let Ok(count @ 1..) = reports.read(&mut bytes) {
        let report: Option<Report> = frames.newest(&bytes[..count]);
        if frames.too_long > 0 {
            told_long.call_once(|| tracing::warn!("a frame longer than any report is dropped"));
        }
        let Some(report) = report else { continue };
        let ranges = report.ranges_m.len();
        if ranges != beams {
            told_count.call_once(|| {
                tracing::warn!(
                    ranges,
                    scanner.beams = beams,
                    "a report without the ranges of all beams is dropped"
                );
            });
        } else if let Ok(mut place) = place.lock() {
            *place = Some(report);
        }
    }
}

impl Robot for Car {
    fn begin(&mut self, _seed: u64) -> Result<(), String> {
        Ok(())
    }

    fn obey(&mut self, action: Action, _step_s: f64) {
        let (steer, pedal) = (action.steer as f32, action.pedal as f32);
        let _ = self.orders.write(&frame(&Order { steer, pedal }));
    }

    fn read(&mut self, observation: &mut Observation) -> Reading {
        // Never waits: the thread has no priority, and may be stopped while it holds the lock.
        let newest = self.newest.try_lock().ok();
        let newest = newest.and_then(|mut newest| newest.take());
        let Some(report) = newest else {
            return Reading::Lost;
        };
        report.fill(observation);
        Reading::Fresh
    }

    fn status(&self) -> Status {
        Status::default()
    }
}
