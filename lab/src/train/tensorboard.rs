//! The experiment's numbers for TensorBoard: one event file per seed.
//!
//! The format is TensorFlow's record file (length, masked CRC-32C of it, record,
//! masked CRC-32C of that) of `Event` messages, of which a scalar needs three.

use std::fs;
use std::path::Path;

use anyhow::Context;
use prost::Message;

use super::results::{Results, Seed};
use crate::metric::Metric;

/// `tensorflow.Event`, as far as scalars need it.
#[derive(Clone, PartialEq, Message)]
struct Event {
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(string, optional, tag = "3")]
    file_version: Option<String>,
    #[prost(message, optional, tag = "5")]
    summary: Option<Summary>,
}

/// `tensorflow.Summary`.
#[derive(Clone, PartialEq, Message)]
struct Summary {
    #[prost(message, repeated, tag = "1")]
    value: Vec<Value>,
}

/// `tensorflow.Summary.Value`.
#[derive(Clone, PartialEq, Message)]
struct Value {
    #[prost(string, tag = "1")]
    tag: String,
    #[prost(float, tag = "2")]
    simple_value: f32,
}

/// Writes `seed-N/tensorboard/events.out.tfevents.0.vlaps` for every seed; replaces older
/// files.
///
/// # Errors
/// If a file cannot be written.
pub fn write(results: &Results, out: &Path) -> anyhow::Result<()> {
    for seed in &results.seeds {
        let folder = seed.folder.join("tensorboard");
        fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        // A fixed name: TensorBoard would merge two files.
        let file = folder.join("events.out.tfevents.0.vlaps");
        fs::write(&file, records(seed)).with_context(|| file.display().to_string())?;
    }
    debug_assert!(out.exists(), "its seeds were read from it");
    Ok(())
}

fn records(seed: &Seed) -> Vec<u8> {
    let mut bytes = Vec::new();
    let head = Event {
        file_version: Some("brain.Event:2".into()),
        ..Event::default()
    };
    record(&head, &mut bytes);
    for block_evaluation in &seed.block_evaluations {
        let tags = Metric::ALL.map(|metric| {
            (
                format!("eval/{}", metric.key()),
                block_evaluation.of(metric),
            )
        });
        let scalars: Vec<(&str, f64)> = tags.iter().map(|(tag, value)| (&**tag, *value)).collect();
        record(&event(block_evaluation.steps, &scalars), &mut bytes);
    }
    for block in &seed.blocks {
        let scalars = [
            ("train/interventions", block.interventions as f64),
            ("train/updates", block.updates as f64),
            ("train/actor_loss", block.actor_loss),
            ("train/imitation_loss", block.imitation_loss),
            ("train/critic_loss", block.critic_loss),
        ];
        record(&event(block.steps, &scalars), &mut bytes);
    }
    bytes
}

fn event(steps: u64, scalars: &[(&str, f64)]) -> Event {
    let value = scalars.iter().map(|&(tag, value)| Value {
        tag: tag.into(),
        simple_value: value as f32,
    });
    Event {
        // Only the steps matter as time; the wall clock would make every file differ.
        wall_time: steps as f64,
        step: steps as i64,
        file_version: None,
        summary: Some(Summary {
            value: value.collect(),
        }),
    }
}

fn record(event: &Event, bytes: &mut Vec<u8>) {
    let body = event.encode_to_vec();
    let length = (body.len() as u64).to_le_bytes();
    bytes.extend_from_slice(&length);
    bytes.extend_from_slice(&masked(&length).to_le_bytes());
    bytes.extend_from_slice(&body);
    bytes.extend_from_slice(&masked(&body).to_le_bytes());
}

/// TensorFlow masks its checksums, by rotation and addition, because a CRC of data that
/// contains CRCs is weak.
fn masked(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes)
        .rotate_right(15)
        .wrapping_add(0xa282_ead8)
}
