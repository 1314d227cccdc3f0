use serde::{Deserialize, Serialize};

use super::{OutOfRange, in_range};

/// The prompt of the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PromptPreset {
    /// Two paths, A and B, in random places and colours.
    Blind,
    /// The paper's prompt, with the colours of its figures (Sec. 4.2).
    Paper,
}

impl PromptPreset {
    /// The preset's name in the configuration.
    pub fn word(self) -> &'static str {
        match self {
            Self::Blind => "blind",
            Self::Paper => "paper",
        }
    }
}

/// The view of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum View {
    /// From the car, looking ahead.
    Ego,
    /// From above.
    TopDown,
}

impl From<View> for crate::message::View {
    fn from(view: View) -> Self {
        match view {
            View::Ego => Self::Ego,
            View::TopDown => Self::TopDown,
        }
    }
}

/// The file format of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PictureFormat {
    /// PNG: lossless.
    Png,
    /// JPEG: smaller.
    Jpeg,
}

/// How the paths in the picture are computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rollout {
    /// Steps of 0.1 s to the horizon.
    Accurate,
    /// One step of 1.5 s, as the paper's pictures (Sec. 8.4).
    Paper,
}

/// A vision-language model as judge: the server, the prompt and the limits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Vlm {
    /// Base URL of the server's OpenAI-compatible interface.
    pub server: String,
    /// Model name; empty for gpt-4o-mini. vlaps-stand-in for ./vlaps judge serve, which
    /// is not a model and costs nothing.
    pub model: String,
    /// Environment variable that holds the key; empty for none. For api.openai.com,
    /// OPENAI_API_KEY is read too.
    pub key_env: String,
    /// File that holds the key, in place of a variable: a path that contains a /, such
    /// as ./key.txt. Only its owner may have rights to it (chmod 600).
    pub key_file: String,
    /// File with certificates (PEM) of authorities that are trusted for https beside
    /// those of the system; empty for none.
    pub ca_file: String,
    /// Whether the key may be sent unencrypted, over http, to another machine.
    pub key_over_http: bool,
    /// The prompt: blind or paper.
    pub prompt: PromptPreset,
    /// Ask each question a second time with the paths swapped; replies that disagree
    /// are no preference. Small models prefer the first path in 72 % of pairs.
    pub ask_twice: bool,
    /// View of the picture: ego or top_down.
    pub view: View,
    /// Width of the picture, pixels.
    pub width_px: u32,
    /// Height of the picture, pixels.
    pub height_px: u32,
    /// File format of the picture: png or jpeg.
    pub format: PictureFormat,
    /// Length of the paths, s.
    pub horizon_s: f64,
    /// How the paths are computed: accurate (steps of 0.1 s) or paper (one step of 1.5
    /// s).
    pub rollout: Rollout,
    /// Sampling temperature; negative to leave it to the server, which reasoning models
    /// of OpenAI require.
    pub temperature: f64,
    /// Longest answer, tokens.
    pub tokens_max: u32,
    /// Time for one question with all its attempts, s.
    pub deadline_s: f64,
    /// Time for one attempt, s.
    pub attempt_s: f64,
    /// Attempts for one question.
    pub attempts_max: u32,
    /// Longest wait before the second attempt, s; it doubles from attempt to attempt,
    /// and the wait is a random part of it.
    #[serde(skip)]
    pub backoff_s: f64,
    /// Longest wait before any attempt, s, unless the server asks for more.
    #[serde(skip)]
    pub backoff_max_s: f64,
    /// Most requests in flight; a question that is asked twice makes two. Further
    /// requests fail at once.
    pub in_flight_max: u32,
    /// Requests in any 60 s, attempts counted.
    pub per_minute_max: u32,
    /// Budget of a run, US dollars; when it is spent, no more questions are asked.
    pub budget_usd: f64,
    /// Price of a million tokens in, US dollars; negative for gpt-4o-mini's 0.15. Set it to 0
    /// for a server of your own.
    pub price_in_usd: f64,
    /// Price of a million tokens out, US dollars; negative for gpt-4o-mini's 0.60. Set it to
    /// 0 for a server of your own.
    pub price_out_usd: f64,
    /// Questions in a row that fail in every attempt because of the server; after that
    /// it gets no request for a while. A question that is asked twice counts twice.
    pub breaker_failures: u32,
    /// Duration of that pause, s; then one question tries the server again.
    #[serde(skip)]
    pub breaker_open_s: f64,
    /// Most bytes of questions and pictures that a run keeps.
    pub record_bytes_max: u64,
}

