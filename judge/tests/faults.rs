//! Every server fault over HTTP: no reply, one reason, a fixed number of requests, and
//! none after a permanent fault. The compiler enforces a row for each fault of the
//! stand-in.

use std::net::TcpListener;

use gate::model::{Asker, Fault};
use judge::standin::{Options, Server, ServerFault};
use shm_config::config::{PromptPreset, Vlm};

use crate::shared::{PATIENCE_S, ask, asker, prompt, red_ahead, vlm};

/// The expected result of a server fault; `None` where the answer is valid all the same.
fn expected(injected: ServerFault, preset: PromptPreset) -> Option<Fault> {
    let is_blind = preset == PromptPreset::Blind;
    Some(match injected {
        ServerFault::Hang => Fault::Timeout,
        ServerFault::SlowDrip => Fault::SlowBody,
        ServerFault::Reset | ServerFault::ResetMidBody | ServerFault::ShortBody => {
            Fault::ConnectionReset
        }
        ServerFault::Garbage => Fault::Protocol,
        ServerFault::Redirect => Fault::Redirect,
        ServerFault::BadRequest => Fault::BadRequest,
        ServerFault::Unauthorized => Fault::Unauthorized,
        ServerFault::Forbidden => Fault::Forbidden,
        ServerFault::NotFound => Fault::NotFound,
        ServerFault::RequestTimeout => Fault::RequestTimeout,
        ServerFault::Conflict => Fault::Conflict,
        ServerFault::RateLimited
        | ServerFault::RetryAfter
        | ServerFault::RetryAfterMs
        | ServerFault::RetryAfterDate
        | ServerFault::RetryAfterLong => Fault::RateLimited,
        ServerFault::Quota => Fault::Quota,
        ServerFault::ServerError => Fault::ServerError,
        ServerFault::BadGateway => Fault::BadGateway,
        ServerFault::ServiceUnavailable => Fault::ServiceUnavailable,
        ServerFault::GatewayTimeout => Fault::GatewayTimeout,
        ServerFault::Overloaded => Fault::Overloaded,
        ServerFault::EmptyBody => Fault::EmptyBody,
        ServerFault::Truncated => Fault::Truncated,
        ServerFault::CodeFence => Fault::CodeFence,
        ServerFault::LeadingText => Fault::LeadingText,
        ServerFault::TrailingText if is_blind => Fault::TrailingText,
        // The paper's prompt asks for a sentence after the answer.
        ServerFault::TrailingText => return None,
        // For the blind prompt, "1" names a path that does not exist, and 2 is not a name.
        ServerFault::TypeString if is_blind => Fault::OutOfRange,
        ServerFault::Two if !is_blind => Fault::OutOfRange,
        ServerFault::TypeString
        | ServerFault::TypeTrue
        | ServerFault::TypeFloat
        | ServerFault::TypeNull
        | ServerFault::Two => Fault::WrongType,
        ServerFault::BothAnswers => Fault::BothAnswers,
        ServerFault::ExtraField => Fault::ExtraField,
        ServerFault::DuplicateKeys => Fault::DuplicateKeys,
        ServerFault::DeepNesting => Fault::TooDeep,
        ServerFault::Refusal => Fault::Refused,
        ServerFault::Length => Fault::Length,
        ServerFault::ContentFilter => Fault::ContentFilter,
        ServerFault::NoChoices => Fault::NoChoices,
        ServerFault::NullContent => Fault::NoContent,
        ServerFault::ContentType => Fault::ContentType,
        ServerFault::InvalidUtf8 => Fault::InvalidUtf8,
        ServerFault::HugeBody | ServerFault::HugeLength => Fault::TooLarge,
    })
}

/// Whether the request is sent a second time.
fn is_retried(injected: ServerFault) -> bool {
    matches!(
        injected,
        ServerFault::Hang
            | ServerFault::SlowDrip
            | ServerFault::Reset
            | ServerFault::ResetMidBody
            | ServerFault::ShortBody
            | ServerFault::RequestTimeout
            | ServerFault::Conflict
            | ServerFault::RateLimited
            | ServerFault::RetryAfter
            | ServerFault::RetryAfterMs
            | ServerFault::RetryAfterDate
            | ServerFault::ServerError
            | ServerFault::BadGateway
            | ServerFault::ServiceUnavailable
            | ServerFault::GatewayTimeout
            | ServerFault::Overloaded
    )
}

/// Time limit of an attempt, s: short where nothing else ends it. `SlowDrip` needs time to
/// begin on a busy machine, and lasts many times as long.
fn attempt_s(injected: ServerFault) -> f64 {
    match injected {
        ServerFault::Hang => 0.15,
        ServerFault::SlowDrip => 1.0,
        _ => PATIENCE_S,
    }
}

fn broken(injected: ServerFault) -> Server {
    let options = Options {
        injected: Some(injected),
        ..Options::default()
    };
    Server::start(options).expect("started")
}

fn check(injected: ServerFault, preset: PromptPreset) {
    let at = format!("{} {}", injected.word(), preset.word());
    let fault = expected(injected, preset);
    let attempts = if is_retried(injected) { 2 } else { 1 };
    let server = broken(injected);
    let asker = asker(&Vlm {
        attempt_s: attempt_s(injected),
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
fn every_server_fault_is_its_own_fault_and_no_reply() {
    for injected in ServerFault::ALL {
        check(*injected, PromptPreset::Paper);
    }
}

#[test]
fn the_blind_prompt_is_as_strict() {
    let about_words = [
        ServerFault::CodeFence,
        ServerFault::LeadingText,
        ServerFault::TrailingText,
        ServerFault::TypeString,
        ServerFault::TypeTrue,
        ServerFault::TypeFloat,
        ServerFault::TypeNull,
        ServerFault::Two,
        ServerFault::BothAnswers,
        ServerFault::ExtraField,
        ServerFault::DuplicateKeys,
        ServerFault::DeepNesting,
        ServerFault::Refusal,
        ServerFault::Length,
        ServerFault::ContentFilter,
        ServerFault::NoChoices,
        ServerFault::NullContent,
    ];
    for injected in about_words {
        check(injected, PromptPreset::Blind);
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
fn a_port_without_a_server_is_one_fault() {
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
    for injected in [None, Some(ServerFault::Garbage)] {
        let server = Server::start(Options {
            injected,
            ..Options::default()
        })
        .expect("started");
        let (asker, asked) = ask_at(server.url().replace("http:", "https:"));
        assert_eq!(asked.reply, Err(Fault::Tls), "{injected:?}");
        assert_eq!((asked.attempts, asker.closed()), (1, None), "{injected:?}");
    }
}

#[test]
fn a_gigabyte_is_not_read() {
    let server = broken(ServerFault::HugeBody);
    let (_, asked) = ask_at(server.url());
    assert_eq!(asked.reply, Err(Fault::TooLarge));
    // What was read, and what the kernel's buffers between both have taken.
    let sent = server.bytes_sent();
    assert!(
        sent < 50_000_000,
        "{sent} bytes were taken of 1,000,000,000"
    );
    let server = broken(ServerFault::HugeLength);
    let (_, asked) = ask_at(server.url());
    assert_eq!(asked.reply, Err(Fault::TooLarge));
}

#[test]
fn a_retry_after_of_an_hour_is_obeyed() {
    let server = broken(ServerFault::RetryAfterLong);
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
        // Every fault: the gate counts it as a failure.
        let _: gate::query::Failure = fault.failure();
    }
}
