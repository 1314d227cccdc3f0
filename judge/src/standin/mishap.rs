//! How a server breaks. Each mishap is a script of raw bytes and pauses: a proper
//! HTTP library is too polite for most of them.

use std::time::Duration;

use serde_json::{Value, json};
use shm_config::config::PromptPreset;

use super::Sighting;
use super::routes::{completion, error, worded};
use gate::presentation::Reply;

/// Declares the closed list: each mishap with its name.
macro_rules! mishaps {
    ($($(#[$doc:meta])* $name:ident => $word:literal,)*) => {
        /// A way for a server to break.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Mishap {
            $($(#[$doc])* $name,)*
        }

        impl Mishap {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$name,)*];

            /// Its name on the command line.
            pub fn word(self) -> &'static str {
                match self {
                    $(Self::$name => $word,)*
                }
            }
        }
    };
}

mishaps! {
    /// Takes the question and never answers.
    Hang => "hang",
    /// Breaks the connection before it answers.
    Reset => "reset",
    /// Breaks the connection in the middle of its answer.
    ResetMidBody => "reset_mid_body",
    /// Ends in the middle of its answer, in good order.
    ShortBody => "short_body",
    /// Answers with bytes that are neither HTTP nor TLS.
    Garbage => "garbage",
    /// Points elsewhere.
    Redirect => "redirect",
    /// 400.
    BadRequest => "400",
    /// 401, repeating the key it was shown.
    Unauthorized => "401",
    /// 403.
    Forbidden => "403",
    /// 404.
    NotFound => "404",
    /// 408.
    RequestTimeout => "408",
    /// 409.
    Conflict => "409",
    /// 429 without a word about when to come back.
    RateLimited => "429",
    /// 429, in seconds.
    RetryAfter => "429_retry_after",
    /// 429, in milliseconds.
    RetryAfterMs => "429_retry_after_ms",
    /// 429, at a date.
    RetryAfterDate => "429_retry_after_date",
    /// 429, in an hour.
    RetryAfterLong => "429_retry_after_long",
    /// 429, as OpenAI says that the account is spent.
    Quota => "429_quota",
    /// 500.
    ServerError => "500",
    /// 502, as a proxy says it, in HTML.
    BadGateway => "502",
    /// 503.
    ServiceUnavailable => "503",
    /// 504.
    GatewayTimeout => "504",
    /// 529.
    Overloaded => "529",
    /// 200 without a byte.
    EmptyBody => "empty_body",
    /// JSON that ends in the middle.
    Truncated => "truncated",
    /// An answer in a code fence.
    CodeFence => "code_fence",
    /// Talk before the answer.
    LeadingText => "leading_text",
    /// Talk after the answer.
    TrailingText => "trailing_text",
    /// The answer is the string "1".
    TypeString => "type_string",
    /// The answer is true.
    TypeTrue => "type_true",
    /// The answer is 1.0.
    TypeFloat => "type_float",
    /// The answer is null.
    TypeNull => "type_null",
    /// The answer is 2.
    Two => "two",
    /// One answer, then the other.
    BothAnswers => "both_answers",
    /// An unexpected field.
    ExtraField => "extra_field",
    /// The key "response" twice.
    DuplicateKeys => "duplicate_keys",
    /// A thousand brackets.
    DeepNesting => "deep_nesting",
    /// The model will not say.
    Refusal => "refusal",
    /// The model reached its limit of tokens.
    Length => "length",
    /// A filter cut the answer off.
    ContentFilter => "content_filter",
    /// No choices.
    NoChoices => "no_choices",
    /// A choice that says nothing.
    NullContent => "null_content",
    /// A good answer, said to be HTML.
    ContentType => "content_type",
    /// Bytes that are no UTF-8.
    InvalidUtf8 => "invalid_utf8",
    /// A body of 1 GB, without its length.
    HugeBody => "huge_body",
    /// A body of 10 MB, with its length.
    HugeLength => "huge_length",
    /// A good answer, one byte at a time.
    SlowDrip => "slow_drip",
}

