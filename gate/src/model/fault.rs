use crate::query::Failure;

/// Declares the closed list: each fault with its word and its meaning.
macro_rules! faults {
    ($($(#[$doc:meta])* $name:ident => $word:literal,)*) => {
        /// Why there is no reply. No fault is ever read as a reply.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum Fault {
            $($(#[$doc])* $name,)*
        }

        impl Fault {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$name,)*];

            /// One word, for records and summaries.
            pub fn word(self) -> &'static str {
                match self {
                    $(Self::$name => $word,)*
                }
            }
        }
    };
}

faults! {
    /// No answer began within the time.
    Timeout => "timeout",
    /// An answer began and did not end within the time.
    SlowBody => "slow_body",
    /// No process listens at the address.
    ConnectionRefused => "connection_refused",
    /// The connection broke.
    ConnectionReset => "connection_reset",
    /// The server cannot be reached: name, route or connection.
    Unreachable => "unreachable",
    /// The encrypted connection failed.
    Tls => "tls",
    /// The response is not HTTP.
    Protocol => "protocol",
    /// The server redirects; the key does not follow.
    Redirect => "redirect",
    /// 400: the server refuses the request.
    BadRequest => "http_400",
    /// 401: the key is missing or wrong.
    Unauthorized => "http_401",
    /// 402, or a 429 that says so: the account is empty.
    Quota => "quota",
    /// 403: the key lacks the right.
    Forbidden => "http_403",
    /// 404: the model or the interface does not exist.
    NotFound => "http_404",
    /// 408: the server waited too long.
    RequestTimeout => "http_408",
    /// 409: the server asks to try again.
    Conflict => "http_409",
    /// 413: the picture is too large for it.
    RequestTooLarge => "http_413",
    /// 422: the server does not understand a field.
    Unprocessable => "http_422",
    /// 429: too many requests.
    RateLimited => "http_429",
    /// 500: the server broke down.
    ServerError => "http_500",
    /// 502: the server behind the proxy failed.
    BadGateway => "http_502",
    /// 503: the server is busy or starting.
    ServiceUnavailable => "http_503",
    /// 504: the server behind the proxy is too slow.
    GatewayTimeout => "http_504",
    /// 529: the server is overloaded.
    Overloaded => "http_529",
    /// Another status than 200 and those above.
    OtherStatus => "http_other",
    /// The content type of the answer is not JSON.
    ContentType => "content_type",
    /// The answer is longer than the limit.
    TooLarge => "too_large",
    /// The answer is empty.
    EmptyBody => "empty_body",
    /// The answer is not UTF-8.
    InvalidUtf8 => "invalid_utf8",
    /// The answer ends in the middle.
    Truncated => "truncated",
    /// The answer is not JSON.
    NotJson => "not_json",
    /// A key occurs twice, and readers differ on which one counts.
    DuplicateKeys => "duplicate_keys",
    /// The answer is nested too deeply.
    TooDeep => "too_deep",
    /// The answer is JSON, but not a chat completion.
    Envelope => "envelope",
    /// The completion has no choice.
    NoChoices => "no_choices",
    /// The model refused to answer.
    Refused => "refused",
    /// The model reached its token limit.
    Length => "length",
    /// A filter cut the answer off.
    ContentFilter => "content_filter",
    /// The model stopped for another reason.
    Unfinished => "unfinished",
    /// The model's text is empty.
    NoContent => "no_content",
    /// The model wrapped its answer in a code fence.
    CodeFence => "code_fence",
    /// The model's text has words before the answer.
    LeadingText => "leading_text",
    /// The model's text has words after the answer.
    TrailingText => "trailing_text",
    /// A value has another type than requested.
    WrongType => "wrong_type",
    /// A value is not one of those requested.
    OutOfRange => "out_of_range",
    /// The model gave two answers.
    BothAnswers => "both_answers",
    /// The answer lacks a field.
    MissingField => "missing_field",
    /// The answer has a field that was not requested.
    ExtraField => "extra_field",
    /// The request cannot be written as JSON.
    Encoding => "request_encoding",
    /// The limit of concurrent questions is reached.
    Busy => "busy",
    /// The limit of requests a minute is reached.
    OwnRate => "own_rate",
    /// The run's budget is spent.
    Budget => "budget",
    /// The server failed repeatedly and gets no request for a while.
    BreakerOpen => "breaker_open",
}

impl Fault {
    /// It does not pass by itself: nothing more is asked until the user has changed
    /// something and started again.
    pub fn is_permanent(self) -> bool {
        matches!(
            self,
            Self::Unauthorized | Self::Quota | Self::Forbidden | Self::NotFound
        )
    }

    /// The same request may succeed a moment later.
    pub fn is_retryable(self) -> bool {
        matches!(
            self,
            Self::Timeout
                | Self::SlowBody
                | Self::ConnectionRefused
                | Self::ConnectionReset
                | Self::Unreachable
                | Self::RequestTimeout
                | Self::Conflict
                | Self::RateLimited
                | Self::ServerError
                | Self::BadGateway
                | Self::ServiceUnavailable
                | Self::GatewayTimeout
                | Self::Overloaded
        )
    }

