//! Writes the seeds of the fuzz targets into `fuzz/corpus`: real inputs of worlds,
//! planners, controllers and files, and a damaged copy of most of them.
//!
//! ```text
//! cargo run --release -p doors --example seeds
//! ```

use std::fs;
use std::mem::offset_of;
use std::path::Path;

use doors::{KINDS, as_bytes};
use learner::Rate;
use learner::checkpoint::Checkpoint;
use learner::journal::{Journal, Mark};
use learner::replay::{Buffer, INPUTS, Then, Transition};
use policy::{Activation, Compression, Layer, Mlp, Provenance, Windows};
use recorder::{Origin, Writer};
use shm_config::Instant;
use shm_config::config::planner::Method;
use shm_config::config::{Clock, Config};
use shm_config::message::{
    Camera, Command, FEATURES, Header, Observation, Plan, Preference, Proposal, Step, Takeover,
    View,
};
use shm_config::services::STEP;
use sim::{World, WorldConfig};
use stack::Stack;

const PERIOD_NS: u64 = 100_000_000;
/// Where the first number stands that a door looks at.
const SEEN_AT: usize = offset_of!(Observation, ego);
const STEP_AT: usize = offset_of!(Step, command) + size_of::<Header>();

/// One input: `seed-NAME`.
fn seed(target: &str, name: &str, parts: &[&[u8]]) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../fuzz/corpus")
        .join(target);
    fs::create_dir_all(&folder).expect("a folder");
    fs::write(folder.join(format!("seed-{name}")), parts.concat()).expect("a seed");
}

/// An input, and the same with the number at byte `at` no number.
fn both(target: &str, name: &str, parts: &[&[u8]], at: usize) {
    seed(target, name, parts);
    let mut spoilt = parts.concat();
    for (to, from) in spoilt.iter_mut().skip(at).zip(f64::NAN.to_le_bytes()) {
        *to = from;
    }
    seed(target, &format!("{name}-spoilt"), &[&spoilt]);
}

/// Some ticks of an episode: what was seen, planned and decided.
fn drive(method: Method, map_seed: u64) -> Vec<(Observation, Plan, Step)> {
    let mut config = Config::default();
    config.planner.method = method;
    config.run.clock = Clock::Lockstep;
    let mut world = World::new(WorldConfig::from(&config)).expect("a world");
    world.reset(map_seed).expect("a map");
    let mut stack = Stack::new(&config).expect("a planner");
    let mut ticks = Vec::new();
    for tick in 1..=40 {
        let now = Instant(tick * PERIOD_NS);
        let mut observation = Observation::default();
        world.observe(&mut observation);
        observation.header.tick = tick;
        observation.header.taken_ns = now.0;
        observation.header.sequence = tick;
        let plan = *stack.plan(&observation);
        let step = *stack.control(&observation);
        world.step(step.command.action());
        if tick % 13 == 0 {
            ticks.push((observation, plan, step));
        }
    }
    ticks
}

fn of_processes() {
    let methods = [
        Method::RrtStar,
        Method::Informed,
        Method::Kinodynamic,
        Method::Mpc,
    ];
    for (k, method) in methods.into_iter().enumerate() {
        let ticks = drive(method, 3 + k as u64);
        let seen: Vec<Vec<u8>> = ticks.iter().map(|(seen, ..)| as_bytes(seen)).collect();
        both(
            "planner",
            &format!("{k}"),
            &[&[k as u8], &seen[0]],
            1 + SEEN_AT,
        );
        let two: [&[u8]; 3] = [&[k as u8], &seen[0], &seen[1]];
        seed("planner", &format!("{k}-two"), &two);
        let (observation, plan, step) = &ticks[2];
        let parts: [&[u8]; 5] = [
            &[k as u8],
            &[0],
            &as_bytes(observation),
            &[1 | 0x40],
            &as_bytes(plan),
        ];
        both("controller", &format!("{k}"), &parts, 2 + SEEN_AT);
        let person = Takeover {
            active: 1,
            steer: 0.5,
            ..Takeover::default()
        };
        let parts: [&[u8]; 5] = [&[1], &[0], &as_bytes(observation), &[3], &as_bytes(&person)];
        seed("controller", &format!("{k}-person"), &parts);
        let steps: Vec<Vec<u8>> = ticks.iter().map(|(.., step)| as_bytes(step)).collect();
        if k == 0 {
            seed("steps", "drive", &[&steps[0], &steps[1]]);
        }
        both("steps", &format!("{k}"), &[&steps[2]], STEP_AT);
        let commands: Vec<u8> = ticks
            .iter()
            .flat_map(|(.., step)| as_bytes(&step.command))
            .collect();
        both("world", &format!("{k}"), &[&[k as u8], &commands], 1 + 32);
        if k == 3 {
            both(
                "messages",
                "0",
                &[&[0], &as_bytes(observation)],
                1 + SEEN_AT,
            );
            both("messages", "1", &[&[1], &as_bytes(plan)], 1 + 32);
            both("messages", "3", &[&[3], &as_bytes(step)], 1 + STEP_AT);
        }
    }
    let refused = Command {
        steer: 1.5,
        ..Step::default().command
    };
    seed("world", "refused", &[&[0], &as_bytes(&refused)]);
}

