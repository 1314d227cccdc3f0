//! The car: a thread reads its reports, and a tick takes the newest.

use std::sync::{Arc, Mutex, Once};
use std::thread;

use robot::{Action, Observation, Reading, Robot, Status};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::Errno;
use socketcan::{CanFrame, CanSocket, ShouldRetry, Socket};

use super::bus;
use super::frames::{BEAMS_CAN, Reports, order};
use super::report::Report;

/// The machine on the bus.
pub struct Car {
    bus: Arc<CanSocket>,
    /// Goes up with each order, so that the machine tells a new one from a repeated one.
    counter: u8,
    /// The newest report that was not read yet.
    newest: Arc<Mutex<Option<Report>>>,
}

impl Car {
    /// Opens the bus and starts the thread that reads it: a read waits for the machine, and
    /// the tick must not. A report has as many ranges as the lidar has beams.
    ///
    /// # Errors
    /// When the bus is not named or cannot be opened, or the lidar has too many beams.
    pub fn open(beams: usize) -> Result<Self, String> {
        if beams > BEAMS_CAN {
            return Err(format!(
                "scanner.beams = {beams}: the frames of this example number at most {BEAMS_CAN}"
            ));
        }
        let bus = Arc::new(bus::open()?);
        let newest = Arc::new(Mutex::new(None));
        let (source, place) = (bus.clone(), newest.clone());
        thread::spawn(move || listen(&source, Reports::new(beams), &place));
        Ok(Self {
            bus,
            counter: 0,
            newest,
        })
    }
}

/// Keeps the newest report until the bus ends; the car is then braked as blind. It is
/// blind, too, without the ranges of all beams: what is not seen must not look free.
fn listen(bus: &CanSocket, mut reports: Reports, place: &Mutex<Option<Report>>) {
    let (told_bus, told_incomplete, told_beyond) = (Once::new(), Once::new(), Once::new());
    loop {
        let mut ready = [PollFd::new(bus, PollFlags::IN)];
        if poll(&mut ready, None).is_err() {
            continue;
        }
        let frame = match bus.read_frame() {
            Ok(CanFrame::Error(frame)) => {
                let error = frame.into_error();
                told_bus.call_once(|| tracing::warn!(%error, "the bus reports an error"));
                continue;
            }
            Ok(frame) => frame,
            Err(error) if error.should_retry() => continue,
            // An interface that is down, as after too many errors, may come back.
            Err(error) if Errno::from_io_error(&error) == Some(Errno::NETDOWN) => {
                told_bus.call_once(|| tracing::warn!(%error, "the bus reports an error"));
                continue;
            }
            Err(error) => {
                tracing::warn!(%error, "the bus has ended");
                return;
            }
        };
        let newest = reports.take(&frame).cloned();
        if reports.incomplete > 0 {
            told_incomplete.call_once(|| {
                tracing::warn!("a report without the ranges of all beams is dropped")
            });
        }
        if reports.beyond > 0 {
            told_beyond
                .call_once(|| tracing::warn!("ranges of more beams than scanner.beams arrive"));
        }
        if let (Some(report), Ok(mut place)) = (newest, place.lock()) {
            *place = Some(report);
        }
    }
}

impl Robot for Car {
    fn begin(&mut self, _seed: u64) -> Result<(), String> {
        Ok(())
    }

    fn obey(&mut self, action: Action, _step_s: f64) {
        self.counter = self.counter.wrapping_add(1);
        // An order that the bus cannot take at once is dropped: the next one is newer.
        if let Some(order) = order(self.counter, action) {
            let _ = self.bus.write_frame(&order);
        }
    }

    fn read(&mut self, observation: &mut Observation) -> Reading {
        // Never waits: the thread has no priority, and may be stopped while it holds the lock.
        let newest = self.newest.try_lock().ok();
        let Some(report) = newest.and_then(|mut newest| newest.take()) else {
            return Reading::Lost;
        };
        report.fill(observation);
        Reading::Fresh
    }

    fn status(&self) -> Status {
        Status::default()
    }
}
