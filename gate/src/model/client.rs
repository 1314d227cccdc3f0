//! Asks a model over HTTP. A question is a picture, a prompt and a deadline; the result
//! is a reply or a fault, with its cost.

use std::fmt;
use std::hash::{BuildHasher as _, Hasher as _};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bytes::Bytes;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng as _, SeedableRng as _};
use reqwest::Url;
use reqwest::header::{ACCEPT, AUTHORIZATION, CONTENT_TYPE};
use shm_config::config::Vlm;
use shm_config::secret;
use shm_config::text::printable;
use tokio::sync::Semaphore;
use tokio::time::Instant;

use super::body::body;
use super::breaker::Breaker;
use super::connection::AskerError;
use super::cost::{Estimate, cost_usd, estimate};
use super::key::Key;
use super::limits::{Budget, Rate};
use super::{Fault, answer, connection, json, retry, transport};
use crate::presentation::picture::Picture;
use crate::presentation::{Prompt, Reply};

/// Bytes that are kept of a model's or a server's text.
pub const SAID_BYTES_MAX: usize = 4096;

/// Longest answer, bytes of the whole HTTP body; nothing is read beyond. 200 tokens with
/// their envelope are 2 kB; some servers add the model's reasoning.
const ANSWER_BYTES_MAX: usize = 256 * 1024;

/// Bytes that are kept of a model's name.
const SERVED_BYTES_MAX: usize = 128;

/// Characters that are shown of a server's error text.
const SHOWN_MAX: usize = 200;

/// Deepest nesting of a server's error body.
const ERROR_DEPTH_MAX: u32 = 16;

/// The result of one question.
#[derive(Debug, Clone, PartialEq)]
pub struct Asked {
    /// The reply and the model's confidence, or why there is no reply.
    pub reply: Result<(Reply, Option<f64>), Fault>,
    /// The last text of the model or the server; at most [`SAID_BYTES_MAX`].
    pub said: String,
    /// The model that answered, as the server names it; empty when it does not.
    pub served: String,
    /// HTTP requests made.
    pub attempts: u32,
    /// Time from the question to its end.
    pub latency: Duration,
    /// Tokens in, of all attempts, as the server counts them.
    pub tokens_in: u64,
    /// Tokens out, of all attempts, as the server counts them.
    pub tokens_out: u64,
    /// Cost of all attempts, US dollars; estimated where the server does not count
    /// tokens.
    pub cost_usd: f64,
}

/// A client of one model. Its limits hold over all its questions, so a run has one
/// client.
pub struct Asker {
    vlm: Vlm,
    client: reqwest::Client,
    url: Url,
    key: Option<Key>,
    places: Semaphore,
    begun: Instant,
    state: Mutex<State>,
}

struct State {
    breaker: Breaker,
    rate: Rate,
    budget: Budget,
    // Why no further question is asked.
    closed: Option<Fault>,
    // The last reason for which questions were not asked or not answered.
    trouble: Option<Trouble>,
    // Until then no request is made, because the server asked for it.
    hold_until: Duration,
    random: Xoshiro256PlusPlus,
}

/// Why questions are not asked or not answered until the user changes something.
struct Trouble {
    fault: Fault,
    /// The server's text at the first occurrence, on one line.
    said: String,
}

/// The result of one request.
struct Outcome {
    reply: Result<(Reply, Option<f64>), Fault>,
    said: String,
    served: String,
    tokens: Option<[u64; 2]>,
    // How long the server asks to wait.
    wait: Option<Duration>,
}

impl Outcome {
    fn fault(fault: Fault) -> Self {
        Self {
            reply: Err(fault),
            said: String::new(),
            served: String::new(),
            tokens: None,
            wait: None,
        }
    }
}

impl fmt::Debug for Asker {
    fn fmt(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        formatter
            .debug_struct("Asker")
            .field("url", &self.url.as_str())
            .field("model", &self.vlm.model_name())
            .finish_non_exhaustive()
    }
}

impl Asker {
    /// Reads the key and prepares connections; sends no request yet.
    ///
    /// # Errors
    /// When the address or the key cannot be used.
    pub fn new(vlm: &Vlm) -> Result<Self, AskerError> {
        Self::with_environment(vlm, secret::value)
    }

