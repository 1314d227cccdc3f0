//! The link over networks that lose, delay, reorder and double IP packets, below TCP, between
//! two namespaces: one row for each network. The router is `common/router.rs`.

#![allow(clippy::disallowed_methods)] // a test measures time

#[path = "common/namespaces.rs"]
mod namespaces;
#[path = "common/router.rs"]
mod router;
#[path = "common/sets.rs"]
mod sets;

use std::time::Duration;

use namespaces::{epoch_s, instants, joined_at, permitted};
use router::Router;
use serde_json::Value;
use sets::{Running, Stage, count, file, is_joined, wait_for};

const POLICY: &str = "results/learning/ppl-10000.onnx";
/// The router's random numbers.
const SEED: u64 = 21;
/// Longest time until a session after the network is back, s.
const REJOINED_S_MAX: f64 = 2.0;

/// A vehicle whose judge and learner are behind a router.
struct Rig {
    stage: Stage,
    peers: [Invited; 2],
    router: Router,
}

struct Invited {
    role: &'static str,
    address: String,
    bundle: String,
    run: String,
}

impl Rig {
    fn new() -> Option<Self> {
        let router = permitted(Router::new(SEED))?;
        let stage = router.stage()?;
        let peers = ["judge", "learner"].map(|role| {
            let address = stage.address();
            Invited {
                role,
                bundle: stage.invite(role, &address, &format!("{role}.bundle")),
                address,
                run: format!("{}-{role}", stage.run()),
            }
        });
        Some(Self {
            stage,
            peers,
            router,
        })
    }

    /// Drives; the learner gets each step, and makes no policy.
    fn up(&self, duration_s: u32) -> Running {
        let (policy, duration) = (file(POLICY), duration_s.to_string());
        let [judge, learner] = &self.peers;
        let words = "--set gate.period_s=1 --set gate.hold_s=2 --set learner.block_steps=10000";
        let mut all = vec!["--policy", &policy, "--duration", &duration];
        all.extend(["--judge", &judge.address, "--learner", &learner.address]);
        all.extend(words.split(' '));
        self.stage.up(&all)
    }

    fn join(&self, peer: &Invited) -> Running {
        let words = ["join", &peer.bundle, "--run", &peer.run];
        self.stage.start(&self.stage.other, "vlaps-link", &words)
    }

    fn join_all(&self) -> [Running; 2] {
        self.peers.each_ref().map(|peer| self.join(peer))
    }

    fn report(&self, role: usize) -> Value {
        self.stage.vehicle_report(self.peers[role].role)
    }

    /// Waits until advice comes and steps arrive, further ones than now.
    fn until_both_work(&self) {
        let seen = || {
            let learner = self.stage.report(&self.peers[1].run, "join");
            let advices = count(&self.report(0), "advice", "received", "messages");
            (advices, count(&learner, "step", "received", "messages"))
        };
        let before = seen();
        wait_for("advice and steps", || {
            let now = seen();
            // A process that was started again counts from 0.
            let more = |now: u64, before: u64| now != before && now > 5;
            more(now.0, before.0) && more(now.1, before.1)
        });
    }

    fn until_joined(&self, is_so: bool) {
        wait_for("the sessions", || {
            [0, 1]
                .iter()
                .all(|role| is_joined(&self.report(*role)) == is_so)
        });
    }

    /// Waits until both peers have reported the end of their sessions; each does within a
    /// second.
    fn until_reported(&self) {
        let is_over = |peer: &Invited| !is_joined(&self.stage.report(&peer.run, "join"));
        wait_for("the end of the sessions", || self.peers.iter().all(is_over));
    }

    /// Pieces of advice that the judge has sent.
    fn advices_sent(&self) -> u64 {
        let judge = self.stage.report(&self.peers[0].run, "join");
        count(&judge, "advice", "sent", "messages")
    }

