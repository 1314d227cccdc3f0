//! The HTTP routes of the stand-in, without faults.

use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};

use axum::Router;
use axum::body::Bytes;
use axum::extract::{DefaultBodyLimit, State};
use axum::http::header::{CONNECTION, CONTENT_TYPE, HeaderName, HeaderValue, RETRY_AFTER};
use axum::http::{HeaderMap, StatusCode};
use axum::response::IntoResponse;
use axum::routing::{get, post};
use serde_json::{Value, json};
use shm_config::config::PromptPreset;

use super::question::Question;
use super::{NAME, Rating, Shared};
use gate::presentation::Reply;
use gate::presentation::{LETTERS, SIMILAR};

/// Maximum length of a request, bytes.
const REQUEST_BYTES_MAX: usize = 64 << 20;

/// Shown in each place where a client could mistake the stand-in for a model.
const NOTE: &str = "a stand-in for tests: it judges by the colours of pixels, there is no model";

pub fn router(shared: Arc<Shared>) -> Router {
    Router::new()
        .route("/v1/chat/completions", post(complete))
        .route("/v1/models", get(models))
        .route("/health", get(health))
        .layer(DefaultBodyLimit::max(REQUEST_BYTES_MAX))
        .with_state(shared)
}

async fn health() -> impl IntoResponse {
    json_of(json!({"status": "ok", "stand_in": true, "note": NOTE}))
}

async fn models() -> impl IntoResponse {
    let model = json!({"id": NAME, "object": "model", "created": 0, "owned_by": NOTE});
    json_of(json!({"object": "list", "data": [model]}))
}

async fn complete(State(shared): State<Arc<Shared>>, body: Bytes) -> impl IntoResponse {
    shared.requests.fetch_add(1, Ordering::Relaxed);
    let jitter = shared.options.jitter.mul_f64(shared.draw());
    let answer_at = tokio::time::Instant::now() + shared.options.latency + jitter;
    let mut headers = HeaderMap::new();
    if shared.options.injected.is_some() {
        // Faults are drawn per connection, so each request needs its own.
        headers.insert(CONNECTION, HeaderValue::from_static("close"));
    }
    if let Some(wait_s) = wait_s(&shared) {
        headers.insert(RETRY_AFTER, HeaderValue::from(wait_s.ceil() as u64));
        let milliseconds = HeaderValue::from((wait_s * 1e3).ceil() as u64);
        headers.insert(HeaderName::from_static("retry-after-ms"), milliseconds);
        let error = error("too many requests", "rate_limit_exceeded");
        return (StatusCode::TOO_MANY_REQUESTS, headers, json_of(error));
    }
    // Pictures are examined in another thread, so that connections are not blocked.
    let state = shared.clone();
    let seen = tokio::task::spawn_blocking(move || answer(&state, &body)).await;
    let (status, said) = match seen {
        Ok(Ok(said)) => (StatusCode::OK, said),
        Ok(Err(why)) => (
            StatusCode::BAD_REQUEST,
            error(&why, "invalid_request_error"),
        ),
        Err(_) => (
            StatusCode::INTERNAL_SERVER_ERROR,
            error("the picture's examination failed", "server_error"),
        ),
    };
    tokio::time::sleep_until(answer_at).await;
    (status, headers, json_of(said))
}

/// Time until the next request is allowed, s; `None` if this one is.
fn wait_s(shared: &Shared) -> Option<f64> {
    let rate = shared.rate.as_ref()?;
    let mut rate = rate.lock().unwrap_or_else(PoisonError::into_inner);
    let wait = rate.admit(shared.begun.elapsed()).err()?;
    Some(wait.as_secs_f64())
}

fn answer(shared: &Shared, body: &[u8]) -> Result<Value, String> {
    let question = Question::read(body)?;
    let options = &shared.options;
    let seen = options
        .rater
        .rate(&question.picture, question.hues, question.view);
    // Always drawn, so that one option does not change the draws of another.
    let [turned, first, abstains] =
        [options.noise, options.first_bias, options.abstain].map(|share| shared.draw() < share);
    let reply = match seen.reply {
        _ if abstains => Reply::Similar,
        _ if first => Reply::First,
        Reply::First if turned => Reply::Second,
        Reply::Second if turned => Reply::First,
        reply => reply,
    };
    let confidence = (seen.confidence * 100.0).round() / 100.0;
    let said = worded(question.preset, Rating { reply, confidence });
    let pixels = u64::from(question.picture.width()) * u64::from(question.picture.height());
    Ok(completion(&said, question.words as u64 / 4 + pixels / 784))
}

/// A valid answer in the form of a preset. The first path is the one that the prompt names
/// first; in the paper's prompt that is the expert's.
pub fn worded(preset: PromptPreset, seen: Rating) -> String {
    match preset {
        PromptPreset::Blind => {
            let response = match seen.reply {
                Reply::First => LETTERS[0],
                Reply::Second => LETTERS[1],
                Reply::Similar => SIMILAR,
            };
            let reason = match seen.reply {
                Reply::Similar => "Neither path is clearly safer.".into(),
                _ => format!("Path {response} avoids the obstacle that the other path meets."),
            };
            let confidence = seen.confidence;
            format!(
                "{{\"reason\": \"{reason}\", \"response\": \"{response}\", \
                 \"confidence\": {confidence}}}"
            )
        }
        PromptPreset::Paper => {
            let response = u8::from(seen.reply == Reply::First);
            format!("{{\"response\": {response}}}\nAccording to the picture.")
        }
    }
}

/// A chat completion.
pub fn completion(said: &str, tokens_in: u64) -> Value {
    let tokens_out = said.len() as u64 / 4;
    json!({
        "id": "stand-in",
        "object": "chat.completion",
        "created": 0,
        "model": NAME,
        "choices": [{
            "index": 0,
            "message": {"role": "assistant", "content": said},
            "finish_reason": "stop",
        }],
        "usage": {
            "prompt_tokens": tokens_in,
            "completion_tokens": tokens_out,
            "total_tokens": tokens_in + tokens_out,
        },
    })
}

/// An error in OpenAI's format.
pub fn error(message: &str, code: &str) -> Value {
    json!({"error": {"message": message, "type": code, "param": null, "code": code}})
}

fn json_of(value: Value) -> ([(HeaderName, &'static str); 1], String) {
    ([(CONTENT_TYPE, "application/json")], value.to_string())
}