/// A message of each kind that no drive gives, mostly zeros.
fn of_messages() {
    for kind in 0..KINDS {
        seed("messages", &format!("zeros-{kind}"), &[&[kind]]);
        seed(
            "messages",
            &format!("ones-{kind}"),
            &[&[kind], &[0xff; 256]],
        );
    }
    let request = shm_config::message::FrameRequest {
        view: View::Ego.code(),
        width: 480,
        height: 320,
        proposals: [Proposal::default(); 2],
        ..Default::default()
    };
    both("messages", "7", &[&[7], &as_bytes(&request)], 1 + 48);
    let camera = Camera::top_down([4, 4]);
    assert_eq!(camera.check(), Ok(()));
}

fn of_configurations() {
    let defaults = toml::to_string(&Config::default()).expect("TOML");
    seed("config", "defaults", &[defaults.as_bytes()]);
    let cases = [
        ("empty", ""),
        ("unknown", "[planner]\nmethodd = \"mpc\"\n"),
        ("range", "[run]\nrate_hz = -1.0\n"),
        (
            "rates",
            "[run]\nrate_hz = 1000.0\n[planner]\nrate_hz = 10.0\n",
        ),
        ("type", "run = 3\n"),
        (
            "words",
            "[gate]\nmode = \"human\"\n[learner]\nenabled = true\n",
        ),
        ("syntax", "[run\n"),
    ];
    for (name, text) in cases {
        seed("config", name, &[text.as_bytes()]);
    }
}

fn of_policies() {
    let layer = |inputs: usize, outputs: usize, activation| Layer {
        weights: (0..inputs * outputs)
            .map(|k| ((k * 37 % 101) as f32 - 50.0) / 500.0)
            .collect(),
        bias: vec![0.01; outputs],
        inputs,
        outputs,
        activation,
    };
    let layers = vec![
        layer(FEATURES, 3, Activation::Relu),
        layer(3, 2, Activation::Tanh),
    ];
    let mlp = Mlp::new(layers).expect("a net");
    let file = policy::encode(&mlp, &Provenance::default(), &[vec![0.25; FEATURES]]);
    seed("policy", "good", &[&file]);
    seed("policy", "cut", &[&file[..file.len() / 2]]);
    seed("policy", "head", &[&file[..64]]);
    let windows = Windows {
        inputs: FEATURES,
        kept: 2,
        window: 5,
        indices: (19..39).collect(),
        weights: vec![0.05; 10],
        bias: vec![0.01; 2],
    };
    let layers = vec![layer(windows.outputs(), 2, Activation::Tanh)];
    let by = Compression::default();
    let mlp = Mlp::convolved(by, vec![windows], layers).expect("a net");
    let file = policy::encode(&mlp, &Provenance::default(), &[vec![0.25; FEATURES]]);
    seed("policy", "convolution", &[&file]);
}

