//! Questions over HTTP, and their limits: rate, concurrency, budget, circuit breaker.

use std::sync::Arc;
use std::time::Duration;

use gate::model::{Asked, Asker, Fault};
use gate::presentation::{Hue, Prompt, Reply};
use image::ImageFormat;
use judge::standin::{Options, Server, ServerFault};
use shm_config::config::{PromptPreset, View, Vlm};

use crate::shared::{PATIENCE_S, SHOWING, ask, asker, picture, prompt, red_ahead, runtime, vlm};

const BLIND: PromptPreset = PromptPreset::Blind;

fn start(options: Options) -> Server {
    Server::start(options).expect("started")
}

fn reply(asked: &Asked) -> Result<Reply, Fault> {
    asked.reply.map(|(reply, _)| reply)
}

#[test]
fn every_picture_format_is_answered_from_the_picture() {
    let server = start(Options::default());
    for format in [ImageFormat::Png, ImageFormat::Jpeg] {
        for (ahead, expected) in [(Hue::Red, Reply::First), (Hue::Blue, Reply::Second)] {
            let asker = asker(&Vlm {
                model: "any".into(),
                ..vlm(server.url())
            });
            let asked = ask(&asker, &prompt(BLIND), &picture(ahead, format), PATIENCE_S);
            let at = format!("{format:?} {ahead:?}: {asked:?}");
            assert_eq!(reply(&asked), Ok(expected), "{at}");
            let confidence = asked.reply.expect("a reply").1;
            assert!(confidence.is_some_and(|sure| sure > 0.5), "{at}");
            assert!(asked.tokens_in > 0 && asked.tokens_out > 0, "{at}");
            assert_eq!(asked.attempts, 1, "{at}");
        }
    }
}

#[test]
fn a_swapped_question_about_the_same_picture_has_the_same_answer() {
    let server = start(Options::default());
    let asker = asker(&vlm(server.url()));
    for view in [View::Ego, View::TopDown] {
        let [first, second] = SHOWING.hues;
        let other = gate::presentation::Showing {
            hues: [second, first],
            ..SHOWING
        };
        let replies = [SHOWING, other].map(|showing| {
            let prompt = Prompt::new(BLIND, showing, view, 3.0);
            reply(&ask(&asker, &prompt, &red_ahead(), PATIENCE_S))
        });
        assert_eq!(replies, [Ok(Reply::First), Ok(Reply::Second)]);
    }
}

#[test]
fn the_papers_prompt_is_answered_in_its_form() {
    let server = start(Options::default());
    let asker = asker(&vlm(server.url()));
    // The expert is red in the paper's figures.
    for (ahead, expected) in [(Hue::Red, Reply::First), (Hue::Blue, Reply::Similar)] {
        let picture = picture(ahead, ImageFormat::Png);
        let asked = ask(&asker, &prompt(PromptPreset::Paper), &picture, PATIENCE_S);
        assert_eq!(asked.reply, Ok((expected, None)), "{}", asked.said);
    }
}

#[test]
fn a_picture_without_the_paths_is_no_question() {
    let server = start(Options::default());
    let asker = asker(&vlm(server.url()));
    let mut bad = red_ahead();
    bad.bytes.truncate(40);
    let asked = ask(&asker, &prompt(BLIND), &bad, PATIENCE_S);
    assert_eq!(asked.reply, Err(Fault::BadRequest));
    assert_eq!((asked.attempts, asker.closed()), (1, None));
}

/// Sends `count` questions concurrently.
fn at_once(asker: Asker, count: usize) -> Vec<Asked> {
    let asker = Arc::new(asker);
    runtime().block_on(async {
        let questions: Vec<_> = (0..count)
            .map(|_| {
                let asker = asker.clone();
                let deadline = Duration::from_secs_f64(PATIENCE_S);
                tokio::spawn(async move { asker.ask(&prompt(BLIND), &red_ahead(), deadline).await })
            })
            .collect();
        let mut asked = Vec::new();
        for question in questions {
            asked.push(question.await.expect("asked"));
        }
        asked
    })
}

#[test]
fn a_question_without_a_place_fails_at_once() {
    let server = start(Options {
        latency: Duration::from_millis(300),
        ..Options::default()
    });
    let two_places = Vlm {
        in_flight_max: 2,
        ..vlm(server.url())
    };
    let asked = at_once(asker(&two_places), 5);
    let busy = asked.iter().filter(|asked| asked.reply == Err(Fault::Busy));
    assert!(busy.clone().all(|asked| asked.attempts == 0));
    assert_eq!(busy.count(), 3);
    assert_eq!(server.requests(), 2);
}

#[test]
fn no_minute_has_more_requests_than_allowed() {
    let server = start(Options::default());
    let asker = asker(&Vlm {
        per_minute_max: 3,
        ..vlm(server.url())
    });
    let faults: Vec<_> = (0..5)
        .map(|_| {
            ask(&asker, &prompt(BLIND), &red_ahead(), PATIENCE_S)
                .reply
                .err()
        })
        .collect();
    let own = Some(Fault::OwnRate);
    assert_eq!(faults, [None, None, None, own, own]);
    assert_eq!(server.requests(), 3);
}

