//! The connection to the router, the commands out, and the lines about both.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{JoinHandle, Thread};
use std::time::Duration;

use recorder::standard::{Drive, drive_cdr};
use shm_config::Instant;
use shm_config::config::Config;
use triple_buffer::{Input, Output, triple_buffer};

use super::ears::{Ears, Subscribed};
use super::robot::Slots;
use crate::names::TopicType;
use crate::publisher::RosPublisher;
use crate::session::{Connection, Link};
use crate::settings::Settings;
use crate::wall::{Moment, Wall};

/// Longest time between two looks at router, clocks and path. A command wakes the thread.
const LOOK: Duration = Duration::from_millis(100);
const LOOK_NS: u64 = LOOK.as_nanos() as u64;
/// Time between two attempts to connect, ns.
const ATTEMPT_NS: u64 = 1_000_000_000;
/// The node's name.
const NODE: &str = "vlaps_world";

/// The tick's end: it leaves a command and goes on.
pub struct Voice {
    drives: Input<Drive>,
    thread: Thread,
}

impl Voice {
    /// Sends a command soon. One that is not sent yet is replaced.
    pub fn say(&mut self, drive: Drive) {
        self.drives.write(drive);
        // One system call that never waits.
        self.thread.unpark();
    }
}

/// The thread. When it is dropped, the last command is still sent.
pub struct VoiceThread {
    stop: Arc<AtomicBool>,
    handle: Option<JoinHandle<()>>,
}

impl VoiceThread {
    /// Starts it.
    ///
    /// # Errors
    /// One line: a type is not known, or the thread cannot be started.
    pub fn start(
        config: &Config,
        settings: &Settings,
        slots: Slots,
    ) -> Result<(Voice, Self), String> {
        let (drives, out) = triple_buffer(&Drive::default());
        let stop = Arc::new(AtomicBool::new(false));
        let mut speaker = Speaker {
            drive: TopicType::standard("ackermann_msgs/AckermannDriveStamped")?,
            ears: Arc::new(Ears::new(config, settings, slots)),
            settings: settings.clone(),
            wall: Wall::new(Moment::now()),
            connection: Connection::default(),
            open: None,
            looked: None,
            tried: None,
            drives: out,
        };
        let stopped = stop.clone();
        let handle = std::thread::Builder::new()
            .name("ros".into())
            .spawn(move || speaker.run(&stopped))
            .map_err(|error| format!("cannot start a thread: {error}"))?;
        let thread = handle.thread().clone();
        let handle = Some(handle);
        Ok((Voice { drives, thread }, Self { stop, handle }))
    }
}

impl Drop for VoiceThread {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(handle) = self.handle.take() {
            handle.thread().unpark();
            // It panicked, and said so.
            let _ = handle.join();
        }
    }
}

struct Speaker {
    settings: Settings,
    ears: Arc<Ears>,
    drive: TopicType,
    wall: Wall,
    connection: Connection,
    open: Option<Open>,
    looked: Option<Instant>,
    tried: Option<Instant>,
    drives: Output<Drive>,
}

/// What lives as long as a session.
struct Open {
    drive: RosPublisher,
    _heard: Subscribed,
    link: Link,
}

impl Speaker {
    fn run(&mut self, stop: &AtomicBool) {
        loop {
            let is_last = stop.load(Ordering::Relaxed);
            let moment = Moment::now();
            self.send(moment);
            if is_last {
                return;
            }
            let is_due = |last: Option<Instant>, interval_ns| {
                last.is_none_or(|last| moment.now.since_ns(last) >= interval_ns)
            };
            if is_due(self.looked, LOOK_NS) {
                self.looked = Some(moment.now);
                let may_try = is_due(self.tried, ATTEMPT_NS);
                if self.open.is_none() && may_try {
                    self.tried = Some(moment.now);
                    self.open = self.connect().ok();
                }
                self.look(moment);
            }
            std::thread::park_timeout(LOOK);
        }
    }

    /// Sends the newest command, if it is new.
    fn send(&mut self, moment: Moment) {
        if self.drives.update()
            && let Some(open) = &mut self.open
        {
            let drive = *self.drives.peek_output_buffer();
            let cdr = drive_cdr(moment.epoch_ns, &self.settings.base_frame, drive);
            open.drive.put(moment.epoch_ns, &cdr);
        }
    }

    fn connect(&self) -> Result<Open, String> {
        let mut link = Link::open(&self.settings, NODE)?;
        let topic = &self.settings.robot.drive;
        Ok(Open {
            drive: RosPublisher::declare(&mut link, topic, &self.drive)?,
            _heard: self.ears.subscribe(&mut link)?,
            link,
        })
    }

    fn look(&mut self, moment: Moment) {
        if let Some(by_s) = self.wall.look(moment) {
            tracing::warn!(
                "the wall clock has jumped by {by_s:+.3} s; messages with stamps of before are \
                 refused until it and the robot's agree"
            );
        }
        let is_there = self
            .open
            .as_ref()
            .is_some_and(|open| open.link.is_connected());
        if let Some(line) = self.connection.note(is_there, &self.settings.router) {
            tracing::info!("{line}");
        }
        self.ears.tell_silence(moment);
        self.ears.lay_route(moment);
    }
}
