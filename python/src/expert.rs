//! The experts: planner and controller of the stack, applied to the environments'
//! observations.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use shm_config::config::planner::Method;
use shm_config::config::{Config, ConfigError, from_toml};
use shm_config::message::Observation;
use stack::driver::DriverKind;
use stack::oracle::Oracle;

use crate::crew::Crew;
use crate::env::{Env, Pair};

/// An expert that can be asked in an environment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Expert {
    /// MetaDrive's traffic driver, which knows the world's true state.
    Idm,
    /// Planner and controller of the stack with this planning method.
    Planner(Method),
}

impl Expert {
    /// Parses a name, as in `./vlaps eval --driver`.
    ///
    /// # Errors
    /// One line with the valid names.
    pub fn parse(name: &str) -> Result<Expert, String> {
        let refusal =
            || format!("expert {name:?}: choose from idm, rrt-star, informed, kinodynamic, mpc");
        let kind: DriverKind = name.parse().map_err(|_| refusal())?;
        match kind {
            DriverKind::Idm => Ok(Expert::Idm),
            kind => kind.method().map(Expert::Planner).ok_or_else(refusal),
        }
    }
}

/// The configuration of a run with changes, a JSON object of sections.
///
/// # Errors
/// One line that names the key.
pub fn config(changes: &str) -> Result<Config, String> {
    let changes: toml::Table = serde_json::from_str(changes).map_err(|error| error.to_string())?;
    let text = toml::to_string(&changes).map_err(|error| error.to_string())?;
    from_toml(&text, "expert_config").map_err(|error| match error {
        // The line is one of the text above, which the caller does not know.
        ConfigError::Syntax { origin, message } => {
            let line = origin.rsplit(':').next().and_then(|line| line.parse().ok());
            let line = line.and_then(|line: usize| text.lines().nth(line.saturating_sub(1)));
            format!("expert_config: {message} in '{}'", line.unwrap_or(&text))
        }
        other => other.to_string(),
    })
}

/// Experts without memory: each answer depends on one observation only, so that neither the
/// order of the questions nor the number of threads affects it.
pub struct Experts {
    config: Config,
    /// Experts that no thread is using, by method.
    idle: Mutex<Vec<(Method, Oracle)>>,
}

impl Experts {
    /// Experts of this configuration.
    pub fn new(config: Config) -> Experts {
        Experts {
            config,
            idle: Mutex::default(),
        }
    }

    /// Actions in the wanted environments; `NaN` in the others.
    ///
    /// # Errors
    /// One line, if the planner's configuration is out of range.
    pub fn ask(
        &self,
        method: Method,
        (envs, wanted): (&[Env], &[bool]),
        crew: &Crew,
    ) -> Result<Vec<Pair>, String> {
        let next = AtomicUsize::new(0);
        let answers = Mutex::new(Vec::new());
        crew.run(&|_| {
            let told = self.work(method, (envs, wanted), &next);
            answers
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .push(told);
        });
        let answers = answers.into_inner().unwrap_or_else(PoisonError::into_inner);
        let answers: Result<Vec<_>, String> = answers.into_iter().collect();
        let mut actions = vec![[f32::NAN; 2]; envs.len()];
        for (index, action) in answers?.into_iter().flatten() {
            actions[index] = action;
        }
        Ok(actions)
    }

    /// Answers in one wanted environment after the other until none is left.
    fn work(
        &self,
        method: Method,
        (envs, wanted): (&[Env], &[bool]),
        next: &AtomicUsize,
    ) -> Result<Vec<(usize, Pair)>, String> {
        let mut oracle = self.take(method)?;
        let mut observation = Box::<Observation>::default();
        let mut answers = Vec::new();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let (Some(env), Some(&is_wanted)) = (envs.get(index), wanted.get(index)) else {
                break;
            };
            if is_wanted {
                env.perceived(&mut observation);
                let action = oracle.ask(&mut observation);
                answers.push((index, [action.steer as f32, action.pedal as f32]));
            }
        }
        self.idle().push((method, oracle));
        Ok(answers)
    }

    fn take(&self, method: Method) -> Result<Oracle, String> {
        let mut idle = self.idle();
        if let Some(place) = idle.iter().position(|(of, _)| *of == method) {
            return Ok(idle.swap_remove(place).1);
        }
        drop(idle);
        let config = DriverKind::of_method(method).configure(&self.config);
        Oracle::new(&config).map_err(|error| error.to_string())
    }

    fn idle(&self) -> MutexGuard<'_, Vec<(Method, Oracle)>> {
        // Experts are added and removed whole, so a panic leaves no partial entry.
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
