//! Every way in which a server can break, over real HTTP: no reply, one reason,
//! so many requests, and after a permanent one no more. A row for each mishap of
//! the stand-in is enforced by the compiler.

#[path = "../../gate/tests/shared/mod.rs"]
mod shared;

use std::net::TcpListener;

use gate::model::{Asker, Fault};
use judge::standin::{Mishap, Options, Server};
use shared::{PATIENCE_S, ask, asker, prompt, red_ahead, vlm};
use shm_config::config::{PromptPreset, Vlm};

/// What becomes of a mishap; `None` where the answer is good all the same.
fn expected(mishap: Mishap, preset: PromptPreset) -> Option<Fault> {
    let is_blind = preset == PromptPreset::Blind;
    Some(match mishap {
        Mishap::Hang => Fault::Timeout,
        Mishap::SlowDrip => Fault::SlowBody,
        Mishap::Reset | Mishap::ResetMidBody | Mishap::ShortBody => Fault::ConnectionReset,
        Mishap::Garbage => Fault::Protocol,
        Mishap::Redirect => Fault::Redirect,
        Mishap::BadRequest => Fault::BadRequest,
        Mishap::Unauthorized => Fault::Unauthorized,
        Mishap::Forbidden => Fault::Forbidden,
        Mishap::NotFound => Fault::NotFound,
        Mishap::RequestTimeout => Fault::RequestTimeout,
        Mishap::Conflict => Fault::Conflict,
        Mishap::RateLimited
        | Mishap::RetryAfter
        | Mishap::RetryAfterMs
        | Mishap::RetryAfterDate
        | Mishap::RetryAfterLong => Fault::RateLimited,
        Mishap::Quota => Fault::Quota,
        Mishap::ServerError => Fault::ServerError,
        Mishap::BadGateway => Fault::BadGateway,
        Mishap::ServiceUnavailable => Fault::ServiceUnavailable,
        Mishap::GatewayTimeout => Fault::GatewayTimeout,
        Mishap::Overloaded => Fault::Overloaded,
        Mishap::EmptyBody => Fault::EmptyBody,
        Mishap::Truncated => Fault::Truncated,
        Mishap::CodeFence => Fault::CodeFence,
        Mishap::LeadingText => Fault::LeadingText,
        Mishap::TrailingText if is_blind => Fault::TrailingText,
        // The paper's prompt asks for a sentence there.
        Mishap::TrailingText => return None,
        // To the blind prompt, "1" is the name of a path that is not there, and
        // 2 is no name.
        Mishap::TypeString if is_blind => Fault::OutOfRange,
        Mishap::Two if !is_blind => Fault::OutOfRange,
        Mishap::TypeString
        | Mishap::TypeTrue
        | Mishap::TypeFloat
        | Mishap::TypeNull
        | Mishap::Two => Fault::WrongType,
        Mishap::BothAnswers => Fault::BothAnswers,
        Mishap::ExtraField => Fault::ExtraField,
        Mishap::DuplicateKeys => Fault::DuplicateKeys,
        Mishap::DeepNesting => Fault::TooDeep,
        Mishap::Refusal => Fault::Refused,
        Mishap::Length => Fault::Length,
        Mishap::ContentFilter => Fault::ContentFilter,
        Mishap::NoChoices => Fault::NoChoices,
        Mishap::NullContent => Fault::NoContent,
        Mishap::ContentType => Fault::ContentType,
        Mishap::InvalidUtf8 => Fault::InvalidUtf8,
        Mishap::HugeBody | Mishap::HugeLength => Fault::TooLarge,
    })
}

/// The server is asked a second time.
fn is_retried(mishap: Mishap) -> bool {
    matches!(
        mishap,
        Mishap::Hang
            | Mishap::SlowDrip
            | Mishap::Reset
            | Mishap::ResetMidBody
            | Mishap::ShortBody
            | Mishap::RequestTimeout
            | Mishap::Conflict
            | Mishap::RateLimited
            | Mishap::RetryAfter
            | Mishap::RetryAfterMs
            | Mishap::RetryAfterDate
            | Mishap::ServerError
            | Mishap::BadGateway
            | Mishap::ServiceUnavailable
            | Mishap::GatewayTimeout
            | Mishap::Overloaded
    )
}

/// Short where nothing else ends the attempt; the dripping server needs time to
/// begin on a busy machine, and drips for many times as long.
fn attempt_s(mishap: Mishap) -> f64 {
    match mishap {
        Mishap::Hang => 0.15,
        Mishap::SlowDrip => 1.0,
        _ => PATIENCE_S,
    }
}

fn broken(mishap: Mishap) -> Server {
    let options = Options {
        mishap: Some(mishap),
        ..Options::default()
    };
    Server::start(options).expect("started")
}

