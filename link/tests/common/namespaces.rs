//! Network namespaces of this machine, each as a machine of one network, 10.77.0.0/24.

#![allow(dead_code)] // each test program uses a part
#![allow(clippy::disallowed_methods)] // a test measures time

use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::sets::{Machine, Running, Stage};

/// Runs a command of the system.
///
/// # Errors
/// What it says when it fails.
pub fn run(words: &[&str]) -> Result<(), String> {
    let output = Command::new(words[0]).args(&words[1..]).output();
    let output = output.map_err(|error| format!("{}: {error}", words[0]))?;
    match output.status.success() {
        true => Ok(()),
        false => {
            let text = String::from_utf8_lossy(&output.stderr).trim().to_string();
            Err(format!("{}: {text}", words.join(" ")))
        }
    }
}

/// Prints why a test does not run here.
pub fn permitted<T>(made: Result<T, String>) -> Option<T> {
    made.inspect_err(|why| println!("skipped: networks that fail: {why}"))
        .ok()
}

/// The address of a namespace, counted from 0.
pub fn host(place: usize) -> String {
    format!("10.77.0.{}", place + 1)
}

/// Namespaces without a network.
pub struct Namespaces {
    /// Tells interfaces of several networks apart.
    tag: String,
    pub names: Vec<String>,
}

impl Namespaces {
    /// # Errors
    /// What this machine does not permit.
    pub fn new(count: usize) -> Result<Self, String> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let tag = format!("v{}{number}", std::process::id());
        let names = (0..count).map(|place| format!("{tag}n{place}")).collect();
        let spaces = Self { tag, names };
        for name in &spaces.names {
            run(&["ip", "netns", "add", name])?;
            run(&["ip", "-n", name, "link", "set", "lo", "up"])?;
        }
        Ok(spaces)
    }

    /// The name of an interface.
    pub fn interface(&self, place: usize) -> String {
        format!("{}{}", self.tag, char::from(b'a' + place as u8))
    }

    /// Runs `ip` in a namespace.
    ///
    /// # Errors
    /// What it says when it fails.
    pub fn ip(&self, place: usize, words: &str) -> Result<(), String> {
        let mut all = vec!["ip", "-n", &self.names[place]];
        all.extend(words.split(' '));
        run(&all)
    }

    /// Namespaces at one bridge, which is in a further one.
    ///
    /// # Errors
    /// What this machine does not permit.
    pub fn bridged(count: usize) -> Result<Self, String> {
        let spaces = Self::new(count + 1)?;
        let bridge = spaces.names[count].clone();
        spaces.ip(count, "link add bridge type bridge")?;
        spaces.ip(count, "link set bridge up")?;
        for place in 0..count {
            let (end, name, port) = (
                spaces.interface(place),
                spaces.names[place].clone(),
                format!("port{place}"),
            );
            let words =
                format!("ip link add {end} netns {name} type veth peer name {port} netns {bridge}");
            run(&words.split(' ').collect::<Vec<_>>())?;
            spaces.ip(count, &format!("link set {port} master bridge up"))?;
            spaces.set_up(place)?;
        }
        Ok(spaces)
    }

    /// Gives a namespace's interface its address.
    ///
    /// # Errors
    /// What this machine does not permit.
    pub fn set_up(&self, place: usize) -> Result<(), String> {
        let end = self.interface(place);
        self.ip(place, &format!("addr add {}/24 dev {end}", host(place)))?;
        self.ip(place, &format!("link set {end} up"))
    }

    /// The words that start a program there.
    pub fn machine(&self, place: usize) -> Machine {
        let words = ["ip", "netns", "exec", &self.names[place]];
        words.map(String::from).into()
    }

    /// A stage with its vehicle in one namespace and the other machine in another one.
    pub fn stage(&self, vehicle: usize, other: usize) -> Option<Stage> {
        let mut stage = Stage::new()?;
        stage.vehicle = self.machine(vehicle);
        stage.other = self.machine(other);
        stage.host = host(vehicle);
        Some(stage)
    }
}

impl Drop for Namespaces {
    fn drop(&mut self) {
        for name in &self.names {
            let _ = run(&["ip", "netns", "del", name]);
        }
    }
}

/// Two namespaces with a virtual cable.
pub struct Cable(pub Namespaces);

impl Cable {
    /// # Errors
    /// What this machine does not permit.
    pub fn new() -> Result<Self, String> {
        let spaces = Namespaces::new(2)?;
        let [a, b] = [&*spaces.names[0], &*spaces.names[1]];
        let (x, y) = (spaces.interface(0), spaces.interface(1));
        run(&[
            "ip", "link", "add", &x, "netns", a, "type", "veth", "peer", "name", &y, "netns", b,
        ])?;
        spaces.set_up(0)?;
        spaces.set_up(1)?;
        Ok(Self(spaces))
    }

    /// Takes the vehicle's end of the cable away, or puts it back.
    ///
    /// # Errors
    /// What `ip` says.
    pub fn set(&self, state: &str) -> Result<(), String> {
        let end = self.0.interface(0);
        self.0.ip(0, &format!("link set {end} {state}"))
    }

    /// Limits what each end sends, such as to `1gbit`.
    ///
    /// # Errors
    /// When this kernel has no token bucket filter.
    pub fn shape(&self, rate: &str) -> Result<(), String> {
        for (place, name) in self.0.names.iter().enumerate() {
            let end = self.0.interface(place);
            let words = format!(
                "tc -n {name} qdisc replace dev {end} root tbf rate {rate} burst 128kb latency 50ms"
            );
            run(&words.split(' ').collect::<Vec<_>>())?;
        }
        Ok(())
    }

    /// Bytes that an end of the cable has sent.
    pub fn sent_bytes(&self, place: usize) -> u64 {
        let (name, end) = (&self.0.names[place], self.0.interface(place));
        let output = Command::new("ip")
            .args(["-n", name, "-s", "-j", "link", "show", "dev", &end])
            .output()
            .expect("ip");
        let shown: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let bytes = &shown[0]["stats64"]["tx"]["bytes"];
        bytes.as_u64().expect("a count")
    }
}

/// Now, s since 1970.
pub fn epoch_s() -> f64 {
    let since = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .expect("a date");
    since.as_secs_f64()
}

/// The instants of the lines of a log that contain these words, s since 1970.
pub fn instants(log: &str, words: &str) -> Vec<f64> {
    let lines = log.lines().filter(|line| line.contains(words));
    lines
        .filter_map(|line| {
            let stamp = line.split_whitespace().next()?;
            let output = Command::new("date")
                .args(["-d", stamp, "+%s.%N"])
                .output()
                .ok()?;
            String::from_utf8_lossy(&output.stdout).trim().parse().ok()
        })
        .collect()
}

/// When each session of the other machine began, s since 1970.
pub fn joined_at(join: &Running) -> Vec<f64> {
    instants(&join.text(), " joined vehicle=")
}