    /// Waits for the end of the drive, checks what must hold on any network, and prints the
    /// row. `rejoined_s` are the times that were measured, `before` the pieces of advice and the
    /// steps that went between processes before these.
    fn finish(&self, network: &str, up: &mut Running, rejoined_s: &[f64], before: [u64; 2]) {
        assert_eq!(up.wait(), Some(0), "{}", up.text());
        self.until_reported();
        let summary = self.stage.summary();
        assert_eq!(summary["skipped"], 0, "{network}");
        self.no_command_from_elsewhere(&summary);
        let advice = self.account(0, "advice", Way::ToVehicle, before[0]);
        let steps = self.account(1, "step", Way::FromVehicle, before[1]);
        let lateness = &summary["release_lateness_us"];
        let sessions = |role| self.report(role)["peers"][0]["session"]["sessions"].clone();
        let [came, lost, doubled, overtaken] = self.router.network.counts();
        let slowest_s = rejoined_s.iter().copied().fold(f64::NAN, f64::max);
        println!(
            "| {network} | {}, {} | {}, {} | {}, {} | {slowest_s:.2} | {advice} | {steps} | {:.2} | \
             {came}, {lost}, {overtaken}, {doubled} |",
            summary["ticks"],
            summary["skipped"],
            lateness["p99"],
            lateness["max"],
            sessions(0),
            sessions(1),
            summary["share"]["policy"].as_f64().unwrap_or(f64::NAN),
        );
        for rejoined_s in rejoined_s {
            assert!(*rejoined_s < REJOINED_S_MAX, "{network}: {rejoined_s} s");
        }
    }

    /// The rows that the vehicle has taken from the network are those of a judge and a
    /// learner; each step drove by the run's own controller.
    fn no_command_from_elsewhere(&self, summary: &Value) {
        let mays: [&[&str]; 2] = [&["advice", "frame_request"], &["learning", "weights"]];
        for (role, may) in mays.into_iter().enumerate() {
            let report = self.report(role);
            let peers = report["peers"].as_array().expect("peers");
            assert_eq!(peers.len(), 1, "{report}");
            for (row, counts) in peers[0]["rows"].as_object().expect("rows") {
                let is_taken = counts["received"].is_object();
                assert!(!is_taken || may.contains(&row.as_str()), "{row} was taken");
            }
            for (reason, times) in report["refused"].as_object().expect("reasons") {
                // Packets of a session that is over, and a process that joins while the session
                // of the one before still lives.
                let is_expected = ["no_session", "occupied"].contains(&reason.as_str());
                assert!(is_expected || *times == 0, "refused {reason}: {times}");
            }
        }
        assert_eq!(summary["restarts"], 0);
    }

    /// What was sent is what was received, what is counted as skipped or lost, and what waited
    /// when the drive ended.
    fn account(&self, role: usize, row: &str, way: Way, before: u64) -> String {
        let ends = [
            self.report(role),
            self.stage.report(&self.peers[role].run, "join"),
        ];
        let (from, to) = match way {
            Way::ToVehicle => (&ends[1], &ends[0]),
            Way::FromVehicle => (&ends[0], &ends[1]),
        };
        let sent = |key: &str| count(from, row, "sent", key);
        let received = |key: &str| count(to, row, "received", key);
        let gone = received("skipped") + received("lost");
        let numbered = received("messages") + gone;
        let messages = sent("messages") - before;
        let left = messages.checked_sub(numbered);
        let left = left.unwrap_or_else(|| panic!("{row}: {from} {to}"));
        // Of newest rows, what was replaced after the last one that arrived.
        let may_be_left = sent("waiting") + sent("replaced");
        assert!(
            left <= may_be_left,
            "{row}: {left} of {may_be_left}: {from} {to}"
        );
        assert_eq!(received("lost"), sent("lost"), "{row}: {from} {to}");
        if way == Way::FromVehicle {
            assert!(left <= sent("waiting"), "{row}: {left}: {from} {to}");
        }
        format!(
            "{messages} = {} + {gone} + {left} | {}, {}, {}",
            received("messages"),
            sent("again"),
            received("doubled"),
            received("reordered"),
        )
    }
}

/// Where messages go.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Way {
    ToVehicle,
    FromVehicle,
}

/// How long each session of a join was over before the next one, s.
fn gaps_s(join: &Running) -> Vec<f64> {
    let ends = instants(&join.text(), " the session is over");
    let begins = joined_at(join);
    let next = |end: &f64| {
        begins
            .iter()
            .find(|begin| *begin > end)
            .map(|begin| begin - end)
    };
    ends.iter().filter_map(next).collect()
}

/// Delay and jitter, ms; packets lost, held back, for how many ms, doubled, percent.
fn drive(network: &str, set: [u64; 6]) {
    let Some(rig) = Rig::new() else { return };
    rig.router.network.set(set);
    let mut up = rig.up(30);
    let joins = rig.join_all();
    rig.until_both_work();
    rig.finish(network, &mut up, &[], [0, 0]);
    let away_s = joins.each_ref().map(gaps_s);
    println!("{network}: judge and learner were away for {away_s:.2?} s");
    assert!(rig.stage.summary()["share"]["policy"].as_f64() > Some(0.0));
}

