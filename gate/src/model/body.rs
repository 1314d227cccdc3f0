//! The body of a request: OpenAI's "chat completions", which the other servers
//! understand too.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::Serialize;
use shm_config::config::Vlm;

use crate::presentation::picture::Picture;
use crate::presentation::{Prompt, Schema};

use super::Fault;

/// Resolution at which the model looks, for servers that know the setting: `low` would
/// shrink the picture until the paths are one pixel wide.
const DETAIL: &str = "high";

/// The body of a request.
#[derive(Serialize)]
struct Body<'a> {
    model: &'a str,
    messages: Vec<Message<'a>>,
    stream: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    temperature: Option<f64>,
    // Reasoning models of OpenAI refuse the older `max_tokens`.
    max_completion_tokens: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    response_format: Option<ResponseFormat>,
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
    detail: &'static str,
}

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

/// The body of the request, JSON in UTF-8. The picture is inside it as a base64 `data:`
/// URL, because several servers cannot fetch a picture.
///
/// # Errors
/// [`Fault::Encoding`] when it cannot be written as JSON.
pub fn body(vlm: &Vlm, prompt: &Prompt, picture: &Picture) -> Result<Vec<u8>, Fault> {
    let body = Body {
        model: vlm.model_name(),
        messages: messages(prompt, picture),
        stream: false,
        temperature: (vlm.temperature >= 0.0).then_some(vlm.temperature),
        max_completion_tokens: vlm.tokens_max,
        response_format: prompt.schema().map(|schema| ResponseFormat {
            r#type: "json_schema",
            json_schema: NamedSchema {
                name: "comparison",
                strict: true,
                schema,
            },
        }),
    };
    serde_json::to_vec(&body).map_err(|_| Fault::Encoding)
}

fn messages<'a>(prompt: &'a Prompt, picture: &Picture) -> Vec<Message<'a>> {
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
        detail: DETAIL,
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