fn of_answers() {
    let said = [
        (
            "first",
            r#"{"reason":"","response":"A","confidence":0.9}"#,
            0,
        ),
        (
            "similar",
            r#"{"reason":"x","response":"similar","confidence":1}"#,
            0,
        ),
        (
            "both",
            r#"{"reason":"x","response":"A and B","confidence":1}"#,
            0,
        ),
        ("fence", "```json\n{}\n```", 0),
        ("paper", "{\"response\": 1}\nBecause.", 1),
        ("zero", "{\"response\": 0, \"reason\": \"x\"}", 0x82),
        ("deep", "{\"response\": [[[[[1]]]]]}", 1),
    ];
    for (name, content, choice) in said {
        let body = serde_json::json!({
            "id": "x", "object": "chat.completion", "model": "m",
            "choices": [{"index": 0, "finish_reason": "stop",
                         "message": {"role": "assistant", "content": content}}],
            "usage": {"prompt_tokens": 9, "completion_tokens": 3},
        });
        seed("answers", name, &[&[choice], body.to_string().as_bytes()]);
    }
    seed(
        "answers",
        "length",
        &[b"\0{\"choices\":[{\"finish_reason\":\"length\",\"message\":{}}]}"],
    );
    seed("answers", "utf8", &[b"\0\xff\xfe"]);
    seed("answers", "empty", &[b"\0"]);
}

/// A record as the judge writes one.
const RECORD: &str = r#"{"version":1,"question":1,"tick":40,"episode":0,"taken_ns":4000000000,"occasion":"differ","judge":"vlm","preset":"blind","model":"m","speed_mps":8.5,"expert":{"steer":0.1,"pedal":0.3,"clearance_m":2.0,"safe_s":3.0,"vetoed":false},"policy":{"steer":-0.4,"pedal":1.0,"clearance_m":0.2,"safe_s":0.8,"vetoed":true},"askings":[{"showing":{"first":"expert","hues":["red","blue"]},"picture":"pictures/000001-a.png","system":"s","user":"u","said":"<b>A</b>","reply":"first","confidence":0.9,"fault":null,"attempts":1,"latency_s":0.8,"tokens_in":900,"tokens_out":30,"cost_usd":0.002}],"verdict":"expert","fault":"","latency_s":0.9,"cost_usd":0.002,"heard_tick":49,"heard_ns":4900000000,"foresight":[{"party":"expert","horizon_s":3.0,"contact_s":3.0,"out_s":3.0},{"party":"policy","horizon_s":3.0,"contact_s":1.2,"out_s":3.0}],"aftermath":{"ticks":30,"expert":30,"policy":0,"brake":0,"vetoed":0,"clearance_m":1.0,"ended":false}}"#;

fn of_recordings() {
    let line = format!("{RECORD}\n");
    seed("records", "one", &[line.as_bytes()]);
    seed(
        "records",
        "torn",
        &[line.as_bytes(), &RECORD.as_bytes()[..200]],
    );
    let newer = line.replace("\"version\":1", "\"version\":9");
    seed("records", "newer", &[line.as_bytes(), newer.as_bytes()]);
    let failed = line
        .replace("\"verdict\":\"expert\"", "\"verdict\":\"failed\"")
        .replace("\"reply\":\"first\"", "\"reply\":null");
    seed("records", "failed", &[failed.as_bytes(), line.as_bytes()]);

    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("replay.bin");
    let mut journal = Journal::open(&path, 8, 0).expect("a journal").journal;
    for (k, label) in [Preference::Abstain, Preference::Expert, Preference::Policy]
        .into_iter()
        .enumerate()
    {
        let transition = Transition {
            state: [0.25; INPUTS],
            next: [0.5; INPUTS],
            applied: [0.1, 0.2],
            policy: [0.3, 0.4],
            expert: [0.5, 0.6],
            label,
            then: Then::On,
        };
        let mark = Mark {
            producer: 7,
            sequence: k as u64 + 1,
            ..Mark::default()
        };
        journal
            .append(Buffer::ALL[k % Buffer::ALL.len()], &transition, &mark)
            .expect("room");
    }
    journal.flush().expect("room");
    let bytes = fs::read(&path).expect("the journal");
    seed("journal", "whole", &[&[0], &bytes]);
    seed("journal", "torn", &[&[0], &bytes[..bytes.len() - 100]]);
    seed("journal", "sealed", &[&[1], &bytes]);
    seed("journal", "other", &[&[0], b"VLREPL99 something else"]);
    seed("journal", "empty", &[&[0]]);

    checkpoints(folder.path());
}

