//! What a slow judge costs in an hour, alone and behind a distilled one.

use serde::Serialize;
use shm_config::config::{Gate, Vlm};

use super::samples::Asked;
use crate::statistics::quantile;

/// Cost of an hour of driving.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Cost {
    /// Questions in an hour of the run's clock.
    pub questions_per_hour: f64,
    /// Cost of a question to the slow judge, US dollars; `None` if neither tokens
    /// nor a cost were recorded.
    pub question_usd: Option<f64>,
    /// Cost of an hour with the slow judge alone, US dollars.
    pub alone_usd_per_hour: Option<f64>,
    /// Cost of an hour behind the net, audits included, US dollars.
    pub behind_usd_per_hour: Option<f64>,
    /// Questions in an hour that the slow judge is asked behind the net.
    pub behind_questions_per_hour: f64,
    /// Share of the questions that the net answers and the slow judge is asked, too.
    pub audit: f64,
    /// Median latency of the slow judge, s.
    pub latency_median_s: Option<f64>,
    /// 99 % quantile of it, s.
    pub latency_p99_s: Option<f64>,
}

impl Cost {
    /// Of the questions that were asked, when this share is passed on. A question costs
    /// what its tokens cost at the configured prices; without tokens, what was recorded.
    pub fn of(asked: &Asked, passed_on: f64, vlm: &Vlm, gate: &Gate) -> Self {
        let questions = asked.questions.max(1) as f64;
        let questions_per_hour = questions / asked.driven_s.max(1e-9) * 3600.0;
        let prices = vlm.prices_usd();
        let tokens = asked.tokens.map(|count| count as f64);
        let of_tokens = (tokens[0] * prices[0] + tokens[1] * prices[1]) * 1e-6 / questions;
        let question_usd = match asked.tokens {
            [0, 0] => (asked.cost_usd > 0.0).then(|| asked.cost_usd / questions),
            _ => Some(of_tokens),
        };
        let slow_share = passed_on + (1.0 - passed_on) * gate.audit;
        let per_hour = |share: f64| question_usd.map(|usd| usd * questions_per_hour * share);
        Self {
            questions_per_hour,
            question_usd,
            alone_usd_per_hour: per_hour(1.0),
            behind_usd_per_hour: per_hour(slow_share),
            behind_questions_per_hour: questions_per_hour * slow_share,
            audit: gate.audit,
            latency_median_s: quantile(&asked.latencies_s, 0.5),
            latency_p99_s: quantile(&asked.latencies_s, 0.99),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_tokens_a_question_costs_what_was_recorded() {
        let mut asked = Asked {
            questions: 4,
            driven_s: 3600.0,
            ..Asked::default()
        };
        let cost = |asked: &Asked| {
            let (vlm, gate) = (Vlm::default(), Gate::default());
            let cost = Cost::of(asked, 0.5, &vlm, &gate);
            (cost.question_usd, cost.alone_usd_per_hour)
        };
        assert_eq!(cost(&asked), (None, None));
        asked.cost_usd = 2.0;
        assert_eq!(cost(&asked), (Some(0.5), Some(2.0)));
        asked.tokens = [u64::MAX; 2];
        let (usd, _) = cost(&asked);
        assert!(usd.is_some_and(f64::is_finite), "{usd:?}");
    }
}
