//! A run, read from outside, as ROS topics.
//!
//! It reads as one reader more, as `./vlaps record` does: it has no priority, rings no bell,
//! publishes nothing into the run, and no process of the run waits for it or for the network.
//!
//! | topic | type | when |
//! |---|---|---|
//! | `/vlaps/step`, `/vlaps/health/world`, ... | `vlaps_msgs/msg/Step`, ... | each message of each recorded service, byte by byte |
//! | `/vlaps/drive` | `ackermann_msgs/msg/AckermannDriveStamped` | at each step |
//! | `/vlaps/path` | `nav_msgs/msg/Path` | at most 20 Hz |
//! | `/vlaps/pose`, `/vlaps/scan`, `/vlaps/scene` | `PoseStamped`, `LaserScan`, `MarkerArray` | at most 20 Hz |
//! | `/vlaps/tree` | `MarkerArray` | each second |
//! | `/vlaps/picture` | `CompressedImage` | each picture for a judge |
//! | `/tf` | `tf2_msgs/msg/TFMessage` | at most 20 Hz, with `publish_tf` |
//! | `/diagnostics` | `diagnostic_msgs/msg/DiagnosticArray` | each second |
//!
//! A message is made and sent only while something subscribes to its topic.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use recorder::schema::ENCAPSULATION;
use recorder::standard::{Frames, Standard, Topic, Wanted, drive_cdr};
use recorder::taps::{self, Tap};
use shm_config::Message as _;
use shm_config::config::{self, Config};
use shm_config::layout::Layout as _;
use shm_config::message::Step;
use shm_config::run::{RunName, RunPaths};
use shm_config::services::{Process, STEP};
use shm_config::wire::Wire;

use crate::names::TopicType;
use crate::publisher::RosPublisher;
use crate::session::{Connection, Link};
use crate::setpoint::Setpoint;
use crate::settings::Settings;
use crate::wall::{Moment, Wall};

/// Time between two reads: at 1,000 Hz five messages, of the 64 that a reader may be behind.
const TURN: Duration = Duration::from_millis(5);
/// Reads between two looks at router, clocks and supervisor, and between two attempts to
/// connect: a second.
const LOOK_TURNS: u64 = 200;
/// Reads between two looks at which standard topics something subscribes to: 20 Hz, as often
/// as they are made.
const ASK_TURNS: u64 = 10;
/// As often as the live page.
const STANDARD_HZ: f64 = 20.0;
/// The node's name.
const NODE: &str = "vlaps";

/// What was sent until the end.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sent {
    /// Messages that the session took.
    pub messages: u64,
    /// Messages that it refused.
    pub refused: u64,
}

/// Publishes a running set until it ends or `stop` is set. Nothing waits for a router: one
/// that comes later gets what is published then.
///
/// # Errors
/// One line: no such set runs, it is of another build, or the settings are wrong.
pub fn run(name: &RunName, settings: &Settings, stop: &AtomicBool) -> Result<Sent, String> {
    let paths = RunPaths::new(name.clone());
    let Some(supervisor) = paths.supervisor_pid() else {
        return Err(format!(
            "run '{name}' is not running; `./vlaps status` shows what runs"
        ));
    };
    let config = config::load(&paths.config_file()).map_err(|error| error.to_string())?;
    let wire = Wire::join(name, Process::Recorder).map_err(|error| error.to_string())?;
    wire.follow(supervisor).map_err(|error| error.to_string())?;
    let mut taps = taps::open(&wire).map_err(|error| error.to_string())?;
    let mut bridge = Bridge::new(&config, settings, &taps)?;
    for turn in 0_u64.. {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        if turn.is_multiple_of(LOOK_TURNS) {
            if paths.supervisor_pid() != Some(supervisor) {
                break;
            }
            bridge.look(Moment::now());
        }
        if turn.is_multiple_of(ASK_TURNS) {
            bridge.ask();
        }
        bridge.turn(&mut taps, Moment::now());
        std::thread::park_timeout(TURN);
    }
    Ok(bridge.sent)
}

struct Bridge {
    config: Config,
    settings: Settings,
    wall: Wall,
    connection: Connection,
    standard: Standard,
    setpoint: Setpoint,
    /// Name and type of the topic of each tap, and that of the drive.
    own: Vec<(String, TopicType)>,
    drive: TopicType,
    topics: Option<Topics>,
    step: Box<Step>,
    /// Producer, episode and number of the step that the set point was last moved by.
    driven: Option<(u32, u32, u64)>,
    cdr: Vec<u8>,
    sent: Sent,
}

