//! What each server takes. They all speak "chat completions", and differ in how
//! a schema is handed over and in what the limit of tokens is called.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::Serialize;
use shm_config::config::{Dialect, Vlm};

use crate::presentation::picture::Picture;
use crate::presentation::{Prompt, Schema};

/// The body of a request.
#[derive(Serialize)]
struct Body<'a> {
    model: &'a str,
    messages: Vec<Message<'a>>,
    stream: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    temperature: Option<f64>,
    // Reasoning models of OpenAI refuse `max_tokens`; Ollama and LM Studio
    // document only that one, and pass over the other in silence.
    #[serde(skip_serializing_if = "Option::is_none")]
    max_completion_tokens: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    max_tokens: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    response_format: Option<ResponseFormat>,
    #[serde(skip_serializing_if = "Option::is_none")]
    structured_outputs: Option<StructuredOutputs>,
}

#[derive(Serialize)]
struct Message<'a> {
    role: &'static str,
    content: Content<'a>,
}

#[derive(Serialize)]
#[serde(untagged)]
enum Content<'a> {
    Text(&'a str),
    Parts([Part<'a>; 2]),
}

#[derive(Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
enum Part<'a> {
    Text { text: &'a str },
    ImageUrl { image_url: ImageUrl },
}

#[derive(Serialize)]
struct ImageUrl {
    url: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    detail: Option<&'static str>,
}

/// OpenAI's form, which the others took over.
#[derive(Serialize)]
struct ResponseFormat {
    r#type: &'static str,
    json_schema: NamedSchema,
}

#[derive(Serialize)]
struct NamedSchema {
    name: &'static str,
    strict: bool,
    schema: Schema,
}

/// vLLM's own, in place of `guided_json`, which it dropped with 0.12.
#[derive(Serialize)]
struct StructuredOutputs {
    json: Schema,
}

/// The body of the request, JSON in UTF-8. The picture goes inside, as a
/// base64 `data:` address: no server needs to fetch anything, and several cannot.
pub fn body(vlm: &Vlm, prompt: &Prompt, picture: &Picture) -> Vec<u8> {
    let dialect = vlm.dialect;
    let schema = prompt.schema();
    let is_vllm = dialect == Dialect::Vllm;
    let names_completion = matches!(dialect, Dialect::Openai | Dialect::Vllm);
    let body = Body {
        model: vlm.model_name(),
        messages: messages(vlm, prompt, picture),
        stream: false,
        temperature: (vlm.temperature >= 0.0).then_some(vlm.temperature),
        max_completion_tokens: names_completion.then_some(vlm.tokens_max),
        max_tokens: (!names_completion).then_some(vlm.tokens_max),
        response_format: schema.filter(|_| !is_vllm).map(|schema| ResponseFormat {
            r#type: "json_schema",
            json_schema: NamedSchema {
                name: "comparison",
                strict: true,
                schema,
            },
        }),
        structured_outputs: schema
            .filter(|_| is_vllm)
            .map(|json| StructuredOutputs { json }),
    };
    serde_json::to_vec(&body).expect("strings and numbers are JSON")
}

fn messages<'a>(vlm: &Vlm, prompt: &'a Prompt, picture: &Picture) -> Vec<Message<'a>> {
    let system = (!prompt.system.is_empty()).then_some(Message {
        role: "system",
        content: Content::Text(&prompt.system),
    });
    let image_url = ImageUrl {
        url: format!(
            "data:{};base64,{}",
            picture.encoding.mime(),
            STANDARD.encode(&picture.bytes)
        ),
        // vLLM warns of the setting and goes on without; the others never look.
        detail: (vlm.dialect == Dialect::Openai).then_some(vlm.detail.word()),
    };
    let user = Message {
        role: "user",
        content: Content::Parts([
            Part::Text { text: &prompt.user },
            Part::ImageUrl { image_url },
        ]),
    };
    system.into_iter().chain([user]).collect()
}
