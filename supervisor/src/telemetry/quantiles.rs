//! Quantiles

use shm_config::message::Histogram;

/// A histogram in the four numbers that tables print, microseconds.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Quantiles {
    /// Median, us.
    pub p50: f64,
    /// 99 in 100 lie below, us.
    pub p99: f64,
    /// 999 in 1000 lie below, us.
    pub p999: f64,
    /// The largest, us; exact, nothing is filtered out.
    pub max: f64,
}

impl Quantiles {
    /// Of a histogram; `None` when nothing was counted.
    pub fn of(histogram: &Histogram) -> Option<Self> {
        let us = |ns: u64| ns as f64 / 1e3;
        (histogram.count > 0).then(|| Self {
            p50: us(histogram.quantile_ns(0.5)),
            p99: us(histogram.quantile_ns(0.99)),
            p999: us(histogram.quantile_ns(0.999)),
            max: us(histogram.max_ns),
        })
    }
}