/// What is declared in a session.
struct Topics {
    link: Link,
    own: Vec<RosPublisher>,
    drive: RosPublisher,
    standard: BTreeMap<Topic, RosPublisher>,
}

impl Bridge {
    fn new(config: &Config, settings: &Settings, taps: &[Box<dyn Tap>]) -> Result<Self, String> {
        let prefix = &settings.prefix;
        let own = taps.iter().map(|tap| {
            let channel = tap.channel();
            let topic = format!("{prefix}/{}", channel.service);
            Ok((topic, TopicType::of(channel)?))
        });
        let moment = Moment::now();
        // In lockstep the run's clock begins at 0.
        let offset_ns = match config.run.is_lockstep() {
            true => moment.epoch_ns,
            false => moment.offset_ns(),
        };
        let mut standard = Standard::new(config, offset_ns, STANDARD_HZ);
        standard.set_frames(Frames {
            world: settings.world_frame.clone().into(),
            body: settings.base_frame.clone().into(),
        });
        // Until it is asked what something subscribes to.
        standard.set_wanted(Wanted::NONE);
        Ok(Self {
            standard,
            wall: Wall::new(moment),
            connection: Connection::default(),
            setpoint: Setpoint::new(config.vehicle),
            own: own.collect::<Result<_, String>>()?,
            drive: TopicType::standard("ackermann_msgs/AckermannDriveStamped")?,
            topics: None,
            step: Box::default(),
            driven: None,
            cdr: Vec::new(),
            sent: Sent::default(),
            config: config.clone(),
            settings: settings.clone(),
        })
    }

    /// Looks at what changes seldom.
    fn look(&mut self, moment: Moment) {
        self.follow_clock(moment);
        let opened = match &self.topics {
            Some(topics) => Ok(topics.link.is_connected()),
            None => self.open().map(|()| true),
        };
        let router = &self.settings.router;
        if let Some(line) = self.connection.note(opened == Ok(true), router) {
            tracing::info!("{line}");
        }
    }

    /// Stamps follow every step of the wall clock; only a large one is told.
    fn follow_clock(&mut self, moment: Moment) {
        if let Some(by_s) = self.wall.look(moment) {
            tracing::warn!("the wall clock has jumped by {by_s:+.3} s; stamps follow it");
        }
        if !self.config.run.is_lockstep() {
            self.standard.set_epoch_offset(self.wall.offset_ns());
        }
    }

    /// Asks which standard topics something subscribes to: only those are made.
    fn ask(&mut self) {
        let topics = self.topics.as_ref().map(|topics| &topics.standard);
        self.standard.set_wanted(Wanted::of(|topic| {
            let publisher = topics.and_then(|standard| standard.get(&topic));
            publisher.is_some_and(RosPublisher::is_wanted)
        }));
    }

    fn open(&mut self) -> Result<(), String> {
        let mut link = Link::open(&self.settings, NODE)?;
        let declared = self.own.iter();
        let declared = declared.map(|(topic, of)| RosPublisher::declare(&mut link, topic, of));
        let own = declared.collect::<Result<_, _>>()?;
        let prefix = &self.settings.prefix;
        let drive = RosPublisher::declare(&mut link, &format!("{prefix}/drive"), &self.drive)?;
        let mut standard = BTreeMap::new();
        for topic in Topic::ALL {
            let Some(name) = self.name_of(topic) else {
                continue;
            };
            let of = TopicType::of(&topic.channel())?;
            standard.insert(topic, RosPublisher::declare(&mut link, &name, &of)?);
        }
        self.topics = Some(Topics {
            link,
            own,
            drive,
            standard,
        });
        Ok(())
    }

    /// The name of a standard topic in ROS; `None` for one that is not published.
    fn name_of(&self, topic: Topic) -> Option<String> {
        let prefix = &self.settings.prefix;
        match topic {
            Topic::Transform => self.settings.publish_tf.then(|| "/tf".into()),
            Topic::Diagnostics => Some("/diagnostics".into()),
            Topic::Plan => Some(format!("{prefix}/path")),
            Topic::Pose => Some(format!("{prefix}/pose")),
            Topic::Scan => Some(format!("{prefix}/scan")),
            Topic::Scene => Some(format!("{prefix}/scene")),
            Topic::Tree => Some(format!("{prefix}/tree")),
            Topic::Picture => Some(format!("{prefix}/picture")),
        }
    }

