//! What the environment says.

/// Where pose, speed and turning rate of an observation come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    Truth,
    /// The filter, with scans aligned with the map.
    Map,
    /// The filter, with each scan aligned with the one before.
    Scans,
    /// The filter, with wheels and IMU alone.
    Wheels,
}

#[derive(Clone, Copy, Debug)]
pub struct Options {
    pub source: Source,
    /// Multiplies the noise of all sensors.
    pub noise: f64,
    pub delay_s: f64,
    pub drop: f64,
}

/// Longest mean delay, ms: the longest of all is half as much again, and the filter accepts
/// half a second.
const DELAY_MAX_MS: f64 = 300.0;

impl Options {
    /// # Errors
    /// A variable that is no word of its list, or no number of its range.
    pub fn read(variable: impl Fn(&str) -> Option<String>) -> Result<Self, String> {
        let source = match variable("VLAPS_EGO").as_deref() {
            None | Some("map") => Source::Map,
            Some("truth") => Source::Truth,
            Some("scans") => Source::Scans,
            Some("wheels") => Source::Wheels,
            Some(other) => {
                return Err(format!(
                    "VLAPS_EGO={other}: must be truth, map, scans or wheels"
                ));
            }
        };
        let number = |name: &str, default: f64, max: f64| {
            let Some(word) = variable(name) else {
                return Ok(default);
            };
            let number = word.parse().ok();
            number
                .filter(|number| (0.0..=max).contains(number))
                .ok_or_else(|| format!("{name}={word}: must be a number within 0 and {max}"))
        };
        Ok(Self {
            source,
            noise: number("VLAPS_NOISE", 1.0, 100.0)?,
            delay_s: number("VLAPS_DELAY_MS", 0.0, DELAY_MAX_MS)? * 1e-3,
            drop: number("VLAPS_DROP", 0.0, 1.0)?,
        })
    }
}
