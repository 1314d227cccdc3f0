//! Server faults. Each fault is a script of raw bytes and pauses, because an HTTP library
//! refuses to produce most of them.

use std::time::Duration;

use serde_json::{Value, json};
use shm_config::config::PromptPreset;

use super::Rating;
use super::routes::{completion, error, worded};
use gate::presentation::Reply;

/// Declares the closed list of faults with their names.
macro_rules! server_faults {
    ($($(#[$doc:meta])* $name:ident => $word:literal,)*) => {
        /// A fault of a server.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum ServerFault {
            $($(#[$doc])* $name,)*
        }

        impl ServerFault {
            /// All faults.
            pub const ALL: &[Self] = &[$(Self::$name,)*];

            /// The name on the command line.
            pub fn word(self) -> &'static str {
                match self {
                    $(Self::$name => $word,)*
                }
            }
        }
    };
}

server_faults! {
    /// Reads the question and never answers.
    Hang => "hang",
    /// Resets the connection before the answer.
    Reset => "reset",
    /// Resets the connection in the middle of the answer.
    ResetMidBody => "reset_mid_body",
    /// Closes the connection in order in the middle of the answer.
    ShortBody => "short_body",
    /// Answers with bytes that are neither HTTP nor TLS.
    Garbage => "garbage",
    /// Redirects to another address.
    Redirect => "redirect",
    /// 400.
    BadRequest => "400",
    /// 401; the message repeats the key.
    Unauthorized => "401",
    /// 403.
    Forbidden => "403",
    /// 404.
    NotFound => "404",
    /// 408.
    RequestTimeout => "408",
    /// 409.
    Conflict => "409",
    /// 429 without Retry-After.
    RateLimited => "429",
    /// 429 with a delay in seconds.
    RetryAfter => "429_retry_after",
    /// 429 with a delay in milliseconds.
    RetryAfterMs => "429_retry_after_ms",
    /// 429 with a date.
    RetryAfterDate => "429_retry_after_date",
    /// 429 with a delay of an hour.
    RetryAfterLong => "429_retry_after_long",
    /// 429 with OpenAI's error for an exhausted quota.
    Quota => "429_quota",
    /// 500.
    ServerError => "500",
    /// 502 with an HTML body, as from a proxy.
    BadGateway => "502",
    /// 503.
    ServiceUnavailable => "503",
    /// 504.
    GatewayTimeout => "504",
    /// 529.
    Overloaded => "529",
    /// 200 with an empty body.
    EmptyBody => "empty_body",
    /// JSON that is cut off.
    Truncated => "truncated",
    /// The answer is in a code fence.
    CodeFence => "code_fence",
    /// Text before the answer.
    LeadingText => "leading_text",
    /// Text after the answer.
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
    /// Both answers, one after the other.
    BothAnswers => "both_answers",
    /// An unexpected field.
    ExtraField => "extra_field",
    /// The key "response" twice.
    DuplicateKeys => "duplicate_keys",
    /// A thousand nested brackets.
    DeepNesting => "deep_nesting",
    /// The model refuses to answer.
    Refusal => "refusal",
    /// The model reached its token limit.
    Length => "length",
    /// A content filter cut the answer off.
    ContentFilter => "content_filter",
    /// An empty list of choices.
    NoChoices => "no_choices",
    /// A choice without content.
    NullContent => "null_content",
    /// A valid answer declared as HTML.
    ContentType => "content_type",
    /// Bytes that are not UTF-8.
    InvalidUtf8 => "invalid_utf8",
    /// A body of 1 GB without a declared length.
    HugeBody => "huge_body",
    /// A body of 10 MB with a declared length.
    HugeLength => "huge_length",
    /// A valid answer, one byte at a time.
    SlowDrip => "slow_drip",
}

/// One step of a script; the connection is closed after the last one.
pub enum Step {
    /// Sends bytes.
    Send(Vec<u8>),
    /// Sends bytes one by one at this interval.
    Drip(Vec<u8>, Duration),
    /// Sends this number of spaces, in HTTP chunks.
    Flood(u64),
    /// Waits for ever.
    Hang,
    /// Resets the connection.
    Reset,
}

/// Interval between the bytes of [`ServerFault::SlowDrip`].
const DRIP_EVERY: Duration = Duration::from_millis(20);

/// Length of [`ServerFault::HugeBody`], bytes.
const HUGE_BYTES: u64 = 1_000_000_000;

impl ServerFault {
    /// Whether the fault happens before any HTTP is read.
    pub(super) fn ignores_request(self) -> bool {
        self == Self::Garbage
    }

    /// The steps for a request that asks for an answer in this form with this
    /// `Authorization` header.
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

    /// Faults below HTTP, or of the body's bytes.
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

    /// Faults that are an HTTP status.
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

    /// Faults of the JSON object around the model's words.
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

    /// Faults in the model's words.
    fn content(self, preset: PromptPreset) -> String {
        let good = good(preset);
        // The answer's value as a valid reply writes it.
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

/// A valid reply of a model.
fn good(preset: PromptPreset) -> String {
    let seen = Rating {
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
