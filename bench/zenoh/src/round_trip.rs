//! The two participants, and the round trips between them.

use std::error::Error;
use std::hint::black_box;
use std::net::TcpListener;
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use rustix::process::{Signal, set_parent_process_death_signal};
use rustix::thread::{ClockId, CpuSet, Timespec, clock_nanosleep_absolute, sched_setaffinity};
use rustix::time::clock_gettime;
use zenoh::handlers::{RingChannel, RingChannelHandler};
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::CongestionControl;
use zenoh::sample::Sample;
use zenoh::{Config, Session, Wait};

use crate::words::{ECHO, Words};

/// What can fail: the session, a socket, a child process.
pub type Result<T> = std::result::Result<T, Box<dyn Error + Send + Sync>>;

/// A message counts as lost after this time.
const LOST: Duration = Duration::from_secs(5);
/// Interval of the messages until both participants have found each other.
const GREETING: Duration = Duration::from_millis(20);
/// The key of the questions, and that of the answers.
const KEYS: [&str; 2] = ["vlaps/there", "vlaps/back"];

/// One of the two participants.
struct End {
    publisher: Publisher<'static>,
    subscriber: Subscriber<RingChannelHandler<Sample>>,
    sleeps: bool,
    bytes: Vec<u8>,
    _session: Session,
}

impl End {
    /// Peers that know each other's address and do not search for others: no message leaves
    /// the machine.
    fn open(words: &Words, is_ping: bool, (verb, endpoint): (&str, &str)) -> Result<End> {
        let mut config = Config::default();
        let endpoints = format!("[\"{endpoint}\"]");
        let mut settings = vec![
            ("mode", "\"peer\""),
            ("scouting/multicast/enabled", "false"),
            ("scouting/gossip/enabled", "false"),
            (verb, endpoints.as_str()),
        ];
        if is_ping {
            settings.push(("listen/endpoints", "[]"));
        }
        for (key, value) in settings {
            config.insert_json5(key, value)?;
        }
        let session = zenoh::open(config).wait()?;
        let [there, back] = KEYS;
        let (to, from) = if is_ping { (there, back) } else { (back, there) };
        Ok(End {
            publisher: session
                .declare_publisher(to)
                .congestion_control(CongestionControl::Drop)
                .express(true)
                .wait()?,
            subscriber: session
                .declare_subscriber(from)
                .with(RingChannel::new(1))
                .wait()?,
            sleeps: words.sleeps,
            bytes: vec![0; words.bytes],
            _session: session,
        })
    }

    fn send(&self) -> Result<()> {
        self.publisher.put(self.bytes.as_slice()).wait()
    }

    /// Copies out the newest message; `false` if none arrives within the time limit.
    fn take(&mut self, patience: Duration) -> Result<bool> {
        let until = Instant::now() + patience;
        let mut looks = 0_u64;
        let sample = loop {
            looks += 1;
            let found = match self.sleeps {
                true => self.subscriber.recv_timeout(patience)?,
                false => self.subscriber.try_recv()?,
            };
            if let Some(sample) = found {
                break sample;
            }
            if (self.sleeps || looks.is_multiple_of(4096)) && Instant::now() > until {
                return Ok(false);
            }
        };
        let payload = sample.payload().to_bytes();
        self.bytes.clear();
        self.bytes.extend_from_slice(&payload);
        black_box(&self.bytes);
        Ok(true)
    }

    fn await_message(&mut self) -> Result<()> {
        match self.take(LOST)? {
            true => Ok(()),
            false => Err("a message did not come within 5 s".into()),
        }
    }
}

/// Answers every message until this process is killed.
///
/// # Errors
/// When the session cannot be opened or breaks.
pub fn echo(words: &Words, endpoint: &str) -> Result<()> {
    set_parent_process_death_signal(Some(Signal::KILL))?;
    stay_on(words.cores[1])?;
    let mut end = End::open(words, false, ("listen/endpoints", endpoint))?;
    // Greetings are answered, too; the asking process ends this one.
    loop {
        if end.take(LOST)? {
            end.send()?;
        }
    }
}

/// Starts the answering process, measures, and prints half of each counted round trip, ns.
///
/// # Errors
/// When the answering process ends, or a message does not come.
pub fn ping(words: &Words, all: &[String]) -> Result<()> {
    let endpoint = {
        let free = TcpListener::bind("127.0.0.1:0")?;
        format!("tcp/{}", free.local_addr()?)
    };
    let mut child = Answering(
        Command::new(std::env::current_exe()?)
            .args(all)
            .arg(format!("{ECHO}{endpoint}"))
            .spawn()?,
    );
    stay_on(words.cores[0])?;
    let mut end = End::open(words, true, ("connect/endpoints", &endpoint))?;
    greet(&mut end, &mut child)?;
    let mut half_ns = Vec::with_capacity(words.count as usize);
    let begun_ns = now_ns();
    for k in 0..words.warm + words.count {
        if words.period_ns > 0 {
            sleep_until(begun_ns + k * words.period_ns);
        }
        let sent_ns = now_ns();
        end.send()?;
        end.await_message()?;
        if k >= words.warm {
            half_ns.push((now_ns() - sent_ns) / 2);
        }
    }
    for ns in half_ns {
        println!("{ns}");
    }
    Ok(())
}

/// Sends until an answer arrives, then discards the remaining answers.
fn greet(end: &mut End, child: &mut Answering) -> Result<()> {
    let until = Instant::now() + 2 * LOST;
    loop {
        end.send()?;
        if end.take(GREETING)? {
            break;
        }
        if let Some(status) = child.0.try_wait()? {
            return Err(format!("the answering process has ended: {status}").into());
        }
        if Instant::now() > until {
            return Err("the two participants do not find each other".into());
        }
    }
    while end.take(5 * GREETING)? {}
    Ok(())
}

/// The answering process; killed when this value is dropped.
struct Answering(Child);

impl Drop for Answering {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Pins this thread; Zenoh's own threads inherit it.
fn stay_on(core: i32) -> Result<()> {
    if let Ok(core) = usize::try_from(core) {
        let mut cores = CpuSet::new();
        cores.set(core);
        sched_setaffinity(None, &cores)?;
    }
    Ok(())
}

fn now_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

fn sleep_until(instant_ns: u64) {
    let until = Timespec {
        tv_sec: (instant_ns / 1_000_000_000) as i64,
        tv_nsec: (instant_ns % 1_000_000_000) as i64,
    };
    while clock_nanosleep_absolute(ClockId::Monotonic, &until).is_err() {}
}
