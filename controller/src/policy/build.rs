//! Bytes to a policy that may go into the tick: every check, the session, its warm-up.

use std::time::Duration;

use policy::{Net, PolicyFile, Refusal, check_answers, decode_within};
use shm_config::config::{Backend, Config};
use shm_config::message::{INPUTS_WITH_MOTION, fits_policy};
use shm_config::time::Clock;

use super::{NativePolicy, OrtPolicy, OrtSession, Policy, library};

/// Answers of the warm-up: enough for caches and branch predictors, and a median.
const WARM_UP: usize = 64;
/// Longest wait for ONNX Runtime where there is no deadline.
const PATIENCE: Duration = Duration::from_secs(10);

/// On which terms weights become a policy.
pub struct Terms<'a> {
    /// Back end, tolerance and limits.
    pub config: &'a Config,
    /// Their version.
    pub version: u64,
    /// How to measure the warm-up.
    pub clock: Clock,
}

/// Every check, the session, and its warm-up: bytes to a policy that may go into
/// the tick.
///
/// # Errors
/// The first check that fails.
pub fn build(bytes: &[u8], terms: &Terms) -> Result<Box<dyn Policy>, Refusal> {
    let config = &terms.config.policy;
    let scanner = &terms.config.scanner;
    if !fits_policy(&scanner.fan()) {
        return Err(Refusal::Scanner {
            beams: scanner.beams,
            field_of_view_deg: scanner.field_of_view_deg,
        });
    }
    let tolerance = config.tolerance as f32;
    let PolicyFile {
        net,
        probes,
        sha256,
        ..
    } = decode_within(bytes, tolerance)?;
    let names = match (net, config.backend) {
        (Net::Mlp { mlp, .. }, Backend::Auto | Backend::Native) => {
            let mut mlp = *mlp;
            warm_up(terms, |features| mlp.infer(features))?;
            return Ok(Box::new(NativePolicy::new(mlp, terms.version, &sha256)));
        }
        (Net::Graph(_), Backend::Native) => {
            return Err(Refusal::NoBackEnd(
                "the native runtime does not take this net, and policy.backend is native: set it to \
                 auto"
                    .into(),
            ));
        }
        (Net::Mlp { names, .. }, Backend::Ort) => names,
        (Net::Graph(names), Backend::Auto | Backend::Ort) => names,
    };
    let mut session = OrtSession::new(&library(&config.onnxruntime)?, bytes, &names)?;
    check_answers(&probes, tolerance, |features| session.infer(features))?;
    warm_up(terms, |features| session.infer(features))?;
    let wait = match terms.config.run.is_lockstep() {
        true => PATIENCE,
        false => Duration::from_nanos((config.ort_wait_us * 1e3) as u64),
    };
    let policy = OrtPolicy::new(session, (terms.version, &sha256), wait, terms.clock)?;
    Ok(Box::new(policy))
}

/// Runs the net until it is warm, and measures it.
fn warm_up(terms: &Terms, mut infer: impl FnMut(&[f32]) -> [f32; 2]) -> Result<(), Refusal> {
    let mut times_ns = [0; WARM_UP];
    for time_ns in &mut times_ns {
        let begun = (terms.clock)();
        std::hint::black_box(infer(&[0.5; INPUTS_WITH_MOTION]));
        *time_ns = (terms.clock)().since_ns(begun);
    }
    times_ns.sort_unstable();
    let median_us = times_ns[WARM_UP / 2] as f64 / 1e3;
    let limit_us = terms.config.policy.inference_max_us;
    // In lockstep a decision must not depend on the machine's speed.
    match median_us > limit_us && !terms.config.run.is_lockstep() {
        true => Err(Refusal::TooSlow {
            median_us,
            limit_us,
        }),
        false => Ok(()),
    }
}