    /// As [`Asker::new`], with environment variables read by `variable`. The values it
    /// returns are overwritten after use.
    ///
    /// # Errors
    /// As [`Asker::new`].
    pub fn with_environment(
        vlm: &Vlm,
        variable: impl Fn(&str) -> Option<String>,
    ) -> Result<Self, AskerError> {
        let address = format!("{}/chat/completions", vlm.server.trim_end_matches('/'));
        let url: Url = address.parse().map_err(|error| AskerError::Server {
            server: vlm.server.clone(),
            why: format!("{error}"),
        })?;
        let key = Key::find(vlm, &url, variable)?;
        let random = std::hash::RandomState::new().build_hasher().finish();
        Ok(Self {
            client: connection::client(vlm, &url)?,
            places: Semaphore::new(vlm.in_flight_max as usize),
            begun: Instant::now(),
            state: Mutex::new(State {
                breaker: Breaker::new(
                    vlm.breaker_failures,
                    Duration::from_secs_f64(vlm.breaker_open_s),
                ),
                rate: Rate::new(vlm.per_minute_max),
                budget: Budget::new(vlm.budget_usd),
                closed: None,
                trouble: None,
                hold_until: Duration::ZERO,
                random: Xoshiro256PlusPlus::seed_from_u64(random),
            }),
            vlm: vlm.clone(),
            url,
            key,
        })
    }

    /// What one request about a picture of `size_px` (width, height) costs.
    pub fn estimate(&self, prompt: &Prompt, size_px: [u32; 2]) -> Estimate {
        estimate(&self.vlm, prompt, size_px)
    }

    /// Why no further question is asked; `None` while questions are asked.
    pub fn closed(&self) -> Option<Fault> {
        self.state().closed
    }

    /// Why questions are not asked or not answered, for good or for a while, and what
    /// to do: the last reason, with the server's text.
    pub fn trouble(&self) -> Option<String> {
        let state = self.state();
        let Trouble { fault, said } = state.trouble.as_ref()?;
        let what = match fault {
            Fault::Length => "the model is cut off before it has answered".into(),
            fault if fault.is_of_the_question() => "the server refuses the request".into(),
            Fault::Budget => "the run's budget is spent".into(),
            fault if fault.is_permanent() => {
                "no more questions are asked until the next start".into()
            }
            _ => format!(
                "the server gets no request for {} s at a time",
                self.vlm.breaker_open_s
            ),
        };
        let said = match said.as_str() {
            "" => String::new(),
            said => format!("; it says: {said}"),
        };
        Some(format!(
            "{}: {what}; {}{said}",
            fault.word(),
            fault.advice()
        ))
    }

    /// Cost of all questions so far, with the amount reserved for questions in flight,
    /// US dollars.
    pub fn spent_usd(&self) -> f64 {
        self.state().budget.spent_usd()
    }

    /// Asks one question; returns by the deadline.
    pub async fn ask(&self, prompt: &Prompt, picture: &Picture, deadline: Duration) -> Asked {
        let begun = Instant::now();
        let mut asked = Asked {
            reply: Err(Fault::Busy),
            said: String::new(),
            served: String::new(),
            attempts: 0,
            latency: Duration::ZERO,
            tokens_in: 0,
            tokens_out: 0,
            cost_usd: 0.0,
        };
        if let Ok(_place) = self.places.try_acquire() {
            self.insist(prompt, picture, begun + deadline, &mut asked)
                .await;
        }
        if let Err(fault) = asked.reply {
            self.note(fault, &asked.said);
        }
        asked.latency = begun.elapsed();
        tracing::debug!(
            fault = asked.reply.err().map(Fault::word),
            attempts = asked.attempts,
            latency_s = asked.latency.as_secs_f64(),
            "asked"
        );
        asked
    }

