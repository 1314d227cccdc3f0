//! How long to wait before the next attempt.

use std::time::Duration;

use reqwest::header::{DATE, HeaderMap, RETRY_AFTER};

/// The longest wait that a server may ask for.
pub const ASKED_MAX: Duration = Duration::from_secs(600);

/// The wait that the server asks for, in `retry-after-ms` or `Retry-After`, as seconds
/// or as a date; at most [`ASKED_MAX`]. A date counts from the server's own `Date`, so
/// that the clocks need not agree; without `Date` it is ignored.
pub fn asked(headers: &HeaderMap) -> Option<Duration> {
    let text = |name: &str| headers.get(name)?.to_str().ok();
    let number = |name: &str| text(name)?.trim().parse::<f64>().ok();
    let seconds = match number("retry-after-ms") {
        Some(milliseconds) => Some(milliseconds / 1e3),
        None => number(RETRY_AFTER.as_str()),
    };
    let wait = match seconds {
        Some(seconds) => Duration::try_from_secs_f64(seconds).ok()?,
        None => {
            let until = httpdate::parse_http_date(text(RETRY_AFTER.as_str())?).ok()?;
            let now = httpdate::parse_http_date(text(DATE.as_str())?).ok()?;
            until.duration_since(now).unwrap_or_default()
        }
    };
    Some(wait.min(ASKED_MAX))
}

/// Full jitter: the share `part` of `base * 2^attempt`, which is at most `longest`.
/// `attempt` counts from 0, `part` lies within [0, 1]. Clients that failed together
/// then do not return together.
pub fn backoff(attempt: u32, base: Duration, longest: Duration, part: f64) -> Duration {
    let whole = base.saturating_mul(1 << attempt.min(16)).min(longest);
    whole.mul_f64(part.clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use reqwest::header::{HeaderName, HeaderValue};

    use super::*;

    fn wait(headers: &[(&'static str, &'static str)]) -> Option<Duration> {
        let headers = headers.iter().map(|(name, value)| {
            (
                HeaderName::from_static(name),
                HeaderValue::from_static(value),
            )
        });
        asked(&headers.collect())
    }

    #[test]
    fn the_wait_is_the_one_that_the_server_asks_for() {
        let s = Duration::from_secs_f64;
        let date = ("date", "Sun, 06 Nov 1994 08:49:37 GMT");
        for (headers, expected) in [
            (&[("retry-after", "7")][..], Some(s(7.0))),
            (&[("retry-after", "0.25")], Some(s(0.25))),
            (&[("retry-after-ms", "1500")], Some(s(1.5))),
            (
                &[("retry-after", "9"), ("retry-after-ms", "20.5")],
                Some(s(0.0205)),
            ),
            (
                &[date, ("retry-after", "Sun, 06 Nov 1994 08:50:07 GMT")],
                Some(s(30.0)),
            ),
            (
                &[date, ("retry-after", "Sun, 06 Nov 1994 08:00:00 GMT")],
                Some(s(0.0)),
            ),
            (&[("retry-after", "Sun, 06 Nov 1994 08:50:07 GMT")], None),
            (&[("retry-after", "1e300")], None),
            (&[("retry-after", "86400")], Some(ASKED_MAX)),
            (&[("retry-after", "-1")], None),
            (&[("retry-after", "NaN")], None),
            (&[("retry-after", "soon")], None),
            (&[], None),
        ] {
            assert_eq!(wait(headers), expected, "{headers:?}");
        }
    }

    #[test]
    fn waits_double_up_to_the_longest() {
        let base = Duration::from_millis(500);
        let longest = Duration::from_secs(8);
        let whole: Vec<_> = (0..7)
            .map(|attempt| backoff(attempt, base, longest, 1.0).as_secs_f64())
            .collect();
        assert_eq!(whole, [0.5, 1.0, 2.0, 4.0, 8.0, 8.0, 8.0]);
        assert_eq!(backoff(2, base, longest, 0.25).as_secs_f64(), 0.5);
        assert_eq!(backoff(u32::MAX, base, longest, 0.0), Duration::ZERO);
        assert_eq!(backoff(u32::MAX, base, longest, 7.0), longest);
    }
}
