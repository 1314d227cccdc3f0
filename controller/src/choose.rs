use shm_config::Instant;
use shm_config::config::GateMode;
use shm_config::message::{
    Advice, Assessment, Driver, Intent, Plan, PlanOutcome, Preference, Reason, Stage,
};
use vehicle::Action;

/// Everything the switch law looks at.
pub struct Standing<'a> {
    /// Whether the run goes on.
    pub intent: Intent,
    /// Who decides, by configuration.
    pub mode: GateMode,
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
    /// What a person wants who has taken over, said not long ago.
    pub takeover: Option<Action>,
    /// What the expert proposed.
    pub expert: Option<Action>,
    /// What the policy proposed.
    pub policy: Option<Action>,
    /// The judge in the tick on the expert.
    pub expert_assessment: &'a Assessment,
    /// The judge in the tick on the policy.
    pub policy_assessment: &'a Assessment,
}

/// Who drives, why, and what.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Choice {
    /// Who.
    pub driver: Driver,
    /// Why.
    pub reason: Reason,
    /// What, clamped.
    pub action: Action,
}

/// The switch law: `a = (1 - z) a_policy + z a_expert` (Sec. 4.2), with `z` from
/// valid advice, the expert when in doubt, and the brake when there is no safe
/// proposal. A person who takes over goes before all but blindness and the end of
/// the run. Total: every standing has an answer.
pub fn choose(standing: &Standing) -> Choice {
    match standing.intent {
        Intent::Drive => {}
        Intent::Stop => return brake(standing, Reason::Stopping),
        Intent::Contested => return brake(standing, Reason::Contested),
    }
    if !standing.sees {
        return brake(standing, Reason::Blind);
    }
    if let (GateMode::Human, Some(action)) = (standing.mode, standing.takeover) {
        // The judge is asked, its answer recorded, and no veto made of it: people
        // take over where judge and policy are wrong, and a demonstration that the
        // judge cuts short teaches the judge's fear instead. A person needs no plan
        // either. What the car can do bounds a person like everybody.
        return answer(Driver::Expert, Reason::Takeover, action);
    }
    let (wanted, reason) = wanted(standing);
    let (driver, reason) = match wanted {
        Driver::Policy => may_policy(standing, reason),
        wanted => (wanted, reason),
    };
    match driver {
        Driver::Policy => match standing.policy {
            Some(action) => answer(Driver::Policy, reason, action),
            None => expert(standing, Reason::Faulty),
        },
        Driver::Expert => expert(standing, reason),
        Driver::Brake => brake(standing, reason),
    }
}

/// Why no policy drives at this stage; `None` when one may.
fn hindrance(stage: Stage) -> Option<Reason> {
    match stage {
        Stage::Unloaded => Some(Reason::Unloaded),
        Stage::Shadow => Some(Reason::Shadow),
        Stage::Active => None,
    }
}

/// Whose turn it is, by configuration and advice alone.
fn wanted(standing: &Standing) -> (Driver, Reason) {
    match standing.mode {
        GateMode::Expert => return (Driver::Expert, Reason::Configured),
        // Of a person only who has not taken over comes here.
        GateMode::Policy | GateMode::Human => return (Driver::Policy, Reason::Configured),
        GateMode::Rules | GateMode::Vlm | GateMode::Paper | GateMode::Replay => {}
    }
    if let Some(reason) = hindrance(standing.stage) {
        return (Driver::Expert, reason);
    }
    let Some(advice) = standing.advice.filter(|advice| advice.answers > 0) else {
        return (Driver::Expert, Reason::Unadvised);
    };
    if standing.now >= Instant(advice.holds_until_ns) {
        return (Driver::Expert, Reason::Expired);
    }
    match advice.preference() {
        Preference::Expert => (Driver::Expert, Reason::Advised),
        Preference::Policy => (Driver::Policy, Reason::Advised),
        Preference::Abstain => (Driver::Expert, Reason::Unadvised),
    }
}

/// The policy's turn is the policy's only if it can and may.
fn may_policy(standing: &Standing, reason: Reason) -> (Driver, Reason) {
    if let Some(reason) = hindrance(standing.stage) {
        (Driver::Expert, reason)
    } else if standing.policy.is_none() {
        (Driver::Expert, Reason::Faulty)
    } else if standing.policy_assessment.is_vetoed() {
        (Driver::Expert, Reason::Vetoed)
    } else {
        (Driver::Policy, reason)
    }
}

/// The expert's turn is the brake's if the expert has nothing safe to offer.
fn expert(standing: &Standing, reason: Reason) -> Choice {
    let Some(plan) = standing.plan else {
        return brake(standing, Reason::Unplanned);
    };
    let Some(action) = standing.expert else {
        return match plan.outcome() {
            PlanOutcome::Blocked => brake(standing, Reason::Blocked),
            PlanOutcome::Reached | PlanOutcome::Partial => brake(standing, Reason::Unplanned),
        };
    };
    if standing.expert_assessment.is_vetoed() {
        return brake(standing, Reason::Unsafe);
    }
    answer(Driver::Expert, reason, action)
}

/// The full brake, along the expert's line when there is one: in a bend,
/// straight wheels leave the road.
fn brake(standing: &Standing, reason: Reason) -> Choice {
    let steer = standing.expert.map_or(0.0, |action| action.steer);
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
