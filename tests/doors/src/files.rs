//! Files and answers from outside.

use gate::distilled::INPUTS;
use gate::presentation::{Prompt, Showing};
use planner::Planner;
use policy::Net;
use shm_config::config::{self, Config, PromptPreset, View};
use shm_config::message::FEATURES;
use sim::WorldConfig;

use crate::Said;

/// A configuration: it gives an error in one line, or everything configured by it can
/// be built.
pub fn config(bytes: &[u8]) -> Said {
    let Ok(text) = str::from_utf8(bytes) else {
        return Said::Refused;
    };
    let config: Config = match config::from_toml(text, "vlaps.toml") {
        Ok(config) => config,
        Err(error) => {
            let text = error.to_string();
            assert!(text.starts_with("vlaps.toml"), "says where: {text}");
            return Said::Refused;
        }
    };
    // A valid configuration is within the limits of everything built from it.
    Planner::new(&config).expect("a valid configuration has a planner");
    let _ = WorldConfig::from(&config);
    assert!(config.run.period_ns() > 0 && config.plan_ticks() > 0);
    assert!(config.plan_age_ns() > 0);
    Said::Admitted
}

/// A policy file: it is refused, or its net answers with numbers. The same bytes may be the
/// file of a distilled judge, which has probabilities or no opinion.
pub fn policy(bytes: &[u8]) -> Said {
    if let Ok(mut net) = gate::distilled::decode(bytes) {
        for rows in [
            [[0.5; INPUTS], [-1.0; INPUTS]],
            [[f32::MAX; INPUTS], [0.0; INPUTS]],
        ] {
            let Some(opinion) = net.opinion(&rows) else {
                continue;
            };
            let sum = opinion.expert + opinion.policy + opinion.similar;
            assert!((sum - 1.0).abs() < 1e-6, "{opinion:?}");
            assert!((0.0..=1.0).contains(&opinion.confidence()), "{opinion:?}");
            let _ = net.is_sure(&opinion);
        }
        return Said::Admitted;
    }
    let Ok(file) = policy::decode(bytes) else {
        return Said::Refused;
    };
    if let Net::Mlp { mut mlp, .. } = file.net {
        for value in [0.0, 0.25, 1.0] {
            let answer = mlp.infer(&[value; FEATURES]);
            // An overflow is detected in the tick, which checks each answer; it must
            // not panic.
            assert!(answer.iter().all(|number| !number.is_nan()) || value == 0.25);
        }
    }
    Said::Admitted
}

const PRESETS: [PromptPreset; 2] = [PromptPreset::Blind, PromptPreset::Paper];

/// The body of a model's answer; the first byte chooses the prompt that it answers.
pub fn answers(bytes: &[u8]) -> Said {
    let Some((choice, body)) = bytes.split_first() else {
        return Said::Refused;
    };
    let preset = PRESETS[usize::from(*choice) % PRESETS.len()];
    let showing = match choice & 0x80 {
        0 => Showing::PAPER,
        _ => Showing::PAPER.swapped(),
    };
    let prompt = Prompt::new(preset, showing, View::Ego, 3.0);
    let reading = gate::model::read_answer(body, &prompt);
    let confidence = reading.reply.ok().and_then(|(_, confidence)| confidence);
    assert!(confidence.is_none_or(|share| (0.0..=1.0).contains(&share)));
    Said::of(reading.reply.is_ok())
}
