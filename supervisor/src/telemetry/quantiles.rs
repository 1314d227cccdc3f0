//! Quantiles of a histogram.

use shm_config::message::Histogram;

/// The four figures that tables print of a histogram, microseconds.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Quantiles {
    /// Median, us.
    pub p50: f64,
    /// 99th percentile, us.
    pub p99: f64,
    /// 99.9th percentile, us.
    pub p999: f64,
    /// Maximum, us; exact and unfiltered.
    pub max: f64,
}

impl Quantiles {
    /// The quantiles of a histogram; `None` when it is empty.
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