    /// It says that the server is down, which counts for the circuit breaker. A request
    /// to slow down does not count, nor does an invalid answer of the model.
    pub fn is_outage(self) -> bool {
        let asked_to_wait = matches!(self, Self::Conflict | Self::RateLimited);
        let not_retried = matches!(self, Self::Tls | Self::Protocol | Self::Redirect);
        (self.is_retryable() && !asked_to_wait) || not_retried
    }

    /// It is caused by the question's form, which the next question shares.
    pub fn is_of_the_question(self) -> bool {
        matches!(
            self,
            Self::BadRequest | Self::RequestTooLarge | Self::Unprocessable | Self::Length
        )
    }

    /// It is a status of the server, usually with a text.
    pub(crate) fn is_status(self) -> bool {
        self == Self::Quota || self.word().starts_with("http_")
    }

    /// The request cost nothing, because it did not reach a model.
    pub(crate) fn is_free(self) -> bool {
        matches!(
            self,
            Self::ConnectionRefused
                | Self::Unreachable
                | Self::Tls
                | Self::Redirect
                | Self::BadRequest
                | Self::Unauthorized
                | Self::Quota
                | Self::Forbidden
                | Self::NotFound
                | Self::Conflict
                | Self::RequestTooLarge
                | Self::Unprocessable
                | Self::RateLimited
                | Self::ServiceUnavailable
                | Self::Overloaded
        )
    }

    /// The same fault in the gate's coarser list.
    pub fn failure(self) -> Failure {
        match self {
            Self::Timeout | Self::SlowBody | Self::RequestTimeout | Self::GatewayTimeout => {
                Failure::Timeout
            }
            Self::Refused | Self::ContentFilter => Failure::Refused,
            Self::Budget | Self::Quota => Failure::Budget,
            Self::ContentType
            | Self::TooLarge
            | Self::EmptyBody
            | Self::InvalidUtf8
            | Self::Truncated
            | Self::NotJson
            | Self::DuplicateKeys
            | Self::TooDeep
            | Self::Envelope
            | Self::NoChoices
            | Self::Length
            | Self::Unfinished
            | Self::NoContent
            | Self::CodeFence
            | Self::LeadingText
            | Self::TrailingText
            | Self::WrongType
            | Self::OutOfRange
            | Self::BothAnswers
            | Self::MissingField
            | Self::ExtraField => Failure::Malformed,
            Self::ConnectionRefused
            | Self::ConnectionReset
            | Self::Unreachable
            | Self::Tls
            | Self::Protocol
            | Self::Redirect
            | Self::BadRequest
            | Self::Unauthorized
            | Self::Forbidden
            | Self::NotFound
            | Self::Conflict
            | Self::RequestTooLarge
            | Self::Unprocessable
            | Self::RateLimited
            | Self::ServerError
            | Self::BadGateway
            | Self::ServiceUnavailable
            | Self::Overloaded
            | Self::OtherStatus
            | Self::Encoding
            | Self::Busy
            | Self::OwnRate
            | Self::BreakerOpen => Failure::Unavailable,
        }
    }

    /// The fault of a status other than 200. `code` is the server's code for the error,
    /// if it gave one.
    pub(crate) fn of_status(status: u16, code: Option<&str>) -> Self {
        let spent = [
            "insufficient_quota",
            "billing_hard_limit_reached",
            "billing_not_active",
        ];
        let filtered = ["content_filter", "content_policy_violation"];
        match (status, code) {
            (429 | 403, Some(code)) if spent.contains(&code) => Self::Quota,
            (400, Some(code)) if filtered.contains(&code) => Self::ContentFilter,
            (300..=399, _) => Self::Redirect,
            (400, _) => Self::BadRequest,
            (401, _) => Self::Unauthorized,
            (402, _) => Self::Quota,
            (403, _) => Self::Forbidden,
            (404, _) => Self::NotFound,
            (408, _) => Self::RequestTimeout,
            (409, _) => Self::Conflict,
            (413, _) => Self::RequestTooLarge,
            (422, _) => Self::Unprocessable,
            (429, _) => Self::RateLimited,
            (500, _) => Self::ServerError,
            (502, _) => Self::BadGateway,
            (503, _) => Self::ServiceUnavailable,
            (504, _) => Self::GatewayTimeout,
            (529, _) => Self::Overloaded,
            _ => Self::OtherStatus,
        }
    }

    /// What the user can do about a fault that does not pass soon.
    pub fn advice(self) -> &'static str {
        match self {
            Self::Unauthorized => "check the key (vlm.key_env, vlm.key_file)",
            Self::Forbidden => "ask for the right to use the model, or name another in vlm.model",
            Self::Quota => "top up the account, or point vlm.server elsewhere",
            Self::NotFound => "check vlm.model and the end of vlm.server, usually /v1",
            Self::Budget => "raise vlm.budget_usd, or ask less often (gate.spacing_s)",
            Self::BadRequest | Self::Unprocessable => {
                "check vlm.model and the context length that the server was started with"
            }
            Self::RequestTooLarge => "ask with a smaller picture (vlm.width_px, vlm.height_px)",
            Self::Length => "raise vlm.tokens_max, the more for a model that thinks first",
            fault if fault.is_outage() => "check that the server at vlm.server runs and answers",
            _ => "try again",
        }
    }
}
