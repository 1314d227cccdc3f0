//! What each server is sent, byte by byte, beside this file in `bodies/`. After a
//! change on purpose: `VLAPS_WRITE_BODIES=1 cargo test -p judge --test bodies`,
//! and look at the difference.

mod shared;

use std::path::Path;

use gate::model::body;
use gate::presentation::picture::Encoding;
use gate::presentation::picture::Picture;
use serde_json::Value;
use shm_config::config::{Dialect, PromptPreset, Vlm};

const DIALECTS: [(Dialect, &str); 6] = [
    (Dialect::Openai, "openai"),
    (Dialect::Vllm, "vllm"),
    (Dialect::LlamaCpp, "llama_cpp"),
    (Dialect::Ollama, "ollama"),
    (Dialect::LmStudio, "lm_studio"),
    (Dialect::Sglang, "sglang"),
];

fn body_of(dialect: Dialect, preset: PromptPreset) -> String {
    let vlm = Vlm {
        dialect,
        model: "some-model".into(),
        ..Vlm::default()
    };
    let picture = Picture {
        bytes: b"no picture, but bytes".to_vec(),
        encoding: Encoding::Png,
        width: 1,
        height: 1,
    };
    let bytes = body(&vlm, &shared::prompt(preset), &picture);
    String::from_utf8(bytes).expect("UTF-8")
}

#[test]
fn bodies_are_as_written_down() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bodies");
    let paper = (Dialect::Openai, "paper");
    let cases = DIALECTS
        .map(|case| (case, PromptPreset::Blind))
        .into_iter()
        .chain([(paper, PromptPreset::Paper)]);
    for ((dialect, name), preset) in cases {
        let body = body_of(dialect, preset);
        let path = folder.join(format!("{name}.json"));
        if std::env::var_os("VLAPS_WRITE_BODIES").is_some() {
            std::fs::write(&path, format!("{body}\n")).expect("written");
        }
        let written = std::fs::read_to_string(&path).expect("a body");
        assert_eq!(body, written.trim_end(), "{}", path.display());
    }
}

fn parsed(dialect: Dialect, preset: PromptPreset) -> Value {
    serde_json::from_str(&body_of(dialect, preset)).expect("JSON")
}

#[test]
fn servers_get_what_they_take_and_nothing_else() {
    for (dialect, name) in DIALECTS {
        let body = parsed(dialect, PromptPreset::Blind);
        let has = |key: &str| body.get(key).is_some();
        let is_openai = dialect == Dialect::Openai;
        let is_vllm = dialect == Dialect::Vllm;
        assert_eq!(has("max_completion_tokens"), is_openai || is_vllm, "{name}");
        assert_ne!(has("max_completion_tokens"), has("max_tokens"), "{name}");
        assert_eq!(has("structured_outputs"), is_vllm, "{name}");
        assert_eq!(has("response_format"), !is_vllm, "{name}");
        let image = &body["messages"][1]["content"][1]["image_url"];
        assert_eq!(image.get("detail").is_some(), is_openai, "{name}");
        let url = image["url"].as_str().expect("an address");
        assert!(url.starts_with("data:image/png;base64,"), "{name}: {url}");
        assert_eq!(body["temperature"], 0.0, "{name}");
    }
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
    );
    let body: Value = serde_json::from_slice(&bytes).expect("JSON");
    assert_eq!(body.get("temperature"), None);
    assert_eq!(body["model"], "gpt-4o-mini");
}

#[test]
fn the_papers_prompt_comes_without_a_schema() {
    for (dialect, name) in DIALECTS {
        let body = parsed(dialect, PromptPreset::Paper);
        assert!(body.get("response_format").is_none(), "{name}");
        assert!(body.get("structured_outputs").is_none(), "{name}");
        assert_eq!(body["messages"].as_array().map(Vec::len), Some(1), "{name}");
    }
}