    /// Passes on all messages that wait.
    fn turn(&mut self, taps: &mut [Box<dyn Tap>], moment: Moment) {
        for (number, tap) in taps.iter_mut().enumerate() {
            tap.update_connections();
            let service = tap.channel().service.clone();
            tap.drain(&mut |header, memory, _| {
                self.pass_on(number, (&service, header.taken_ns), memory, moment);
            });
        }
    }

    fn pass_on(
        &mut self,
        number: usize,
        (service, taken_ns): (&str, u64),
        memory: &[u8],
        moment: Moment,
    ) {
        // Without a router nothing is read of it, and nothing is made.
        let Some(topics) = &mut self.topics else {
            return;
        };
        let sent = &mut self.sent;
        let mut put =
            |publisher: &mut RosPublisher, cdr: &[u8]| match publisher.put(moment.epoch_ns, cdr) {
                true => sent.messages += 1,
                false => sent.refused += 1,
            };
        let own = &mut topics.own[number];
        if own.is_wanted() {
            self.cdr.clear();
            self.cdr.extend_from_slice(&ENCAPSULATION);
            self.cdr.extend_from_slice(memory);
            put(own, &self.cdr);
        }
        let standard = &mut topics.standard;
        self.standard
            .message((service, taken_ns), memory, &mut |topic, cdr| {
                if let Some(publisher) = standard.get_mut(&topic) {
                    put(publisher, cdr);
                }
            });
        if service != STEP.name {
            return;
        }
        if !topics.drive.is_wanted() {
            // A later subscriber gets the speed of that time.
            self.driven = None;
        } else if self.step.copy_from(memory) && self.step.check().is_ok() {
            let header = &self.step.header;
            let own = (header.producer, header.episode, header.sequence);
            let before = self.driven.replace(own);
            if before.is_none_or(|(producer, episode, sequence)| {
                (producer, episode, sequence + 1) != own
            }) {
                self.setpoint.forget();
            }
            let speed_mps = self.step.observation.ego.speed_mps;
            let period_s = self.config.run.period_ns() as f64 * 1e-9;
            let action = self.step.command.action();
            let drive = self.setpoint.drive(action, speed_mps, period_s);
            let cdr = drive_cdr(moment.epoch_ns, &self.settings.base_frame, drive);
            put(&mut topics.drive, &cdr);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Receiver, channel};

    use recorder::Channel;
    use shm_config::Instant;
    use zenoh::{Session, Wait};

    use super::*;

    /// What does not happen within this time never does.
    const LOST: Duration = Duration::from_secs(30);

    /// A bridge to a router in this process, which has no subscriber yet.
    fn connected() -> (Bridge, Session) {
        let free = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = format!("tcp/{}", free.local_addr().expect("its address"));
        drop(free);
        let mut config = zenoh::Config::default();
        for (key, value) in [
            ("mode", "\"router\"".to_string()),
            ("listen/endpoints", format!("[{address:?}]")),
            ("scouting/multicast/enabled", "false".into()),
        ] {
            config.insert_json5(key, &value).expect(key);
        }
        let router = zenoh::open(config).wait().expect("a router");
        let settings = Settings {
            router: address,
            ..Settings::default()
        };
        let mut bridge = bridge(&settings);
        bridge.open().expect("the router is there");
        (bridge, router)
    }

    /// A bridge that has steps to pass on.
    fn bridge(settings: &Settings) -> Bridge {
        let mut bridge = Bridge::new(&Config::default(), settings, &[]).expect("a bridge");
        let of = TopicType::of(&Channel::named("step").expect("a channel"));
        bridge.own.push(("/vlaps/step".into(), of.expect("a type")));
        bridge
    }

    fn hear(router: &Session, key: &str) -> Receiver<Vec<u8>> {
        let (into, out) = channel();
        router
            .declare_subscriber(key.to_string())
            .callback(move |sample| drop(into.send(sample.payload().to_bytes().into_owned())))
            .background()
            .wait()
            .expect("a subscription");
        out
    }

    /// Waits until the bridge knows of a subscriber.
    fn until(mut holds: impl FnMut() -> bool) {
        let begun = Moment::now().now;
        while !holds() {
            let waited_ns = Moment::now().now.since_ns(begun);
            assert!(u128::from(waited_ns) < LOST.as_nanos(), "never subscribed");
            std::thread::park_timeout(Duration::from_millis(5));
        }
    }

    /// A step of a car that cruises.
    fn step(sequence: u64) -> Box<Step> {
        let mut step = Box::new(Step::default());
        step.header.sequence = sequence;
        step.header.taken_ns = sequence * 100_000_000;
        step.observation.ego.speed_mps = 10.0;
        step.command.pedal = 0.0;
        (step.observation_age_ns, step.plan_age_ns) = (0, 0);
        step
    }

    fn pass_on(bridge: &mut Bridge, step: &Step) {
        let of = (STEP.name, step.header.taken_ns);
        bridge.pass_on(0, of, step.as_bytes(), Moment::now());
    }

    #[test]
    fn a_drive_that_is_subscribed_to_later_goes_on_from_the_measured_speed() {
        let (mut bridge, router) = connected();
        for sequence in 1..50 {
            pass_on(&mut bridge, &step(sequence));
        }
        assert_eq!(bridge.sent, Sent::default());
        let heard = hear(&router, "0/vlaps/drive/*/*");
        until(|| {
            let topics = bridge.topics.as_ref();
            topics.is_some_and(|topics| topics.drive.is_wanted())
        });
        // After steps that were lost, too, in which the car was accelerated by others.
        for (sequence, speed_mps) in [(50, 10.0_f32), (51, 10.0), (90, 12.0)] {
            let mut step = step(sequence);
            step.observation.ego.speed_mps = f64::from(speed_mps);
            pass_on(&mut bridge, &step);
            let cdr = heard.recv_timeout(LOST).expect("a drive");
            let speed = cdr[cdr.len() - 12..][..4].try_into().expect("four bytes");
            assert_eq!(f32::from_le_bytes(speed), speed_mps, "step {sequence}");
        }
    }

    #[test]
    fn what_nothing_subscribes_to_is_not_made() {
        let (mut bridge, router) = connected();
        bridge.ask();
        let made = |bridge: &mut Bridge, step: &Step| {
            let (mut made, of) = (Vec::new(), (STEP.name, step.header.taken_ns));
            let mut take = |topic, _: &[u8]| made.push(topic);
            bridge.standard.message(of, step.as_bytes(), &mut take);
            made
        };
        assert_eq!(made(&mut bridge, &step(1)), []);
        let heard = hear(&router, "0/vlaps/pose/*/*");
        until(|| {
            bridge.ask();
            !made(&mut bridge, &step(2)).is_empty()
        });
        assert_eq!(made(&mut bridge, &step(30)), [Topic::Pose]);
        pass_on(&mut bridge, &step(60));
        assert!(heard.recv_timeout(LOST).is_ok());
        assert_eq!(bridge.sent.messages, 1);
    }

    #[test]
    fn stamps_follow_small_steps_of_the_wall_clock() {
        let mut bridge = bridge(&Settings::default());
        let begun = Moment {
            now: Instant(1_000_000_000),
            epoch_ns: 1_700_000_000_000_000_000,
        };
        bridge.wall = Wall::new(begun);
        bridge.standard.set_wanted(Wanted::ALL);
        let stamp_ns = |bridge: &mut Bridge, tick: u64| {
            let mut step = step(tick * 10);
            step.observation.header.taken_ns = tick * 1_000_000_000;
            let (mut stamp_ns, of) = (None, (STEP.name, step.header.taken_ns));
            bridge
                .standard
                .message(of, step.as_bytes(), &mut |topic, cdr| {
                    if topic == Topic::Pose {
                        let word = |at: usize| cdr[at..at + 4].try_into().expect("four bytes");
                        let (s, ns) = (u32::from_le_bytes(word(4)), u32::from_le_bytes(word(8)));
                        stamp_ns = Some(u64::from(s) * 1_000_000_000 + u64::from(ns));
                    }
                });
            stamp_ns.expect("a pose")
        };
        // 5 ms each second: no step of it is a jump.
        for second in 1..=20 {
            bridge.follow_clock(Moment {
                now: begun.now.after_ns(second * 1_000_000_000),
                epoch_ns: begun.epoch_ns + second * 1_005_000_000,
            });
            let expected_ns = begun.epoch_ns + second * 1_005_000_000;
            assert_eq!(stamp_ns(&mut bridge, 1 + second), expected_ns);
        }
    }
}
