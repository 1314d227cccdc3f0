//! Reads the body of a response with status 200: the result is a reply, or the one
//! reason why there is none. Nothing is guessed or repaired: a model that does not keep
//! to the requested form is not trusted with the driving decision.

use serde_json::{Map, Value};
use shm_config::config::PromptPreset;

use super::{Fault, json};
use crate::presentation::{LETTERS, Party, Prompt, Reply, SIMILAR};

/// Deepest nesting of a chat completion; those of the known servers have 8 levels at
/// most.
const ENVELOPE_DEPTH_MAX: u32 = 32;

/// Deepest nesting of what the model says: one object that holds no other.
const CONTENT_DEPTH_MAX: u32 = 4;

/// More tokens than any question has. A larger count is a server's mistake and must not
/// spend the budget.
const TOKENS_MAX: u64 = 10_000_000;

/// The content of a response with status 200.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// The reply and the model's confidence, or why there is no reply.
    pub reply: Result<(Reply, Option<f64>), Fault>,
    /// What the model said, or the whole body where the model's text cannot be found.
    pub said: String,
    /// Tokens in and out, as the server counts them.
    pub tokens: Option<[u64; 2]>,
    /// The model that answered, as the server names it; empty when it does not.
    pub served: String,
}

impl Reading {
    fn fault(fault: Fault, said: &str) -> Self {
        Self {
            reply: Err(fault),
            said: said.into(),
            tokens: None,
            served: String::new(),
        }
    }
}

/// Whether a content type is JSON.
pub fn is_json(content_type: Option<&str>) -> bool {
    let essence = content_type.map(|text| text.split(';').next().unwrap_or(text));
    essence.is_some_and(|text| text.trim().eq_ignore_ascii_case("application/json"))
}

/// Reads the body of a chat completion.
pub fn read(body: &[u8], prompt: &Prompt) -> Reading {
    let Ok(text) = str::from_utf8(body) else {
        return Reading::fault(Fault::InvalidUtf8, &String::from_utf8_lossy(body));
    };
    if text.trim().is_empty() {
        return Reading::fault(Fault::EmptyBody, text);
    }
    let envelope = match json::read(text, ENVELOPE_DEPTH_MAX) {
        Ok(envelope) => envelope,
        Err(fault) => return Reading::fault(fault, text),
    };
    let tokens = tokens(&envelope);
    let content = content(&envelope);
    let reply = content.and_then(|content| reply(content, prompt));
    let cut_off = || message(&envelope)?.get("content")?.as_str();
    let said = content
        .ok()
        .or_else(|| refusal(&envelope))
        .or_else(cut_off)
        .unwrap_or(text);
    let served = envelope.get("model").and_then(Value::as_str);
    Reading {
        reply,
        said: said.into(),
        tokens,
        served: served.unwrap_or_default().into(),
    }
}

/// Tokens in and out; `None` unless both counts are there and plausible.
fn tokens(envelope: &Value) -> Option<[u64; 2]> {
    let count = |key: &str| {
        let count = envelope.get("usage")?.get(key)?.as_u64();
        count.filter(|count| *count <= TOKENS_MAX)
    };
    Some([count("prompt_tokens")?, count("completion_tokens")?])
}

/// A refusal that the model gives in place of an answer; only OpenAI has a field for
/// it.
fn refusal(envelope: &Value) -> Option<&str> {
    message(envelope)?.get("refusal")?.as_str()
}

fn message(envelope: &Value) -> Option<&Value> {
    envelope.get("choices")?.get(0)?.get("message")
}

