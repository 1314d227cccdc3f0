use shm_config::Instant;
use shm_config::message::{
    Advice, Assessment, Driver, Intent, Plan, PlanOutcome, Preference, Reason, Stage,
};
use shm_config::settings::GateMode;
use vehicle::Action;

/// Everything that the switch law decides on.
pub struct ArbitrationInput<'a> {
    /// Whether the run goes on.
    pub intent: Intent,
    /// How driver and policy alternate, by configuration.
    pub mode: GateMode,
    /// For [`GateMode::Takeover`]: the expert drives when the proposals differ by more.
    pub takeover_difference: Action,
    /// The time of the tick.
    pub now: Instant,
    /// There is an observation young enough.
    pub sees: bool,
    /// The plan, if young enough.
    pub plan: Option<&'a Plan>,
    /// The advice, if any ever came.
    pub advice: Option<&'a Advice>,
    /// How far the policy is.
    pub stage: Stage,
    /// The action of a driver who has taken over, if not stale.
    pub takeover: Option<Action>,
    /// What the expert proposed.
    pub expert: Option<Action>,
    /// What the policy proposed.
    pub policy: Option<Action>,
    /// The safety check of the expert's proposal.
    pub expert_assessment: &'a Assessment,
    /// The safety check of the policy's proposal.
    pub policy_assessment: &'a Assessment,
}

/// The driver, the reason, and the action.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Choice {
    /// The driver.
    pub driver: Driver,
    /// The reason.
    pub reason: Reason,
    /// The action, clamped.
    pub action: Action,
}

/// The switch law: `a = (1 - z) a_policy + z a_expert` (Sec. 4.2), with `z` from
/// valid advice, the expert without it, and the brake when there is no safe
/// proposal. A takeover overrides all except a missing observation and the end of the
/// run. Total: every input has an answer.
pub fn choose(input: &ArbitrationInput) -> Choice {
    match input.intent {
        Intent::Drive => {}
        Intent::Stop => return brake(input, Reason::Stopping),
        Intent::Contested => return brake(input, Reason::Contested),
    }
    if !input.sees {
        return brake(input, Reason::Blind);
    }
    if let (GateMode::Human, Some(action)) = (input.mode, input.takeover) {
        // The verdict is recorded and vetoes nothing: drivers take over where safety
        // check and policy are wrong, and a demonstration that the check cuts short
        // teaches its limits instead. A takeover needs no plan either. Its action is
        // clamped to what the car can do, as every other.
        return answer(Driver::Expert, Reason::Takeover, action);
    }
    let (wanted, reason) = wanted(input);
    let (driver, reason) = match wanted {
        Driver::Policy => may_policy(input, reason),
        wanted => (wanted, reason),
    };
    match driver {
        Driver::Policy => match input.policy {
            Some(action) => answer(Driver::Policy, reason, action),
            None => expert(input, Reason::Faulty),
        },
        Driver::Expert => expert(input, reason),
        Driver::Brake => brake(input, reason),
    }
}

/// Why no policy drives at this stage; `None` when one may.
fn blocking_reason(stage: Stage) -> Option<Reason> {
    match stage {
        Stage::Unloaded => Some(Reason::Unloaded),
        Stage::Shadow => Some(Reason::Shadow),
        Stage::Active => None,
    }
}

/// The driver by configuration and advice alone.
fn wanted(input: &ArbitrationInput) -> (Driver, Reason) {
    match input.mode {
        GateMode::Expert => return (Driver::Expert, Reason::Configured),
        // Without a takeover the policy drives.
        GateMode::Policy | GateMode::Human => return (Driver::Policy, Reason::Configured),
        GateMode::Takeover
        | GateMode::Rules
        | GateMode::Vlm
        | GateMode::Paper
        | GateMode::Distilled
        | GateMode::Replay => {}
    }
    if let Some(reason) = blocking_reason(input.stage) {
        return (Driver::Expert, reason);
    }
    if input.mode == GateMode::Takeover {
        return match is_taken_over(input) {
            true => (Driver::Expert, Reason::Takeover),
            false => (Driver::Policy, Reason::Configured),
        };
    }
    let Some(advice) = input.advice.filter(|advice| advice.answers > 0) else {
        return (Driver::Expert, Reason::Unadvised);
    };
    if input.now >= Instant(advice.holds_until_ns) {
        return (Driver::Expert, Reason::Expired);
    }
    match advice.preference() {
        Preference::Expert => (Driver::Expert, Reason::Advised),
        Preference::Policy => (Driver::Policy, Reason::Advised),
        Preference::Abstain => (Driver::Expert, Reason::Unadvised),
    }
}

/// Whether the proposals differ so much that the expert takes over.
fn is_taken_over(input: &ArbitrationInput) -> bool {
    let limit = input.takeover_difference;
    let (Some(expert), Some(policy)) = (input.expert, input.policy) else {
        return false;
    };
    (expert.steer - policy.steer).abs() > limit.steer
        || (expert.pedal - policy.pedal).abs() > limit.pedal
}

/// The policy drives only if it has a proposal and is allowed to.
fn may_policy(input: &ArbitrationInput, reason: Reason) -> (Driver, Reason) {
    if let Some(reason) = blocking_reason(input.stage) {
        (Driver::Expert, reason)
    } else if input.policy.is_none() {
        (Driver::Expert, Reason::Faulty)
    } else if input.policy_assessment.is_vetoed() {
        (Driver::Expert, Reason::Vetoed)
    } else {
        (Driver::Policy, reason)
    }
}

/// The brake drives where the expert has no safe proposal.
fn expert(input: &ArbitrationInput, reason: Reason) -> Choice {
    let Some(plan) = input.plan else {
        return brake(input, Reason::Unplanned);
    };
    let Some(action) = input.expert else {
        return match plan.outcome() {
            PlanOutcome::Blocked => brake(input, Reason::Blocked),
            PlanOutcome::Reached | PlanOutcome::Partial => brake(input, Reason::Unplanned),
        };
    };
    if input.expert_assessment.is_vetoed() {
        return brake(input, Reason::Unsafe);
    }
    answer(Driver::Expert, reason, action)
}

/// The full brake, along the expert's line when there is one: in a bend,
/// straight wheels leave the road.
fn brake(input: &ArbitrationInput, reason: Reason) -> Choice {
    let steer = input.expert.map_or(0.0, |action| action.steer);
    let action = Action {
        steer,
        ..Action::BRAKE
    };
    answer(Driver::Brake, reason, action)
}

fn answer(driver: Driver, reason: Reason, action: Action) -> Choice {
    Choice {
        driver,
        reason,
        action: action.clamped(),
    }
}
