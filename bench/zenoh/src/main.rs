//! Back and forth over Zenoh, as `vlaps bench ipc` does it over shared memory.
//!
//! `vlaps-zenoh BYTES spin|bell PERIOD_NS WARM COUNT CORE_PING CORE_ECHO`
//!
//! Starts the process that answers, and prints half of each counted round trip, ns,
//! a line each. Cores below 0 are none. Both ends take the newest of a ring of one,
//! unbatched, dropped when congested: what the stack's `latest value wins` is here.

use std::error::Error;
use std::hint::black_box;
use std::net::TcpListener;
use std::process::{Child, Command, ExitCode};
use std::time::{Duration, Instant};

use rustix::process::{Signal, set_parent_process_death_signal};
use rustix::thread::{ClockId, CpuSet, Timespec, clock_nanosleep_absolute, sched_setaffinity};
use rustix::time::clock_gettime;
use zenoh::handlers::{RingChannel, RingChannelHandler};
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::CongestionControl;
use zenoh::sample::Sample;
use zenoh::{Config, Session, Wait};

type Result<T> = std::result::Result<T, Box<dyn Error + Send + Sync>>;

/// A message that does not come within this is lost.
const LOST: Duration = Duration::from_secs(5);
/// Until both have found each other, a message is tried this often.
const GREETING: Duration = Duration::from_millis(20);
/// The key of what the ping sends, and of the answers.
const KEYS: [&str; 2] = ["vlaps/there", "vlaps/back"];
/// The last word of the process that answers: where it listens.
const ECHO: &str = "echo=";

struct Words {
    bytes: usize,
    sleeps: bool,
    period_ns: u64,
    warm: u64,
    count: u64,
    cores: [i32; 2],
    /// Of the process that answers.
    endpoint: Option<String>,
}

fn main() -> ExitCode {
    let all: Vec<String> = std::env::args().skip(1).collect();
    let Some(words) = Words::read(&all) else {
        eprintln!("vlaps-zenoh BYTES spin|bell PERIOD_NS WARM COUNT CORE_PING CORE_ECHO");
        return ExitCode::from(2);
    };
    let done = match &words.endpoint {
        Some(endpoint) => echo(&words, endpoint),
        None => ping(&words, &all),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("vlaps-zenoh: {error}");
            ExitCode::FAILURE
        }
    }
}

impl Words {
    fn read(all: &[String]) -> Option<Words> {
        let (seven, rest) = all.split_at_checked(7)?;
        let endpoint = match rest {
            [] => None,
            [word] => Some(word.strip_prefix(ECHO)?.to_string()),
            _ => return None,
        };
        Some(Words {
            bytes: seven[0].parse().ok()?,
            sleeps: match seven[1].as_str() {
                "spin" => false,
                "bell" => true,
                _ => return None,
            },
            period_ns: seven[2].parse().ok()?,
            warm: seven[3].parse().ok()?,
            count: seven[4].parse().ok()?,
            cores: [seven[5].parse().ok()?, seven[6].parse().ok()?],
            endpoint,
        })
    }
}

/// One of the two participants.
struct End {
    publisher: Publisher<'static>,
    subscriber: Subscriber<RingChannelHandler<Sample>>,
    sleeps: bool,
    bytes: Vec<u8>,
    _session: Session,
}

impl End {
    /// Peers that know of each other's address and look for no other: nothing of
    /// a measurement leaves the machine.
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

    /// The newest message, copied out; `false` when none comes within that time.
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

fn echo(words: &Words, endpoint: &str) -> Result<()> {
    set_parent_process_death_signal(Some(Signal::KILL))?;
    stay_on(words.cores[1])?;
    let mut end = End::open(words, false, ("listen/endpoints", endpoint))?;
    // Greetings are answered, too; the other one ends this process.
    loop {
        if end.take(LOST)? {
            end.send()?;
        }
    }
}

fn ping(words: &Words, all: &[String]) -> Result<()> {
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

/// Until an answer comes; then all that is still on its way.
fn greet(end: &mut End, child: &mut Answering) -> Result<()> {
    let until = Instant::now() + 2 * LOST;
    loop {
        end.send()?;
        if end.take(GREETING)? {
            break;
        }
        if let Some(status) = child.0.try_wait()? {
            return Err(format!("the process that answers has ended: {status}").into());
        }
        if Instant::now() > until {
            return Err("the two participants do not find each other".into());
        }
    }
    while end.take(5 * GREETING)? {}
    Ok(())
}

/// Ends with its owner.
struct Answering(Child);

impl Drop for Answering {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Zenoh's own threads inherit it.
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
