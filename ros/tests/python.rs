//! Our messages in Python's readers of ROS 2, and Cyclone DDS: the same type hash, and the same
//! bytes after they were read and written again.

mod stage;

use std::process::Command;

use rand::{Rng as _, RngExt as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;
use recorder::Channel;
use recorder::schema::ENCAPSULATION;
use recorder::standard::{Drive, Standard, Topic, definition, drive_cdr};
use serde_json::json;
use shm_config::config::Config;
use shm_config::layout::{Field, Layout as _, Table};
use shm_config::message::Step;
use shm_config::services::SERVICES;
use vlaps_ros::names::TopicType;

/// Bytes of a message with other contents in each field; floats are finite, because NaN has
/// many bytes.
fn contents(table: &Table, bytes: usize, dice: &mut Xoshiro256PlusPlus) -> Vec<u8> {
    let mut memory = vec![0; bytes];
    fill(table, &mut memory, dice);
    memory
}

fn fill(table: &Table, memory: &mut [u8], dice: &mut Xoshiro256PlusPlus) {
    for Field {
        type_name,
        offset,
        size,
        ..
    } in table.fields
    {
        let own = &mut memory[*offset..offset + size];
        let element = type_name.trim_start_matches('[');
        match element.split(';').next().unwrap_or_default().trim() {
            "f32" => own
                .chunks_mut(4)
                .for_each(|four| four.copy_from_slice(&dice.random::<f32>().to_le_bytes())),
            "f64" => own
                .chunks_mut(8)
                .for_each(|eight| eight.copy_from_slice(&dice.random::<f64>().to_le_bytes())),
            "u8" | "u32" | "u64" => dice.fill_bytes(own),
            nested => {
                let nested = table.nested.iter().find(|table| table.name == nested);
                let nested = nested.expect("a nested table");
                let end = nested
                    .fields
                    .last()
                    .map_or(1, |last| last.offset + last.size);
                own.chunks_mut(end).for_each(|one| fill(nested, one, dice));
            }
        }
    }
}

/// Name, definition, hash and bytes of one message of each type that is published.
fn messages() -> Vec<serde_json::Value> {
    let mut dice = Xoshiro256PlusPlus::seed_from_u64(11);
    let mut all = Vec::new();
    let mut add = |name: &str, definition: &str, cdr: &[u8]| {
        let of = TopicType::new(name, definition).expect("a type");
        let hex: String = cdr.iter().map(|byte| format!("{byte:02x}")).collect();
        all.push(json!({
            "name": name, "definition": definition, "hash": of.hash, "cdr": hex,
        }));
    };
    for row in SERVICES {
        // Pictures and weights are a megabyte of bytes, which Python reads one by one.
        if row.message.bytes < 200_000 {
            let channel = Channel::of(row, row.instances[0]);
            let memory = contents(row.message.table, row.message.bytes, &mut dice);
            let cdr = [&ENCAPSULATION[..], &memory].concat();
            add(&channel.schema, &channel.definition, &cdr);
        }
    }
    let mut step = Box::new(Step::default());
    step.header.taken_ns = 5_000_000_000;
    step.observation.beam_count = 4;
    (step.observation_age_ns, step.plan_age_ns) = (0, 0);
    let mut standard = Standard::new(&Config::default(), 1_700_000_000_000_000_000, 10.0);
    let of_step = ("step", step.header.taken_ns);
    standard.message(of_step, step.as_bytes(), &mut |topic: Topic, cdr: &[u8]| {
        let channel = topic.channel();
        add(&channel.schema, &channel.definition, cdr);
    });
    let drive = Drive {
        steer_rad: -0.25,
        speed_mps: 2.5,
        accel_mps2: -1.5,
    };
    let short = "ackermann_msgs/AckermannDriveStamped";
    let drive = drive_cdr(1_700_000_000_000_000_001, "base_link", drive);
    add(
        "ackermann_msgs/msg/AckermannDriveStamped",
        &definition(short),
        &drive,
    );
    let short = "nav_msgs/Odometry";
    let odometry = stage::odometry(7, [1.0, 2.0, 0.5], 3.0);
    add("nav_msgs/msg/Odometry", &definition(short), &odometry);
    all
}

/// Runs the checks of one library over all messages.
fn check(test: &str, library: &str) {
    let Some(python) = stage::python(test) else {
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("messages.json");
    let all = messages();
    let names: Vec<_> = all.iter().map(|message| &message["name"]).collect();
    assert!(all.len() > 20, "{names:?}");
    std::fs::write(&path, serde_json::to_vec(&all).expect("JSON")).expect("a file");
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/check.py");
    let output = Command::new(python)
        .args([script, library])
        .arg(&path)
        .output();
    let output = output.expect("Python runs");
    let text = String::from_utf8_lossy(&output.stdout);
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{text}{error}");
    print!("{text}");
    if !text.starts_with("skipped: ") {
        assert!(text.contains(&format!("{} types", all.len())), "{text}");
    }
}

#[test]
fn rosbags_computes_the_same_hash_and_writes_the_same_bytes() {
    check("rosbags", "rosbags");
}

#[test]
fn mcap_ros2_support_reads_and_writes_the_same_bytes() {
    check("mcap-ros2-support", "mcap");
}

#[test]
fn cyclone_dds_reads_and_writes_the_same_bytes() {
    check("cyclonedds", "cyclonedds");
}