/// What to do with a connection, in turn. After the last it is closed.
pub enum Step {
    /// Hands bytes over.
    Send(Vec<u8>),
    /// Hands bytes over one by one, with so long between them.
    Drip(Vec<u8>, Duration),
    /// Hands over so many spaces, in chunks of HTTP.
    Flood(u64),
    /// Waits for ever.
    Hang,
    /// Breaks the connection off at once.
    Reset,
}

/// Between the bytes of [`Mishap::SlowDrip`].
const DRIP_EVERY: Duration = Duration::from_millis(20);

/// Length of [`Mishap::HugeBody`], bytes.
const HUGE_BYTES: u64 = 1_000_000_000;

impl Mishap {
    /// Breaks at connections that are not even HTTP.
    pub(super) fn ignores_request(self) -> bool {
        self == Self::Garbage
    }

    /// What to do about a request that asks for an answer in this form, and was
    /// made with this `Authorization`.
    pub(super) fn script(self, preset: PromptPreset, authorization: &str) -> Vec<Step> {
        if let Some(steps) = self.of_connection() {
            return steps;
        }
        if let Some(response) = self.of_status(authorization) {
            return vec![Step::Send(response)];
        }
        if let Some(body) = self.of_envelope(preset) {
            return vec![Step::Send(ok(body.to_string().as_bytes()))];
        }
        let content = self.content(preset);
        vec![Step::Send(ok(completion(&content, 100)
            .to_string()
            .as_bytes()))]
    }

    /// Those that are below HTTP, or about its body's bytes.
    fn of_connection(self) -> Option<Vec<Step>> {
        let good = completion(&good(PromptPreset::Blind), 100).to_string();
        let good = good.as_bytes();
        let half = |response: Vec<u8>| response[..response.len() / 2].to_vec();
        let json = "content-type: application/json\r\n";
        Some(match self {
            Self::Hang => vec![Step::Hang],
            Self::Reset => vec![Step::Reset],
            Self::ResetMidBody => vec![Step::Send(half(ok(good))), Step::Reset],
            Self::ShortBody => vec![Step::Send(half(ok(good)))],
            Self::Garbage => vec![Step::Send(b"\x00\x01\x02 no protocol \r\n\r\n".to_vec())],
            Self::EmptyBody => vec![Step::Send(ok(b""))],
            Self::Truncated => vec![Step::Send(ok(&good[..good.len() / 2]))],
            Self::InvalidUtf8 => {
                let mut bytes = good.to_vec();
                bytes[10] = 0xff;
                vec![Step::Send(ok(&bytes))]
            }
            Self::ContentType => {
                vec![Step::Send(response(
                    "200 OK",
                    "content-type: text/html\r\n",
                    good,
                ))]
            }
            Self::HugeBody => {
                let head = format!("HTTP/1.1 200 OK\r\n{json}transfer-encoding: chunked\r\n\r\n");
                vec![Step::Send(head.into_bytes()), Step::Flood(HUGE_BYTES)]
            }
            Self::HugeLength => vec![Step::Send(ok(&vec![b' '; 10_000_000]))],
            Self::SlowDrip => {
                let whole = ok(good);
                let head = whole.len() - good.len();
                vec![
                    Step::Send(whole[..head].to_vec()),
                    Step::Drip(good.to_vec(), DRIP_EVERY),
                ]
            }
            _ => return None,
        })
    }