/// What the model said, if it was not cut off.
fn content(envelope: &Value) -> Result<&str, Fault> {
    let choices = envelope.get("choices").and_then(Value::as_array);
    let choice = match choices.ok_or(Fault::Envelope)?.as_slice() {
        [] => return Err(Fault::NoChoices),
        [choice] => choice,
        _ => return Err(Fault::BothAnswers),
    };
    let message = choice.get("message").ok_or(Fault::Envelope)?;
    if refusal(envelope).is_some_and(|text| !text.is_empty()) {
        return Err(Fault::Refused);
    }
    match choice.get("finish_reason").and_then(Value::as_str) {
        Some("stop") => {}
        Some("length") => return Err(Fault::Length),
        Some("content_filter") => return Err(Fault::ContentFilter),
        _ => return Err(Fault::Unfinished),
    }
    match message.get("content") {
        Some(Value::String(text)) if text.trim().is_empty() => Err(Fault::NoContent),
        Some(Value::String(text)) => Ok(text),
        None | Some(Value::Null) => Err(Fault::NoContent),
        Some(_) => Err(Fault::Envelope),
    }
}

/// The reply in the model's text.
fn reply(content: &str, prompt: &Prompt) -> Result<(Reply, Option<f64>), Fault> {
    let text = content.trim();
    if text.starts_with("```") {
        return Err(Fault::CodeFence);
    }
    if !text.starts_with('{') {
        return Err(without_object(text));
    }
    let (value, end) = json::read_first(text, CONTENT_DEPTH_MAX)?;
    let rest = text[end..].trim();
    if holds_answer(rest) {
        return Err(Fault::BothAnswers);
    }
    let object = value.as_object().ok_or(Fault::WrongType)?;
    match prompt.preset {
        PromptPreset::Blind if !rest.is_empty() => Err(Fault::TrailingText),
        PromptPreset::Blind => blind(object),
        // The paper's prompt asks for a sentence after the object.
        PromptPreset::Paper => paper(object, prompt),
    }
}

/// The fault of a text that does not begin with an object.
fn without_object(text: &str) -> Fault {
    if text.contains('{') {
        return Fault::LeadingText;
    }
    match json::read(text, CONTENT_DEPTH_MAX) {
        Ok(_) => Fault::WrongType,
        Err(_) => Fault::NotJson,
    }
}

/// Whether `text` holds another object with an answer.
fn holds_answer(text: &str) -> bool {
    text.match_indices('{').any(|(at, _)| {
        json::read_first(&text[at..], CONTENT_DEPTH_MAX)
            .is_ok_and(|(value, _)| value.get("response").is_some())
    })
}

fn blind(object: &Map<String, Value>) -> Result<(Reply, Option<f64>), Fault> {
    let reply = match object.get("response").ok_or(Fault::MissingField)? {
        Value::String(word) if word == LETTERS[0] => Reply::First,
        Value::String(word) if word == LETTERS[1] => Reply::Second,
        Value::String(word) if word == SIMILAR => Reply::Similar,
        Value::String(word) if names_both(word) => return Err(Fault::BothAnswers),
        Value::String(_) => return Err(Fault::OutOfRange),
        other => return Err(not_one(other)),
    };
    only(object, &["reason", "response", "confidence"])?;
    let confidence = object.get("confidence").ok_or(Fault::MissingField)?;
    let confidence = match confidence {
        Value::Number(number) => number.as_f64().ok_or(Fault::WrongType)?,
        _ => return Err(Fault::WrongType),
    };
    if !(0.0..=1.0).contains(&confidence) {
        return Err(Fault::OutOfRange);
    }
    match object.get("reason").ok_or(Fault::MissingField)? {
        Value::String(_) => Ok((reply, Some(confidence))),
        _ => Err(Fault::WrongType),
    }
}