    /// Makes attempts until one succeeds, none can succeed, or the time is over.
    async fn insist(&self, prompt: &Prompt, picture: &Picture, until: Instant, asked: &mut Asked) {
        let size_px = [picture.width, picture.height];
        let reserve_usd = self.estimate(prompt, size_px).cost_usd;
        let body = match body(&self.vlm, prompt, picture) {
            Ok(body) => Bytes::from(body),
            Err(fault) => {
                asked.reply = Err(fault);
                return;
            }
        };
        for attempt in 0..self.vlm.attempts_max {
            if let Err(fault) = self.admit(reserve_usd, until).await {
                // The fault of an earlier attempt says more than the end of the time.
                if attempt == 0 {
                    asked.reply = Err(fault);
                }
                return;
            }
            asked.attempts += 1;
            let outcome = self.attempt(body.clone(), prompt, until).await;
            self.settle(&outcome, reserve_usd, asked);
            asked.reply = outcome.reply;
            asked.said = outcome.said;
            asked.served = outcome.served;
            let Err(fault) = asked.reply else { return };
            let wait = self.pause(attempt, outcome.wait);
            let is_last = attempt + 1 == self.vlm.attempts_max;
            if is_last || !fault.is_retryable() || Instant::now() + wait >= until {
                return;
            }
            tokio::time::sleep(wait).await;
        }
    }

    /// Whether a request may be made; reserves its price. Waits while the server has
    /// asked for a pause, if the question can wait that long.
    async fn admit(&self, reserve_usd: f64, until: Instant) -> Result<(), Fault> {
        let hold_until = self.begun + self.state().hold_until;
        if hold_until > Instant::now() {
            // A closed client answers at once.
            if let Some(fault) = self.closed() {
                return Err(fault);
            }
            if hold_until >= until {
                return Err(Fault::RateLimited);
            }
            tokio::time::sleep_until(hold_until).await;
        }
        let now = self.begun.elapsed();
        let mut state = self.state();
        if let Some(fault) = state.closed {
            return Err(fault);
        }
        if state.breaker.is_open(now) {
            return Err(Fault::BreakerOpen);
        }
        if !state.budget.reserve(reserve_usd) {
            return Err(Fault::Budget);
        }
        if state.rate.admit(now).is_err() {
            state.budget.settle(reserve_usd, 0.0);
            return Err(Fault::OwnRate);
        }
        state.breaker.admit(now);
        Ok(())
    }

    /// Makes one request within its time.
    async fn attempt(&self, body: Bytes, prompt: &Prompt, until: Instant) -> Outcome {
        let end = Instant::now() + Duration::from_secs_f64(self.vlm.attempt_s);
        let has_begun = AtomicBool::new(false);
        let exchange = self.exchange(body, prompt, &has_begun);
        match tokio::time::timeout_at(end.min(until), exchange).await {
            Ok(outcome) => outcome,
            Err(_) if has_begun.load(Ordering::Relaxed) => Outcome::fault(Fault::SlowBody),
            Err(_) => Outcome::fault(Fault::Timeout),
        }
    }

    async fn exchange(&self, body: Bytes, prompt: &Prompt, has_begun: &AtomicBool) -> Outcome {
        let mut request = self
            .client
            .post(self.url.clone())
            .header(CONTENT_TYPE, "application/json")
            .header(ACCEPT, "application/json")
            .body(body);
        if let Some(key) = &self.key {
            request = request.header(AUTHORIZATION, key.header());
        }
        let response = match request.send().await {
            Ok(response) => response,
            Err(error) => return Outcome::fault(transport::fault(&error)),
        };
        has_begun.store(true, Ordering::Relaxed);
        let status = response.status().as_u16();
        let wait = retry::asked(response.headers());
        let content_type = response.headers().get(CONTENT_TYPE);
        let is_json = answer::is_json(content_type.and_then(|value| value.to_str().ok()));
        if status == 200 && !is_json {
            return Outcome::fault(Fault::ContentType);
        }
        let (bytes, end) = transport::read_body(response, ANSWER_BYTES_MAX).await;
        if status != 200 {
            return self.refused(status, &bytes, wait);
        }
        match end {
            Ok(()) => {
                let reading = answer::read(&bytes, prompt);
                Outcome {
                    reply: reading.reply,
                    said: self.kept(&reading.said, SAID_BYTES_MAX),
                    served: self.kept(&reading.served, SERVED_BYTES_MAX),
                    tokens: reading.tokens,
                    wait: None,
                }
            }
            Err(fault) => Outcome::fault(fault),
        }
    }

