//! Stands in for what runs beside the bridge where there is no ROS: a Zenoh router, and on
//! request a robot, a reader of everything, and a flood of foreign messages.
//!
//! `stand_in tcp/127.0.0.1:7447 [robot] [subscribe] [flood=10000]`
//!
//! The robot is a car of the default size on a ring of 40 m between two walls. It publishes
//! `/scan`, `/odom`, `/tf` and `/plan`, obeys `/drive`, and brakes when no command comes for a
//! quarter of a second: what a robot of yours has to do. Every 10 s, and when it ends by
//! SIGTERM or Ctrl-C, a line says what was sent and heard.

#[path = "stand_in/car.rs"]
mod car;

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use vlaps_ros::names::TopicType;
use vlaps_ros::wall::Moment;
use zenoh::{Config, Session, Wait};

type Failure = Box<dyn std::error::Error + Send + Sync>;

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let Some((address, roles)) = words.split_first() else {
        eprintln!("stand_in tcp/127.0.0.1:7447 [robot] [subscribe] [flood=10000]");
        return ExitCode::from(2);
    };
    match play(address, roles) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("stand_in: {error}");
            ExitCode::FAILURE
        }
    }
}

fn play(address: &str, roles: &[String]) -> Result<(), Failure> {
    let router = router(address)?;
    let mut robot = None;
    let mut flood_hz = 0;
    let heard = Arc::new(AtomicU64::new(0));
    for role in roles {
        match (role.as_str(), role.strip_prefix("flood=")) {
            ("robot", _) => robot = Some(car::Car::new(router.clone())?),
            ("subscribe", _) => subscribe(&router, heard.clone())?,
            (_, Some(rate)) => flood_hz = rate.parse::<u64>()?,
            _ => return Err(format!("{role}: no such role").into()),
        }
    }
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        signal_hook::flag::register(signal, stop.clone())?;
    }
    // On a grid of 5 ms: the robot's sensors at each tenth, the flood in equal parts.
    let begun = Moment::now().now;
    let mut flood = Flood::new(&router)?;
    for tick in 1_u64.. {
        let now = Moment::now();
        if let Some(robot) = &mut robot {
            robot.advance(now, 0.005)?;
        }
        flood.send_up_to(tick * flood_hz / 200)?;
        let next_ns = tick * 5_000_000;
        let left_ns = next_ns.saturating_sub(Moment::now().now.since_ns(begun));
        std::thread::park_timeout(Duration::from_nanos(left_ns));
        let is_last = stop.load(Ordering::Relaxed);
        if is_last || tick.is_multiple_of(2_000) {
            let (sent, heard) = (flood.sent, heard.load(Ordering::Relaxed));
            let seconds = tick as f64 / 200.0;
            // The benchmark of a flood reads this line.
            println!("{seconds:.1} s: {sent} foreign messages sent, {heard} others heard");
        }
        if is_last {
            break;
        }
    }
    Ok(())
}

/// A router on this machine, as rmw_zenoh's.
fn router(address: &str) -> Result<Session, Failure> {
    let mut config = Config::default();
    config.insert_json5("mode", "\"router\"")?;
    config.insert_json5("listen/endpoints", &format!("[{address:?}]"))?;
    config.insert_json5("scouting/multicast/enabled", "false")?;
    zenoh::open(config).wait()
}

/// Reads every topic of the domain, and counts what has an attachment as rmw_zenoh's messages
/// have: that of the bridge and of a world, but not of this program.
fn subscribe(router: &Session, heard: Arc<AtomicU64>) -> Result<(), Failure> {
    router
        .declare_subscriber("0/**")
        .callback(move |sample| {
            if sample.attachment().is_some() {
                heard.fetch_add(1, Ordering::Relaxed);
            }
        })
        .background()
        .wait()?;
    Ok(())
}

/// Messages that are not the robot's: of another type on its topic, of no form at all, and on
/// the names of the bridge's own topics.
struct Flood {
    router: Session,
    keys: [String; 4],
    sent: u64,
}

impl Flood {
    fn new(router: &Session) -> Result<Self, Failure> {
        let scan = TopicType::standard("sensor_msgs/LaserScan")?;
        let path = TopicType::standard("nav_msgs/Path")?;
        Ok(Self {
            router: router.clone(),
            keys: [
                format!("0/scan/{}/{}", path.dds_name(), path.hash),
                format!("0/scan/{}/{}", scan.dds_name(), scan.hash),
                format!("0/foreign/{}/{}", scan.dds_name(), scan.hash),
                format!("0/vlaps/step/{}/{}", path.dds_name(), path.hash),
            ],
            sent: 0,
        })
    }

    fn send_up_to(&mut self, count: u64) -> Result<(), Failure> {
        while self.sent < count {
            let key = &self.keys[(self.sent % 4) as usize];
            let bytes = [0x5a; 512];
            self.router.put(key, bytes.as_slice()).wait()?;
            self.sent += 1;
        }
        Ok(())
    }
}