/// 1: the expert is better, in either place of the picture. 0: the paths are similar.
fn paper(object: &Map<String, Value>, prompt: &Prompt) -> Result<(Reply, Option<f64>), Fault> {
    let expert = match prompt.showing.first {
        Party::Expert => Reply::First,
        Party::Policy => Reply::Second,
    };
    let reply = match object.get("response").ok_or(Fault::MissingField)? {
        Value::Number(number) if number.is_f64() => return Err(Fault::WrongType),
        Value::Number(number) => match number.as_u64() {
            Some(0) => Reply::Similar,
            Some(1) => expert,
            _ => return Err(Fault::OutOfRange),
        },
        other => return Err(not_one(other)),
    };
    only(object, &["response", "reason"])?;
    match object.get("reason") {
        None | Some(Value::String(_)) => Ok((reply, None)),
        Some(_) => Err(Fault::WrongType),
    }
}

/// The fault of a value of the wrong type or outside the allowed values.
fn not_one(value: &Value) -> Fault {
    match value {
        Value::Array(values) if values.len() > 1 => Fault::BothAnswers,
        _ => Fault::WrongType,
    }
}

/// "A and B", "A/B", "both".
fn names_both(word: &str) -> bool {
    let words: Vec<_> = word.split(|c: char| !c.is_alphanumeric()).collect();
    words.contains(&"both") || LETTERS.iter().all(|letter| words.contains(letter))
}