impl Default for Vlm {
    fn default() -> Self {
        Self {
            // The default address of llama-server and of ./vlaps judge serve.
            server: "http://127.0.0.1:8080/v1".into(),
            model: String::new(),
            key_env: "VLAPS_VLM_KEY".into(),
            key_file: String::new(),
            ca_file: String::new(),
            key_over_http: false,
            prompt: PromptPreset::Blind,
            ask_twice: true,
            view: View::Ego,
            // One of OpenAI's tiles; one more pixel in either direction costs two
            // tiles.
            width_px: 512,
            height_px: 512,
            format: PictureFormat::Png,
            // Twice the paper's 1.5 s: at 10 m/s the visible distance at a junction.
            horizon_s: 3.0,
            rollout: Rollout::Accurate,
            temperature: 0.0,
            // A sentence of reason needs 60.
            tokens_max: 200,
            // Advice is useful while its question is recent: the paper's period.
            deadline_s: 10.0,
            attempt_s: 8.0,
            attempts_max: 3,
            // As in OpenAI's own clients.
            backoff_s: 0.5,
            backoff_max_s: 8.0,
            // Two questions (gate.in_flight), each asked twice.
            in_flight_max: 4,
            per_minute_max: 60,
            budget_usd: 1.0,
            price_in_usd: -1.0,
            price_out_usd: -1.0,
            // Three questions, each asked twice.
            breaker_failures: 6,
            breaker_open_s: 30.0,
            record_bytes_max: 512_000_000,
        }
    }
}

/// The model name of `./vlaps judge serve`.
pub const STAND_IN: &str = "vlaps-stand-in";

/// Shown in place of a value that may be a key.
const HIDDEN: &str = "(not shown)";

impl Vlm {
    /// The model's name as it is sent to the server.
    pub fn model_name(&self) -> &str {
        match self.model.as_str() {
            "" => "gpt-4o-mini",
            name => name,
        }
    }

    /// Prices of a million tokens in and out, US dollars.
    pub fn prices_usd(&self) -> [f64; 2] {
        let own = match self.model_name() {
            STAND_IN => [0.0, 0.0],
            _ => [0.15, 0.60],
        };
        let given = [self.price_in_usd, self.price_out_usd];
        std::array::from_fn(|i| if given[i] < 0.0 { own[i] } else { given[i] })
    }

    pub(super) fn check(&self) -> Result<(), OutOfRange> {
        self.check_names()?;
        let counts = [
            ("vlm.width_px", self.width_px, 64..=4096),
            ("vlm.height_px", self.height_px, 64..=4096),
            ("vlm.tokens_max", self.tokens_max, 16..=100_000),
            ("vlm.attempts_max", self.attempts_max, 1..=20),
            ("vlm.in_flight_max", self.in_flight_max, 1..=64),
            ("vlm.per_minute_max", self.per_minute_max, 1..=10_000),
            ("vlm.breaker_failures", self.breaker_failures, 1..=1000),
        ];
        for (key, value, range) in counts {
            in_range(key, value, range)?;
        }
        let reals = [
            ("vlm.horizon_s", self.horizon_s, 0.5..=10.0),
            ("vlm.temperature", self.temperature, -1.0..=2.0),
            ("vlm.deadline_s", self.deadline_s, 0.01..=600.0),
            ("vlm.attempt_s", self.attempt_s, 0.01..=600.0),
            ("vlm.budget_usd", self.budget_usd, 0.0..=1e6),
            ("vlm.price_in_usd", self.price_in_usd, -1.0..=1e4),
            ("vlm.price_out_usd", self.price_out_usd, -1.0..=1e4),
        ];
        for (key, value, range) in reals {
            in_range(key, value, range)?;
        }
        in_range(
            "vlm.record_bytes_max",
            self.record_bytes_max,
            0..=1_000_000_000_000,
        )
    }

    /// A value that may be a key by mistake is not shown; the error names only the
    /// setting.
    fn check_names(&self) -> Result<(), OutOfRange> {
        let refuse = |key: &str, value: &str, expected: &str| {
            Err(OutOfRange {
                key: key.into(),
                value: value.into(),
                expected: expected.into(),
            })
        };
        let begins = ["http://", "https://"].map(|scheme| self.server.strip_prefix(scheme));
        let rest = begins.into_iter().flatten().next().unwrap_or_default();
        if self.server.contains(['@', '?', '#']) {
            return refuse(
                "vlm.server",
                HIDDEN,
                "an address without name, password or query (@, ?, #); a key belongs into the \
                 environment variable of vlm.key_env or into the file of vlm.key_file",
            );
        }
        if rest.is_empty() || rest.contains(char::is_whitespace) {
            return refuse(
                "vlm.server",
                HIDDEN,
                "an address such as http://127.0.0.1:8080/v1 or https://api.openai.com/v1",
            );
        }
        let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
        if !self.key_env.chars().all(is_name) {
            return refuse(
                "vlm.key_env",
                HIDDEN,
                "the name of an environment variable, not the key itself",
            );
        }
        // Paths are logged and shown; a key hardly ever contains a slash.
        if !self.key_file.is_empty() && !self.key_file.contains('/') {
            return refuse(
                "vlm.key_file",
                HIDDEN,
                "the path of a file with a / in it, such as ./key.txt, not the key itself",
            );
        }
        Ok(())
    }
}
