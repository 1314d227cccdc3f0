//! The body of a request, compared byte by byte with the files in `bodies/`. After an
//! intended change run `VLAPS_WRITE_BODIES=1 cargo test -p gate --test all bodies::`, and
//! read the difference.

use std::path::Path;

use gate::model::body;
use gate::presentation::picture::Encoding;
use gate::presentation::picture::Picture;
use serde_json::Value;
use shm_config::config::{PromptPreset, Vlm};

use crate::shared;

fn body_of(preset: PromptPreset) -> String {
    let vlm = Vlm {
        model: "some-model".into(),
        ..Vlm::default()
    };
    let picture = Picture {
        bytes: b"no picture, but bytes".to_vec(),
        encoding: Encoding::Png,
        width: 1,
        height: 1,
    };
    let bytes = body(&vlm, &shared::prompt(preset), &picture).expect("a body");
    String::from_utf8(bytes).expect("UTF-8")
}

#[test]
fn bodies_are_as_written_down() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bodies");
    let cases = [
        ("blind", PromptPreset::Blind),
        ("paper", PromptPreset::Paper),
    ];
    for (name, preset) in cases {
        let body = body_of(preset);
        let path = folder.join(format!("{name}.json"));
        if std::env::var_os("VLAPS_WRITE_BODIES").is_some() {
            std::fs::write(&path, format!("{body}\n")).expect("written");
        }
        let written = std::fs::read_to_string(&path).expect("a body");
        assert_eq!(body, written.trim_end(), "{}", path.display());
    }
}

fn parsed(preset: PromptPreset) -> Value {
    serde_json::from_str(&body_of(preset)).expect("JSON")
}

#[test]
fn a_negative_temperature_is_left_to_the_server() {
    let vlm = Vlm {
        temperature: -1.0,
        ..Vlm::default()
    };
    let bytes = body(
        &vlm,
        &shared::prompt(PromptPreset::Blind),
        &shared::red_ahead(),
    )
    .expect("a body");
    let body: Value = serde_json::from_slice(&bytes).expect("JSON");
    assert_eq!(body.get("temperature"), None);
    assert_eq!(body["model"], "gpt-4o-mini");
}

#[test]
fn the_papers_prompt_comes_without_a_schema() {
    let body = parsed(PromptPreset::Paper);
    assert!(body.get("response_format").is_none());
    assert_eq!(body["messages"].as_array().map(Vec::len), Some(1));
}