    /// Those that are a status of their own.
    fn of_status(self, authorization: &str) -> Option<Vec<u8>> {
        let plain = |status: &str, headers: &str, code: &str| {
            let headers = format!("content-type: application/json\r\n{headers}");
            let body = error(&format!("the stand-in was told to say {status}"), code);
            Some(response(status, &headers, body.to_string().as_bytes()))
        };
        let many = |headers: &str| plain("429 Too Many Requests", headers, "rate_limit_exceeded");
        match self {
            Self::Redirect => plain(
                "307 Temporary Redirect",
                "location: /v1/elsewhere\r\n",
                "moved",
            ),
            Self::BadRequest => plain("400 Bad Request", "", "invalid_request_error"),
            Self::Unauthorized => {
                let why = format!("incorrect API key provided: {authorization}");
                let body = error(&why, "invalid_api_key").to_string();
                let json = "content-type: application/json\r\n";
                Some(response("401 Unauthorized", json, body.as_bytes()))
            }
            Self::Forbidden => plain("403 Forbidden", "", "permission_denied"),
            Self::NotFound => plain("404 Not Found", "", "model_not_found"),
            Self::RequestTimeout => plain("408 Request Timeout", "", "timeout"),
            Self::Conflict => plain("409 Conflict", "", "conflict"),
            Self::RateLimited => many(""),
            Self::RetryAfter => many("retry-after: 1\r\n"),
            Self::RetryAfterMs => many("retry-after-ms: 50\r\n"),
            Self::RetryAfterDate => many(
                "date: Sun, 06 Nov 1994 08:49:37 GMT\r\nretry-after: Sun, 06 Nov 1994 08:49:38 GMT\r\n",
            ),
            Self::RetryAfterLong => many("retry-after: 3600\r\n"),
            Self::Quota => plain(
                "429 Too Many Requests",
                "retry-after: 1\r\n",
                "insufficient_quota",
            ),
            Self::ServerError => plain("500 Internal Server Error", "", "server_error"),
            Self::BadGateway => Some(response(
                "502 Bad Gateway",
                "content-type: text/html\r\n",
                b"<html><body><h1>502 Bad Gateway</h1></body></html>",
            )),
            Self::ServiceUnavailable => plain("503 Service Unavailable", "", "unavailable"),
            Self::GatewayTimeout => plain("504 Gateway Timeout", "", "timeout"),
            Self::Overloaded => plain("529 Overloaded", "", "overloaded_error"),
            _ => None,
        }
    }

    /// Those that are about what stands around the model's words.
    fn of_envelope(self, preset: PromptPreset) -> Option<Value> {
        let mut body = completion(&good(preset), 100);
        let choice = &mut body["choices"][0];
        match self {
            Self::Refusal => {
                choice["message"]["content"] = Value::Null;
                choice["message"]["refusal"] = json!("I would rather not judge that.");
            }
            Self::Length => choice["finish_reason"] = json!("length"),
            Self::ContentFilter => choice["finish_reason"] = json!("content_filter"),
            Self::NullContent => choice["message"]["content"] = Value::Null,
            Self::NoChoices => body["choices"] = json!([]),
            _ => return None,
        }
        Some(body)
    }

    /// Those that are in the model's words.
    fn content(self, preset: PromptPreset) -> String {
        let good = good(preset);
        // The answer's value, as it is written in a good one.
        let value = match preset {
            PromptPreset::Blind => "\"A\"",
            PromptPreset::Paper => "1",
        };
        let key = "\"response\": ";
        let with = |other: &str| good.replace(&format!("{key}{value}"), &format!("{key}{other}"));
        match self {
            Self::CodeFence => format!("```json\n{good}\n```"),
            Self::LeadingText => format!("Here is my decision: {good}"),
            Self::TrailingText => format!("{good} I hope this helps."),
            Self::TypeString => with("\"1\""),
            Self::TypeTrue => with("true"),
            Self::TypeFloat => with("1.0"),
            Self::TypeNull => with("null"),
            Self::Two => with("2"),
            Self::BothAnswers => format!("{good}\n{good}"),
            Self::ExtraField => with(&format!("{value}, \"certainty\": 1")),
            Self::DuplicateKeys => with(&format!("{value}, {key}{value}")),
            Self::DeepNesting => with(&format!("{}{}", "[".repeat(1000), "]".repeat(1000))),
            _ => good,
        }
    }
}

/// What a model should say.
fn good(preset: PromptPreset) -> String {
    let seen = Sighting {
        reply: Reply::First,
        confidence: 0.9,
    };
    worded(preset, seen)
}

fn ok(body: &[u8]) -> Vec<u8> {
    response("200 OK", "content-type: application/json\r\n", body)
}

fn response(status: &str, headers: &str, body: &[u8]) -> Vec<u8> {
    let length = body.len();
    let head = format!(
        "HTTP/1.1 {status}\r\n{headers}content-length: {length}\r\nconnection: close\r\n\r\n"
    );
    [head.as_bytes(), body].concat()
}