#[test]
fn a_spent_budget_sends_no_request() {
    let server = start(Options::default());
    let dear = Vlm {
        price_in_usd: 1000.0,
        price_out_usd: 1000.0,
        ..vlm(server.url())
    };
    let once = asker(&dear).estimate(&prompt(BLIND), [120, 100]).cost_usd;
    let asker = asker(&Vlm {
        budget_usd: 1.5 * once,
        ..dear
    });
    let first = ask(&asker, &prompt(BLIND), &red_ahead(), PATIENCE_S);
    assert!(first.reply.is_ok());
    assert!(first.cost_usd > 0.0 && first.cost_usd < once, "by usage");
    assert!((asker.spent_usd() - first.cost_usd).abs() < 1e-9, "settled");
    let mut asked = 1;
    let last = loop {
        let next = ask(&asker, &prompt(BLIND), &red_ahead(), PATIENCE_S);
        if next.reply.is_err() {
            break next;
        }
        asked += 1;
        assert!(asked < 1000, "it ends");
    };
    assert_eq!((last.reply, last.attempts), (Err(Fault::Budget), 0));
    let trouble = asker.trouble().expect("it is spent");
    assert!(trouble.contains("vlm.budget_usd"), "{trouble}");
    assert_eq!(server.requests(), asked);
    assert!(asker.spent_usd() <= 1.5 * once);
}

#[test]
fn a_server_that_is_down_is_asked_again_after_a_pause() {
    let server = start(Options {
        injected: Some(ServerFault::ServerError),
        ..Options::default()
    });
    let asker = asker(&Vlm {
        attempts_max: 2,
        breaker_failures: 2,
        breaker_open_s: 2.0,
        ..vlm(server.url())
    });
    let next = || {
        let asked = ask(&asker, &prompt(BLIND), &red_ahead(), PATIENCE_S);
        (asked.reply.err(), asked.attempts)
    };
    assert_eq!(next(), (Some(Fault::ServerError), 2));
    assert_eq!(next(), (Some(Fault::ServerError), 2));
    let asked = server.requests();
    let mut alone = 0;
    while next() == (Some(Fault::BreakerOpen), 0) {
        alone += 1;
        runtime().block_on(async { tokio::time::sleep(Duration::from_millis(50)).await });
    }
    assert!(alone > 0, "left alone");
    assert_eq!(server.requests(), asked + 1, "one request tries it");
}

#[test]
fn a_question_counts_as_one_failure_however_many_attempts_it_took() {
    let server = start(Options {
        injected: Some(ServerFault::ServerError),
        ..Options::default()
    });
    let asker = asker(&Vlm {
        attempts_max: 3,
        breaker_failures: 2,
        breaker_open_s: PATIENCE_S,
        ..vlm(server.url())
    });
    let next = || {
        let asked = ask(&asker, &prompt(BLIND), &red_ahead(), PATIENCE_S);
        (asked.reply.err(), asked.attempts)
    };
    assert_eq!(next(), (Some(Fault::ServerError), 3));
    assert_eq!(asker.trouble(), None, "it may pass");
    assert_eq!(next(), (Some(Fault::ServerError), 3));
    assert_eq!(next(), (Some(Fault::BreakerOpen), 0));
    assert_eq!(server.requests(), 6);
    let trouble = asker.trouble().expect("it is left alone");
    assert!(
        ["http_500", "vlm.server", "it says: the stand-in was told"]
            .iter()
            .all(|part| trouble.contains(part)),
        "{trouble}"
    );
}

#[test]
fn a_refused_question_is_reported_once_with_the_servers_words() {
    for (injected, word, parts) in [
        (
            ServerFault::BadRequest,
            "http_400",
            ["vlm.model", "it says: the stand-in was told to say 400"],
        ),
        (ServerFault::Length, "length", ["cut off", "vlm.tokens_max"]),
    ] {
        let server = start(Options {
            injected: Some(injected),
            ..Options::default()
        });
        let asker = asker(&vlm(server.url()));
        assert_eq!(asker.trouble(), None);
        ask(&asker, &prompt(BLIND), &red_ahead(), PATIENCE_S);
        let trouble = asker.trouble().expect("the next is put alike");
        assert!(trouble.starts_with(word), "{trouble}");
        assert!(parts.iter().all(|part| trouble.contains(part)), "{trouble}");
        ask(&asker, &prompt(BLIND), &red_ahead(), PATIENCE_S);
        assert_eq!(asker.trouble(), Some(trouble));
        assert_eq!(asker.closed(), None, "the next may be another");
    }
}

#[test]
fn a_permanent_fault_is_reported_with_what_to_do() {
    for (injected, word, hint) in [
        (ServerFault::Unauthorized, "http_401", "vlm.key_file"),
        (ServerFault::Quota, "quota", "top up"),
        (ServerFault::NotFound, "http_404", "vlm.model"),
    ] {
        let server = start(Options {
            injected: Some(injected),
            ..Options::default()
        });
        let asker = asker(&vlm(server.url()));
        assert_eq!(asker.trouble(), None);
        ask(&asker, &prompt(BLIND), &red_ahead(), PATIENCE_S);
        let trouble = asker.trouble().expect("no more is asked");
        let parts = [word, "until the next start", hint];
        assert!(parts.iter().all(|part| trouble.contains(part)), "{trouble}");
    }
}