fn only(object: &Map<String, Value>, keys: &[&str]) -> Result<(), Fault> {
    match object.keys().all(|key| keys.contains(&key.as_str())) {
        true => Ok(()),
        false => Err(Fault::ExtraField),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;
    use shm_config::config::View;

    use super::*;
    use crate::presentation::Showing;

    fn prompt(preset: PromptPreset) -> Prompt {
        Prompt::new(preset, Showing::PAPER, View::Ego, 3.0)
    }

    fn completion(content: Value) -> Value {
        json!({
            "id": "x", "object": "chat.completion",
            "choices": [{
                "index": 0, "finish_reason": "stop",
                "message": {"role": "assistant", "content": content, "refusal": null},
            }],
            "usage": {"prompt_tokens": 900, "completion_tokens": 12, "total_tokens": 912},
        })
    }

    fn said(content: &str, preset: PromptPreset) -> Result<(Reply, Option<f64>), Fault> {
        let body = completion(content.into()).to_string();
        let reading = read(body.as_bytes(), &prompt(preset));
        assert_eq!(reading.tokens, Some([900, 12]), "{content}");
        reading.reply
    }

    #[test]
    fn answers_in_the_form_asked_for_are_replies() {
        let blind = |response: &str| {
            let text =
                format!("{{\"reason\": \"x\", \"response\": \"{response}\", \"confidence\": 0.5}}");
            said(&text, PromptPreset::Blind)
        };
        assert_eq!(blind("A"), Ok((Reply::First, Some(0.5))));
        assert_eq!(blind("B"), Ok((Reply::Second, Some(0.5))));
        assert_eq!(blind("similar"), Ok((Reply::Similar, Some(0.5))));
        let spaced = " \n{\"confidence\":1,\"response\":\"A\",\"reason\":\"\"}\n";
        let sure = said(spaced, PromptPreset::Blind);
        assert_eq!(sure, Ok((Reply::First, Some(1.0))));
    }

    #[test]
    fn the_papers_one_means_the_expert_in_both_places() {
        let text = "{\"response\": 1}\nThe green path keeps {to} the lane.";
        assert_eq!(said(text, PromptPreset::Paper), Ok((Reply::First, None)));
        let body = completion(text.into()).to_string();
        let mut swapped = prompt(PromptPreset::Paper);
        swapped.showing = swapped.showing.swapped();
        assert_eq!(
            read(body.as_bytes(), &swapped).reply,
            Ok((Reply::Second, None))
        );
        let zero = "{\"response\": 0, \"reason\": \"alike\"}";
        assert_eq!(said(zero, PromptPreset::Paper), Ok((Reply::Similar, None)));
    }

    #[test]
    fn invalid_answers_to_the_papers_prompt_are_faults() {
        for (text, fault) in [
            ("{\"response\": \"1\"}", Fault::WrongType),
            ("{\"response\": true}", Fault::WrongType),
            ("{\"response\": 1.0}", Fault::WrongType),
            ("{\"response\": 1e0}", Fault::WrongType),
            ("{\"response\": -0}", Fault::WrongType),
            ("{\"response\": null}", Fault::WrongType),
            ("{\"response\": {}}", Fault::WrongType),
            ("{\"response\": [1]}", Fault::WrongType),
            ("{\"response\": [1, 0]}", Fault::BothAnswers),
            ("{\"response\": 2}", Fault::OutOfRange),
            ("{\"response\": -1}", Fault::OutOfRange),
            ("{\"response\": 18446744073709551616}", Fault::WrongType),
            ("{\"response\": 1}{\"response\": 0}", Fault::BothAnswers),
            (
                "{\"response\": 0} or rather {\"response\": 1}",
                Fault::BothAnswers,
            ),
            ("{\"response\": 0, \"response\": 1}", Fault::DuplicateKeys),
            ("{\"answer\": 1}", Fault::MissingField),
            ("{\"response\": 1, \"novice\": 0}", Fault::ExtraField),
            ("{\"response\": 1, \"reason\": 3}", Fault::WrongType),
            ("{\"response\": 1", Fault::Truncated),
            ("{response: 1}", Fault::NotJson),
            ("```json\n{\"response\": 1}\n```", Fault::CodeFence),
            ("Sure: {\"response\": 1}", Fault::LeadingText),
            ("1", Fault::WrongType),
            ("I cannot say.", Fault::NotJson),
            (
                "{\"response\": {\"a\": {\"b\": {\"c\": {\"d\": 1}}}}}",
                Fault::TooDeep,
            ),
            (" \n", Fault::NoContent),
        ] {
            assert_eq!(said(text, PromptPreset::Paper), Err(fault), "{text}");
        }
    }

    #[test]
    fn invalid_answers_to_the_blind_prompt_are_faults() {
        let with = |response: &str| {
            format!("{{\"reason\": \"x\", \"response\": {response}, \"confidence\": 0.5}}")
        };
        for (response, fault) in [
            ("1", Fault::WrongType),
            ("true", Fault::WrongType),
            ("null", Fault::WrongType),
            ("\"a\"", Fault::OutOfRange),
            ("\"C\"", Fault::OutOfRange),
            ("\"\"", Fault::OutOfRange),
            ("\"A and B\"", Fault::BothAnswers),
            ("\"A|B\"", Fault::BothAnswers),
            ("\"both\"", Fault::BothAnswers),
            ("[\"A\", \"B\"]", Fault::BothAnswers),
        ] {
            let text = with(response);
            assert_eq!(said(&text, PromptPreset::Blind), Err(fault), "{text}");
        }
        let good = with("\"A\"");
        for (text, fault) in [
            (format!("{good} It is safer."), Fault::TrailingText),
            (format!("{good}{good}"), Fault::BothAnswers),
            (format!("Well. {good}"), Fault::LeadingText),
            (format!("```\n{good}\n```"), Fault::CodeFence),
            (good.replace("0.5", "1.01"), Fault::OutOfRange),
            (good.replace("0.5", "-0.01"), Fault::OutOfRange),
            (good.replace("0.5", "\"0.5\""), Fault::WrongType),
            (good.replace("0.5", "null"), Fault::WrongType),
            (good.replace("\"x\"", "[]"), Fault::WrongType),
            (good.replace("\"reason\"", "\"why\""), Fault::ExtraField),
            (
                "{\"response\": \"A\", \"reason\": \"x\"}".into(),
                Fault::MissingField,
            ),
            (
                "{\"response\": \"A\", \"confidence\": 1}".into(),
                Fault::MissingField,
            ),
        ] {
            assert_eq!(said(&text, PromptPreset::Blind), Err(fault), "{text}");
        }
    }

    #[test]
    fn invalid_completions_are_faults() {
        let read = |body: &Value| {
            let body = body.to_string();
            super::read(body.as_bytes(), &prompt(PromptPreset::Paper)).reply
        };
        let good = completion("{\"response\": 1}".into());
        assert!(read(&good).is_ok());
        type Change = fn(&mut Value);
        let cases: &[(Change, Fault)] = &[
            (|body| body["choices"] = json!([]), Fault::NoChoices),
            (|body| body["choices"] = json!("x"), Fault::Envelope),
            (|body| *body = json!({"error": "x"}), Fault::Envelope),
            (|body| *body = json!([1]), Fault::Envelope),
            (|body| body["choices"][0] = json!({}), Fault::Envelope),
            (
                |body| body["choices"] = json!([body["choices"][0], body["choices"][0]]),
                Fault::BothAnswers,
            ),
            (|body| finish(body, json!("length")), Fault::Length),
            (
                |body| finish(body, json!("content_filter")),
                Fault::ContentFilter,
            ),
            (|body| finish(body, json!("tool_calls")), Fault::Unfinished),
            (|body| finish(body, Value::Null), Fault::Unfinished),
            (
                |body| message(body)["content"] = Value::Null,
                Fault::NoContent,
            ),
            (|body| message(body)["content"] = json!([]), Fault::Envelope),
            (
                |body| {
                    message(body)["content"] = Value::Null;
                    message(body)["refusal"] = json!("I would rather not.");
                },
                Fault::Refused,
            ),
        ];
        for (change, fault) in cases {
            let mut body = good.clone();
            change(&mut body);
            assert_eq!(read(&body), Err(*fault), "{body}");
        }
    }

    fn message(body: &mut Value) -> &mut Value {
        &mut body["choices"][0]["message"]
    }

    fn finish(body: &mut Value, reason: Value) {
        body["choices"][0]["finish_reason"] = reason;
    }

    #[test]
    fn bytes_without_a_completion_are_faults() {
        let nested = format!("{}{}", "[".repeat(5000), "]".repeat(5000));
        for (body, fault) in [
            (&b""[..], Fault::EmptyBody),
            (b" \r\n", Fault::EmptyBody),
            (b"\xff\xfe{}", Fault::InvalidUtf8),
            (b"{\"choices\": [", Fault::Truncated),
            (b"<html>", Fault::NotJson),
            (b"{} {}", Fault::NotJson),
            (b"{\"id\": 1, \"id\": 2}", Fault::DuplicateKeys),
            (nested.as_bytes(), Fault::TooDeep),
        ] {
            let reading = read(body, &prompt(PromptPreset::Blind));
            assert_eq!(reading.reply, Err(fault), "{}", reading.said);
        }
    }

    #[test]
    fn impossible_token_counts_count_as_unknown() {
        let counted = |usage: Value| {
            let mut body = completion("{\"response\": 1}".into());
            body["usage"] = usage;
            let reading = read(body.to_string().as_bytes(), &prompt(PromptPreset::Paper));
            assert!(reading.reply.is_ok());
            reading.tokens
        };
        let usage = |tokens_in: Value, tokens_out: Value| json!({"prompt_tokens": tokens_in, "completion_tokens": tokens_out});
        assert_eq!(counted(usage(json!(7), json!(3))), Some([7, 3]));
        for usage in [
            usage(json!(u64::MAX), json!(3)),
            usage(json!(7), json!(-3)),
            usage(json!(7.5), json!(3)),
            usage(json!(7), Value::Null),
            Value::Null,
        ] {
            assert_eq!(counted(usage.clone()), None, "{usage}");
        }
    }

    #[test]
    fn json_is_recognised_by_its_content_type() {
        for (text, expected) in [
            (Some("application/json"), true),
            (Some("Application/JSON; charset=utf-8"), true),
            (Some("text/html"), false),
            (Some("application/jsonl"), false),
            (None, false),
        ] {
            assert_eq!(is_json(text), expected, "{text:?}");
        }
    }
}