/// Networks of a size that no learner has, but whole.
fn checkpoints(folder: &Path) {
    use learner::algorithm::regression::Settings;
    use learner::algorithm::{Regression, Size, Source, Student};
    use rand_xoshiro::Xoshiro256PlusPlus;
    use rand_xoshiro::rand_core::SeedableRng;
    let mut random = Xoshiro256PlusPlus::seed_from_u64(3);
    let size = Size {
        inputs: 259,
        hidden: 2,
        filters: 0,
        batch: 4,
    };
    let state = Checkpoint {
        algorithm: "bc".into(),
        student: Student::Regression(Regression::new(
            Source::All,
            size,
            Settings::even(Rate::constant(1e-3)),
            &mut random,
        )),
        random,
        steps: 3,
        updates: 1,
        blocks: 1,
    };
    let path = folder.join("learner.bin");
    state.write(&path).expect("a file");
    let bytes = fs::read(&path).expect("the file");
    seed("checkpoint", "small", &[&bytes[12..]]);
    seed("checkpoint", "cut", &[&bytes[12..bytes.len() / 2]]);
}

/// Files of recordings: whole, without their end, and with a wrong byte.
fn of_recorded_runs() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run-0001.mcap");
    let origin = Origin {
        run: "seed".into(),
        session: "1".into(),
        epoch_offset_ns: 1_700_000_000_000_000_000,
        ..Origin::default()
    };
    let mut writer = Writer::create(&path, &origin).expect("a file");
    for tick in 0..12 {
        let mut step = Step::default();
        step.header.tick = tick;
        writer.write(&STEP, tick * PERIOD_NS, &step).expect("room");
        if tick % 4 == 3 {
            writer.flush().expect("room");
        }
    }
    writer.finish().expect("room");
    let bytes = fs::read(&path).expect("the file");
    seed("recording", "whole", &[&bytes]);
    seed("recording", "cut", &[&bytes[..bytes.len() * 2 / 3]]);
    seed("recording", "foreign", &[b"\x89MCAP0\r\n", &[0; 64]]);
    let mut wrong = bytes.clone();
    wrong[bytes.len() / 2] ^= 1;
    seed("recording", "wrong", &[&wrong]);
}

/// A client's frame, RFC 6455, with a mask of zeros; texts of at most 125 bytes.
fn frame(first: u8, text: &str) -> Vec<u8> {
    [
        &[first, 0x80 | text.len() as u8, 0, 0, 0, 0],
        text.as_bytes(),
    ]
    .concat()
}

fn of_viewers() {
    let subscribe = r#"{"op":"subscribe","subscriptions":[{"id":1,"channelId":0}]}"#;
    let other = r#"{"op":"subscribe","subscriptions":[{"id":2,"channelId":1}]}"#;
    let two = [frame(0x81, subscribe), frame(0x81, other)].concat();
    seed("viewer", "two", &[&two]);
    let (head, tail) = subscribe.split_at(20);
    let parts = [frame(0x01, head), frame(0x89, "x"), frame(0x80, tail)].concat();
    seed("viewer", "parts", &[&parts]);
    let asked = [
        (
            "channel",
            r#"{"op":"subscribe","subscriptions":[{"id":1,"channelId":99999}]}"#,
        ),
        ("publish", r#"{"op":"advertise","channels":[]}"#),
        ("close", ""),
    ];
    for (name, text) in asked {
        let first = if name == "close" { 0x88 } else { 0x81 };
        seed("viewer", name, &[&frame(first, text), &two]);
    }
    seed("viewer", "unmasked", &[&[0x81, 0x05], b"Hello"]);
    seed("viewer", "long", &[&[0x81, 0xff, 0xff], &[0xff; 11]]);
}

fn main() {
    of_messages();
    of_processes();
    of_configurations();
    of_policies();
    of_answers();
    of_recordings();
    of_recorded_runs();
    of_viewers();
}