    /// The result of a status other than 200.
    fn refused(&self, status: u16, bytes: &[u8], wait: Option<Duration>) -> Outcome {
        let text = String::from_utf8_lossy(bytes);
        let error = json::read(&text, ERROR_DEPTH_MAX).ok();
        let word = |key: &str| error.as_ref()?.get("error")?.get(key)?.as_str();
        // OpenAI gives the code in either field.
        let codes = [word("code"), word("type")];
        let faults = codes.map(|code| Fault::of_status(status, code));
        let plain = Fault::of_status(status, None);
        let fault = faults.into_iter().find(|fault| *fault != plain);
        let said = word("message").map_or_else(|| text.to_string(), String::from);
        Outcome {
            reply: Err(fault.unwrap_or(plain)),
            said: self.kept(&said, SAID_BYTES_MAX),
            served: String::new(),
            tokens: None,
            wait,
        }
    }

    /// Counts the cost of a request and what it says about the server.
    fn settle(&self, outcome: &Outcome, reserved_usd: f64, asked: &mut Asked) {
        let cost_usd = match (outcome.tokens, outcome.reply) {
            (Some([tokens_in, tokens_out]), _) => cost_usd(&self.vlm, tokens_in, tokens_out),
            (None, Err(fault)) if fault.is_free() => 0.0,
            // The server may have answered and charged, although no answer arrived.
            (None, _) => reserved_usd,
        };
        let [tokens_in, tokens_out] = outcome.tokens.unwrap_or_default();
        asked.tokens_in += tokens_in;
        asked.tokens_out += tokens_out;
        asked.cost_usd += cost_usd;
        let now = self.begun.elapsed();
        let mut state = self.state();
        state.budget.settle(reserved_usd, cost_usd);
        if let Some(wait) = outcome.wait {
            state.hold_until = state.hold_until.max(now + wait);
        }
        if !outcome.reply.is_err_and(Fault::is_outage) {
            state.breaker.succeeded();
        }
        let permanent = outcome.reply.err().filter(|fault| fault.is_permanent());
        if let (None, Some(fault)) = (state.closed, permanent) {
            state.closed = Some(fault);
            tracing::error!(
                fault = fault.word(),
                server = self.vlm.server,
                model = self.vlm.model_name(),
                "no more questions are asked until the next start: {}",
                fault.advice()
            );
        }
    }

    /// Notes a question without a reply. A question that fails because of the server
    /// counts as one failure, however many attempts it took.
    fn note(&self, fault: Fault, said: &str) {
        let now = self.begun.elapsed();
        let mut state = self.state();
        if fault.is_outage() {
            state.breaker.failed(now);
        }
        let is_left_alone = fault.is_outage() && state.breaker.is_open(now);
        let is_trouble = is_left_alone
            || fault.is_permanent()
            || fault.is_of_the_question()
            || fault == Fault::Budget;
        // Reported once per fault, because the server's text may differ each time.
        let is_news = state
            .trouble
            .as_ref()
            .is_none_or(|trouble| trouble.fault != fault);
        if is_trouble && is_news {
            // The page of a proxy says less than its status.
            let has_words = fault.is_status() && !said.trim_start().starts_with('<');
            state.trouble = Some(Trouble {
                fault,
                said: one_line(if has_words { said } else { "" }),
            });
        }
    }

    /// How long to wait after an attempt.
    fn pause(&self, attempt: u32, asked: Option<Duration>) -> Duration {
        // 53 bits make a double in [0, 1).
        let part = (self.state().random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64;
        let base = Duration::from_secs_f64(self.vlm.backoff_s);
        let longest = Duration::from_secs_f64(self.vlm.backoff_max_s);
        match asked {
            // Not before the server's time, and not all clients at the same instant.
            Some(wait) => wait + retry::backoff(0, base.min(wait), longest, part),
            None => retry::backoff(attempt, base, longest, part),
        }
    }

    /// The part of a text that is kept: without the key, and cut to a length.
    fn kept(&self, text: &str, bytes_max: usize) -> String {
        let mut text = match &self.key {
            Some(key) => key.redact(text),
            None => text.into(),
        };
        text.truncate(text.floor_char_boundary(bytes_max));
        text
    }

    fn state(&self) -> MutexGuard<'_, State> {
        // A thread that panicked with the lock left valid numbers behind.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A server's text made fit for a terminal: on one line, without control characters,
/// and cut to a length.
fn one_line(said: &str) -> String {
    let words: Vec<&str> = said.split_whitespace().collect();
    let line: String = words.join(" ").chars().take(SHOWN_MAX).collect();
    printable(&line).into_owned()
}