#[test]
fn the_stand_in_says_429_when_it_is_asked_too_often() {
    let server = start(Options {
        rate_per_minute: Some(2),
        ..Options::default()
    });
    let asker = asker(&vlm(server.url()));
    for _ in 0..2 {
        assert!(
            ask(&asker, &prompt(BLIND), &red_ahead(), PATIENCE_S)
                .reply
                .is_ok()
        );
    }
    // A minute is longer than the deadline, so no request waits for it.
    let asked = ask(&asker, &prompt(BLIND), &red_ahead(), 5.0);
    assert_eq!((asked.reply, asked.attempts), (Err(Fault::RateLimited), 1));
    let again = ask(&asker, &prompt(BLIND), &red_ahead(), 5.0);
    assert_eq!((again.reply, again.attempts), (Err(Fault::RateLimited), 0));
}

/// How often the replies to 200 questions were first, second, similar.
fn counts(options: Options) -> [usize; 3] {
    let server = start(options);
    let asker = asker(&vlm(server.url()));
    let runtime = runtime();
    let (prompt, picture) = (prompt(BLIND), red_ahead());
    let mut counts = [0; 3];
    for _ in 0..200 {
        let asked = asker.ask(&prompt, &picture, Duration::from_secs_f64(PATIENCE_S));
        match reply(&runtime.block_on(asked)).expect("a reply") {
            Reply::First => counts[0] += 1,
            Reply::Second => counts[1] += 1,
            Reply::Similar => counts[2] += 1,
        }
    }
    counts
}

#[test]
fn flaws_have_the_share_they_were_given() {
    // Four standard deviations of 200 draws: 0.14 at a share of one half.
    let near = |count: usize, share: f64| {
        let spread = 4.0 * (share * (1.0 - share) / 200.0).sqrt();
        (count as f64 / 200.0 - share).abs() < spread
    };
    let [first, second, similar] = counts(Options {
        noise: 0.3,
        seed: 1,
        ..Options::default()
    });
    assert!(
        near(second, 0.3) && first + second == 200,
        "{first} {second} {similar}"
    );
    let [first, second, similar] = counts(Options {
        abstain: 0.4,
        seed: 2,
        ..Options::default()
    });
    assert!(
        near(similar, 0.4) && second == 0,
        "{first} {second} {similar}"
    );
    // PathRater that see the second path as the safer one.
    let [first, second, similar] = counts(Options {
        noise: 1.0,
        first_bias: 0.72,
        seed: 3,
        ..Options::default()
    });
    assert!(
        near(first, 0.72) && similar == 0,
        "{first} {second} {similar}"
    );
}

#[test]
fn it_breaks_at_its_share_of_the_questions() {
    let server = start(Options {
        injected: Some(ServerFault::Refusal),
        injected_share: 0.5,
        seed: 4,
        ..Options::default()
    });
    let asker = asker(&vlm(server.url()));
    let runtime = runtime();
    let replies: Vec<_> = (0..60)
        .map(|_| {
            let deadline = Duration::from_secs_f64(PATIENCE_S);
            let (prompt, picture) = (prompt(BLIND), red_ahead());
            reply(&runtime.block_on(asker.ask(&prompt, &picture, deadline)))
        })
        .collect();
    let good = replies.iter().filter(|reply| **reply == Ok(Reply::First));
    let refused = replies
        .iter()
        .filter(|reply| **reply == Err(Fault::Refused));
    let (good, refused) = (good.count(), refused.count());
    assert_eq!(good + refused, 60, "{replies:?}");
    assert!((15..=45).contains(&good), "{good} of 60");
    assert_eq!(server.requests(), 60);
}

#[test]
fn it_says_that_it_is_no_model_and_ends_when_it_is_dropped() {
    let server = start(Options {
        injected: Some(ServerFault::Hang),
        ..Options::default()
    });
    let root = server.url().replace("/v1", "");
    let url = server.url();
    let get = |address: String| {
        let client = reqwest::Client::builder().no_proxy().tls_certs_only([]);
        runtime().block_on(async move {
            let _ = rustls::crypto::ring::default_provider().install_default();
            let response = client
                .build()
                .expect("a client")
                .get(address)
                .send()
                .await?;
            response.text().await
        })
    };
    let health = get(format!("{root}/health")).expect("healthy, however it breaks");
    assert!(health.contains("no model"), "{health}");
    let models = get(format!("{url}/models")).expect("models");
    assert!(models.contains("vlaps-stand-in"), "{models}");
    drop(server);
    let asked = ask(&asker(&vlm(url)), &prompt(BLIND), &red_ahead(), PATIENCE_S);
    assert_eq!(asked.reply, Err(Fault::ConnectionRefused));
}
