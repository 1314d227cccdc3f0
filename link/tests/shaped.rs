//! Policies over a cable of limited rate between two namespaces: their size and their time on
//! 1 Gbit/s, and a cut in the middle of one.

#[path = "common/namespaces.rs"]
mod namespaces;
#[path = "common/sets.rs"]
mod sets;

use std::time::Duration;

use namespaces::{Cable, instants, permitted};
use sets::{Running, Stage, count, is_joined, wait_for};

/// The message that holds a policy in shared memory, bytes.
const MESSAGE_BYTES: u64 = 8 << 20;

/// A vehicle with its learner at the other end of a cable.
struct Rig {
    stage: Stage,
    cable: Cable,
    address: String,
    bundle: String,
}

impl Rig {
    fn new(rate: &str) -> Option<Self> {
        let cable = permitted(Cable::new().and_then(|cable| cable.shape(rate).map(|()| cable)))?;
        let stage = cable.0.stage(0, 1)?;
        let address = stage.address();
        let bundle = stage.invite("learner", &address, "learner.bundle");
        Some(Self {
            stage,
            cable,
            address,
            bundle,
        })
    }

    /// Drives; the learner makes a policy of each block of so many steps.
    fn up(&self, duration_s: u32, block_steps: u32) -> Running {
        let duration = duration_s.to_string();
        let words = format!(
            "--gate policy --duration {duration} --learner {} --set learner.algorithm=dagger \
             --set learner.updates=20 --set learner.block_steps={block_steps}",
            self.address
        );
        self.stage.up(&words.split_whitespace().collect::<Vec<_>>())
    }

    fn policies(&self) -> u64 {
        count(
            &self.stage.vehicle_report("learner"),
            "weights",
            "received",
            "messages",
        )
    }

    fn log(&self, run: &str, name: &str) -> String {
        let path = self.stage.path(&format!("runs/{run}/logs/{name}.log"));
        std::fs::read_to_string(path).unwrap_or_default()
    }

    /// When the learner had made each policy, s since 1970. It publishes each at once.
    fn made_s(&self) -> Vec<f64> {
        instants(&self.log(&self.stage.other_run(), "learner"), " block ")
    }

    /// When the controller had adopted policy `version`, s since 1970.
    fn adopted_s(&self, version: usize) -> Option<f64> {
        let words = format!(" weights adopted version={version} ");
        let log = self.log(&self.stage.run(), "controller");
        instants(&log, &words).first().copied()
    }

    /// The bytes of each policy file that the vehicle has taken.
    fn file_bytes(&self) -> Vec<u64> {
        let log = self.log(&self.stage.run(), "learner");
        let lines = log
            .lines()
            .filter(|line| line.contains(" a policy, signed"));
        let bytes = lines.filter_map(|line| line.split("bytes=").nth(1)?.split(' ').next());
        bytes.filter_map(|text| text.parse().ok()).collect()
    }
}

/// The file of half a megabyte passes and not the message of eight, and the controller has it
/// within a second.
#[test]
fn a_swap_over_one_gigabit_takes_less_than_a_second() {
    let Some(rig) = Rig::new("1gbit") else { return };
    let mut up = rig.up(60, 50);
    let mut join = rig.stage.join(&rig.bundle);
    wait_for("steps", || is_joined(&rig.stage.vehicle_report("learner")));
    let before = rig.cable.sent_bytes(1);
    wait_for("policies", || rig.policies() >= 6);
    let passed = rig.cable.sent_bytes(1) - before;
    assert_eq!(up.wait(), Some(0), "{}", up.text());
    join.end();
    let file = rig.file_bytes();
    let largest = file.iter().copied().max().expect("a policy");
    let each = passed / 6;
    println!(
        "the learner's end of the cable sent {passed} bytes for 6 policies, {each} for each; a \
         file has {largest}, the message {MESSAGE_BYTES}"
    );
    assert!(largest < 1 << 20 && each < 2 * largest, "{each}, {largest}");
    let made = rig.made_s();
    let times_s: Vec<f64> = (1..)
        .zip(&made)
        .filter_map(|(version, made_s)| Some(rig.adopted_s(version)? - made_s))
        .collect();
    println!("from the end of the learning to the adoption: {times_s:.3?} s");
    assert!(times_s.len() >= 6, "{times_s:?} of {made:?}");
    assert!(times_s.iter().all(|time_s| *time_s < 1.0), "{times_s:?}");
    assert_eq!(rig.stage.summary()["skipped"], 0);
}

/// On 2 Mbit/s a policy takes two seconds. The cable is cut within that time: the car drives
/// on by the weights that it has, and gets the new ones after the cut.
#[test]
fn a_cut_in_the_middle_of_a_policy_leaves_the_old_one_in_place() {
    let Some(rig) = Rig::new("2mbit") else { return };
    let mut up = rig.up(75, 100);
    let mut join = rig.stage.join(&rig.bundle);
    wait_for("the first policy", || rig.adopted_s(1).is_some());
    let (made, taken) = (rig.made_s().len(), rig.file_bytes().len());
    wait_for("the next policy", || rig.made_s().len() > made);
    let before = rig.cable.sent_bytes(1);
    wait_for("a third of it", || {
        rig.cable.sent_bytes(1) > before + 150_000
    });
    rig.cable.set("down").expect("a cut");
    let version = made + 1;
    wait_for("the session's end", || {
        !is_joined(&rig.stage.vehicle_report("learner"))
    });
    std::thread::park_timeout(Duration::from_secs(5));
    assert_eq!(rig.file_bytes().len(), taken);
    assert_eq!(rig.adopted_s(version), None);
    rig.cable.set("up").expect("a network");
    let healed_s = namespaces::epoch_s();
    wait_for("the new policy, or a newer one", || {
        (version..version + 9).any(|version| rig.adopted_s(version).is_some())
    });
    let adopted = (version..version + 9).find(|version| rig.adopted_s(*version).is_some());
    let adopted = adopted.expect("a policy");
    let after_s = rig.adopted_s(adopted).expect("an instant") - healed_s;
    assert_eq!(up.wait(), Some(0), "{}", up.text());
    join.end();
    let (vehicle, learner) = (
        rig.stage.vehicle_report("learner"),
        rig.stage.report(&rig.stage.other_run(), "join"),
    );
    let sent = &learner["rows"]["weights"]["sent"];
    let received = &vehicle["peers"][0]["rows"]["weights"]["received"];
    println!(
        "cut in policy {version}; policy {adopted} was adopted {after_s:.2} s after the cable \
         was back; sent {sent}, received {received}, superseded {}",
        vehicle["superseded"]
    );
    let number = |value: &serde_json::Value| value.as_u64().expect("a count");
    let numbered = number(&received["messages"]) + number(&received["skipped"]);
    assert!(
        number(&sent["messages"])
            <= numbered + number(&sent["waiting"]) + number(&sent["replaced"])
    );
    let summary = rig.stage.summary();
    let weights = summary["weights"].as_array().expect("rows");
    println!("steps of each version: {}", summary["weights"]);
    let first = weights.iter().find(|row| row["version"] == made);
    let drove = first.and_then(|row| row["drove"].as_u64());
    assert!(drove > Some(0), "{summary}");
    assert_eq!([&summary["skipped"], &summary["restarts"]], [0, 0]);
    assert_eq!(count(&vehicle, "step", "sent", "lost"), 0);
}
