//! Every message, at the check that all readers share.

use shm_config::message::{
    Advice, BEAMS_MAX, Command, Episode, Foresight, Frame, FrameRequest, Health, Learning,
    Observation, Plan, PolicyStatus, Progress, Step, Takeover, Timing, Weights,
};
use shm_config::{Instant, Message};
use vehicle::pose;

use crate::{Said, read};

/// The run's clock at the check, ns.
const NOW: Instant = Instant(10_000_000_000);
/// The age limit of messages, ns.
const LIMIT_NS: u64 = 1_000_000_000;

/// Number of message types; the first byte chooses one.
pub const KINDS: u8 = 16;

/// One message: the first byte chooses its type, the rest is its memory.
pub fn messages(bytes: &[u8]) -> Said {
    let Some((kind, rest)) = bytes.split_first() else {
        return Said::Refused;
    };
    match kind % KINDS {
        0 => at_door::<Observation>(rest, observation),
        1 => at_door::<Plan>(rest, plan),
        2 => at_door::<Command>(rest, |command| {
            let action = command.action();
            assert!(action.steer.abs() <= 1.0 && action.pedal.abs() <= 1.0);
            assert!(command.reason().is_some());
        }),
        3 => at_door::<Step>(rest, |step| {
            assert!(step.reason().is_some());
            let _ = (step.driver(), step.expert.action(), step.policy.action());
        }),
        4 => at_door::<Advice>(rest, |advice| {
            let _ = (advice.preference(), advice.label());
        }),
        5 => at_door::<Takeover>(rest, |takeover| {
            assert!(takeover.action().is_none_or(|action| action.is_finite()));
        }),
        6 => at_door::<Frame>(rest, |frame| {
            assert_eq!(frame.rgb().len(), (frame.width * frame.height * 3) as usize);
        }),
        7 => at_door::<FrameRequest>(rest, |request| {
            let _ = (request.view(), request.size_px(), request.actions());
        }),
        8 => at_door::<Foresight>(rest, |_| {}),
        9 => at_door::<Health>(rest, |_| {}),
        10 => at_door::<Timing>(rest, |timing| {
            for share in [0.0, 0.5, 1.0] {
                timing.execution.quantile_ns(share);
            }
            let mut sum = timing.response;
            sum.merge(&timing.release_lateness);
        }),
        11 => at_door::<Learning>(rest, |_| {}),
        12 => at_door::<PolicyStatus>(rest, |status| {
            let _ = (status.state(), status.refusal().len());
        }),
        13 => at_door::<Weights>(rest, |weights| {
            assert_eq!(weights.file().len() as u64, weights.byte_count);
        }),
        14 => at_door::<Progress>(rest, |_| {}),
        _ => at_door::<Episode>(rest, |episode| {
            let _ = (episode.outcome(), episode.is_strict_success());
        }),
    }
}

fn at_door<M: Message>(bytes: &[u8], use_it: impl Fn(&M)) -> Said {
    let message = read::<M>(bytes);
    let is_good = message.check().is_ok();
    let is_young = message.admit(NOW, LIMIT_NS).is_ok();
    assert!(is_good || !is_young, "admitted, but not good");
    if is_good {
        use_it(&message);
    }
    Said::of(is_good)
}

fn observation(observation: &Observation) {
    let mut room = [0.0; 19 + BEAMS_MAX];
    let features = observation.features(&mut room).expect("there is room");
    assert_eq!(features.len(), observation.feature_count());
    assert!(features.iter().all(|feature| (0.0..=1.0).contains(feature)));
}

fn plan(plan: &Plan) {
    for age_ns in [0, 1, 50_000_000, u64::MAX] {
        let action = plan.action_at(age_ns);
        assert!(action.is_none_or(|action| action.is_finite()));
    }
    for (turned_rad, ahead_m) in [(0.0, 0.0), (1.0, 5.0), (-3.0, 1e9)] {
        let point = plan.lookahead(&pose(0.5, -0.5, turned_rad), ahead_m);
        assert!(point.is_none_or(|(point, speed)| point.x.is_finite() && speed.is_finite()));
    }
    let _ = plan.world_from_plan();
}