fn check(mishap: Mishap, preset: PromptPreset) {
    let at = format!("{} {}", mishap.word(), preset.word());
    let fault = expected(mishap, preset);
    let attempts = if is_retried(mishap) { 2 } else { 1 };
    let server = broken(mishap);
    let asker = asker(&Vlm {
        attempt_s: attempt_s(mishap),
        ..vlm(server.url())
    });
    let (prompt, picture) = (prompt(preset), red_ahead());
    let asked = ask(&asker, &prompt, &picture, PATIENCE_S);
    assert_eq!(asked.reply.err(), fault, "{at}: {}", asked.said);
    assert_eq!(asked.attempts, attempts, "{at}");
    assert_eq!(server.requests(), u64::from(attempts), "{at}");
    let permanent = fault.filter(|fault| fault.is_permanent());
    assert_eq!(asker.closed(), permanent, "{at}");
    if let Some(fault) = permanent {
        let again = ask(&asker, &prompt, &picture, PATIENCE_S);
        assert_eq!((again.reply, again.attempts), (Err(fault), 0), "{at}");
        assert_eq!(server.requests(), 1, "{at}: not asked again");
    }
}

#[test]
fn every_mishap_is_its_own_fault_and_no_reply() {
    for mishap in Mishap::ALL {
        check(*mishap, PromptPreset::Paper);
    }
}

#[test]
fn the_blind_prompt_is_as_strict() {
    let about_words = [
        Mishap::CodeFence,
        Mishap::LeadingText,
        Mishap::TrailingText,
        Mishap::TypeString,
        Mishap::TypeTrue,
        Mishap::TypeFloat,
        Mishap::TypeNull,
        Mishap::Two,
        Mishap::BothAnswers,
        Mishap::ExtraField,
        Mishap::DuplicateKeys,
        Mishap::DeepNesting,
        Mishap::Refusal,
        Mishap::Length,
        Mishap::ContentFilter,
        Mishap::NoChoices,
        Mishap::NullContent,
    ];
    for mishap in about_words {
        check(mishap, PromptPreset::Blind);
    }
}

fn ask_at(server: String) -> (Asker, gate::model::Asked) {
    let asker = asker(&vlm(server));
    let asked = ask(
        &asker,
        &prompt(PromptPreset::Blind),
        &red_ahead(),
        PATIENCE_S,
    );
    (asker, asked)
}

#[test]
fn nobody_listens() {
    let port = TcpListener::bind("127.0.0.1:0")
        .and_then(|listener| listener.local_addr())
        .expect("a port that is free again")
        .port();
    let (asker, asked) = ask_at(format!("http://127.0.0.1:{port}/v1"));
    assert_eq!(asked.reply, Err(Fault::ConnectionRefused));
    assert_eq!((asked.attempts, asked.cost_usd), (2, 0.0));
    assert_eq!(asker.closed(), None);
}

#[test]
fn an_encrypted_connection_to_a_server_that_has_none() {
    for mishap in [None, Some(Mishap::Garbage)] {
        let server = Server::start(Options {
            mishap,
            ..Options::default()
        })
        .expect("started");
        let (asker, asked) = ask_at(server.url().replace("http:", "https:"));
        assert_eq!(asked.reply, Err(Fault::Tls), "{mishap:?}");
        assert_eq!((asked.attempts, asker.closed()), (1, None), "{mishap:?}");
    }
}

#[test]
fn a_gigabyte_is_not_read() {
    let server = broken(Mishap::HugeBody);
    let (_, asked) = ask_at(server.url());
    assert_eq!(asked.reply, Err(Fault::TooLarge));
    // What was read, and what the kernel's buffers between both have taken.
    let sent = server.bytes_sent();
    assert!(
        sent < 50_000_000,
        "{sent} bytes were taken of 1,000,000,000"
    );
    let server = broken(Mishap::HugeLength);
    let (_, asked) = ask_at(server.url());
    assert_eq!(asked.reply, Err(Fault::TooLarge));
}

#[test]
fn a_server_that_wants_an_hour_of_peace_has_it() {
    let server = broken(Mishap::RetryAfterLong);
    let (asker, asked) = ask_at(server.url());
    assert_eq!((asked.reply, asked.attempts), (Err(Fault::RateLimited), 1));
    let again = ask(&asker, &prompt(PromptPreset::Blind), &red_ahead(), 1.0);
    assert_eq!((again.reply, again.attempts), (Err(Fault::RateLimited), 0));
    assert_eq!(server.requests(), 1);
}

#[test]
fn every_fault_has_a_word_of_its_own_and_is_never_an_answer() {
    let words: std::collections::BTreeSet<_> =
        Fault::ALL.iter().map(|fault| fault.word()).collect();
    assert_eq!(words.len(), Fault::ALL.len());
    for fault in Fault::ALL {
        assert!(!fault.is_permanent() || !fault.is_retryable(), "{fault:?}");
        // Whatever it is, the gate is told of a failure.
        let _: gate::query::Failure = fault.failure();
    }
}