#[test]
fn one_packet_in_ten_is_lost() {
    drive("10 % lost", [0, 0, 10, 0, 0, 0]);
}

#[test]
fn packets_are_late_by_100_ms_with_jitter() {
    drive("100 ms, 20 ms jitter", [90, 20, 0, 0, 0, 0]);
}

#[test]
fn packets_are_reordered() {
    drive("25 % held back for 20 ms", [5, 0, 0, 25, 20, 0]);
}

#[test]
fn packets_are_doubled() {
    drive("20 % doubled", [5, 5, 0, 0, 0, 20]);
}

#[test]
fn packets_are_lost_late_reordered_and_doubled() {
    drive("all of it", [90, 20, 10, 10, 20, 10]);
}

/// How long a new session of each peer took after an instant, s.
fn rejoined_s(joins: &[Running; 2], before: [usize; 2], since_s: f64) -> Vec<f64> {
    let count = |place: usize| joined_at(&joins[place]).len();
    wait_for("new sessions", || {
        [0, 1].iter().all(|place| count(*place) > before[*place])
    });
    let new = |place: usize| joined_at(&joins[place])[before[place]] - since_s;
    vec![new(0), new(1)]
}

/// The router's end, its interfaces with it, and a new one after ten seconds.
#[test]
fn a_router_that_is_killed_and_comes_back() {
    let Some(mut rig) = Rig::new() else { return };
    let mut up = rig.up(50);
    let joins = rig.join_all();
    rig.until_both_work();
    rig.router.kill();
    rig.until_joined(false);
    std::thread::park_timeout(Duration::from_secs(10));
    let before = joins.each_ref().map(|join| joined_at(join).len());
    rig.router.start().expect("it is permitted");
    let back_s = epoch_s();
    let rejoined_s = rejoined_s(&joins, before, back_s);
    rig.until_both_work();
    rig.finish("router killed for 10 s", &mut up, &rejoined_s, [0, 0]);
}

/// Packets vanish without a word for a minute, on interfaces that stay.
#[test]
fn a_partition_of_a_minute() {
    let Some(rig) = Rig::new() else { return };
    rig.router.network.set([5, 5, 0, 0, 0, 0]);
    let mut up = rig.up(100);
    let joins = rig.join_all();
    rig.until_both_work();
    rig.router.network.cut(true);
    rig.until_joined(false);
    std::thread::park_timeout(Duration::from_secs(60));
    let before = joins.each_ref().map(|join| joined_at(join).len());
    rig.router.network.cut(false);
    let back_s = epoch_s();
    let rejoined_s = rejoined_s(&joins, before, back_s);
    rig.until_both_work();
    rig.finish("partition of 60 s", &mut up, &rejoined_s, [0, 0]);
    let summary = rig.stage.summary();
    let expired = &summary["reasons"]["expert"]["expired"];
    assert!(expired.as_u64() > Some(0), "{}", summary["reasons"]);
}

/// The other machine's programs are killed and started again, then the vehicle's set is ended
/// and started again.
#[test]
fn both_ends_are_restarted() {
    let Some(rig) = Rig::new() else { return };
    rig.router.network.set([20, 10, 0, 0, 0, 0]);
    let mut up = rig.up(40);
    let [mut judge, mut learner] = rig.join_all();
    rig.until_both_work();
    judge.kill();
    learner.kill();
    rig.until_joined(false);
    // What the learner that was killed had taken is not sent again.
    let taken = count(&rig.report(1), "step", "sent", "acknowledged");
    let started_s = epoch_s();
    let joins = rig.join_all();
    let other_s = rejoined_s(&joins, [0, 0], started_s);
    rig.until_both_work();
    rig.finish("the other machine restarted", &mut up, &other_s, [0, taken]);
    let before = joins.each_ref().map(|join| joined_at(join).len());
    let sent = rig.advices_sent();
    let mut up = rig.up(25);
    let log = |role: &str| {
        let path = format!("runs/{}/logs/{role}.log", rig.stage.run());
        std::fs::read_to_string(rig.stage.path(&path)).unwrap_or_default()
    };
    let mut vehicle_s = rejoined_s(&joins, before, 0.0);
    for (at_s, role) in vehicle_s.iter_mut().zip(["gate", "learner"]) {
        let listens_s = instants(&log(role), " waits for a peer");
        *at_s -= listens_s.last().expect("it listens");
    }
    rig.until_both_work();
    rig.finish(
        "the vehicle's set restarted",
        &mut up,
        &vehicle_s,
        [sent, 0],
    );
}
