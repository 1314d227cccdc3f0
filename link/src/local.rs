//! The run on the machine that joins: the mirrored services, the program on them, and what
//! it publishes.

use std::path::PathBuf;
use std::sync::Arc;

use ring::signature::Ed25519KeyPair;
use shm_config::file::{Entry, Folder, make_folders};
use shm_config::message::{Advice, FrameRequest, Health, HealthState, Learning, Weights};
use shm_config::run::{Origin, RunPaths};
use shm_config::services::{ADVICE, FRAME_REQUEST, LEARNING, WEIGHTS, health};
use shm_config::wire::{Subscriber, WireError};
use shm_config::{Instant, Message};

use crate::join::Options;
use crate::keys::Identity;
use crate::mirror::{Mirror, Shift, instants, local_config};
use crate::program::{Look, Program};
use crate::refusal::Reason;
use crate::role::{Role, RowId};
use crate::rows::{bytes_of, signed_bytes};

/// What the program publishes, to be sent back.
enum Answers {
    Judge(Subscriber<Advice>, Subscriber<FrameRequest>),
    Learner(
        Subscriber<Learning>,
        Subscriber<Weights>,
        Box<Ed25519KeyPair>,
        Identity,
    ),
    None,
}

/// The run on this machine. The program ends before its services do.
pub struct Local {
    role: Role,
    program: Option<Program>,
    answers: Answers,
    /// The program's health: it hears nothing that is published before it is ready.
    health: Option<Subscriber<Health>>,
    is_ready: bool,
    mirror: Mirror,
    /// The vehicle's configuration, with the identity of its run.
    text: String,
    lockstep: bool,
}

impl Local {
    /// Begins the run for a configuration of the vehicle.
    ///
    /// # Errors
    /// One line: the configuration is none for this machine, or the run lives already.
    pub fn open(options: &Options, role: Role, text: String) -> Result<Self, String> {
        let name = &options.name;
        let mut config = local_config(&text, name, role, &options.own)?;
        let folder = PathBuf::from(&config.run.folder);
        let whole = folder.canonicalize().map_err(|error| error.to_string())?;
        config.run.folder = whole.display().to_string();
        let origin = Origin {
            folder: whole.clone(),
            parent: None,
        };
        let mirror = Mirror::open(&config, role, &origin)?;
        let answers = Answers::open(options, role, &mirror)?;
        let failed = |error: WireError| error.to_string();
        let (program, health) = match role.stands_for() {
            Some(process) => {
                let limit_bytes = u64::from(config.supervisor.log_mb) << 20;
                let logs = (whole.join("logs"), limit_bytes);
                let program = Program::new(process, &mirror.paths.config_file(), logs);
                let program = program.map_err(|error| error.to_string())?;
                let health = mirror.wire.latest(health(process)).map_err(failed)?;
                (Some(program), Some(health))
            }
            None => (None, None),
        };
        match role {
            Role::View => tracing::info!("`./vlaps view --run {name}` shows it"),
            Role::Recorder => tracing::info!("`./vlaps record {name} --out DIR` records it"),
            Role::Judge | Role::Learner | Role::Actor => {}
        }
        Ok(Self {
            role,
            is_ready: program.is_none(),
            health,
            program,
            answers,
            mirror,
            text,
            lockstep: config.run.is_lockstep(),
        })
    }

    /// Whether it is of this configuration of this run.
    pub fn is_of(&self, text: &str) -> bool {
        self.text == text
    }

    /// What is added to the instants of messages for the program, ns; `None` while it cannot
    /// take any: it is not set up, or needs the vehicle's clock, which is not mapped yet.
    pub fn takes(&mut self, mapped: Option<Shift>) -> Option<Shift> {
        self.look_for_ready();
        // In lockstep and for a learner and for files the times stay the vehicle's: nothing
        // compares them with a clock.
        let keeps = self.lockstep || matches!(self.role, Role::Learner | Role::Recorder);
        let shift = match keeps {
            true => Some(Shift::default()),
            false => mapped,
        };
        shift.filter(|_| self.is_ready)
    }

    fn look_for_ready(&mut self) {
        let health = self
            .health
            .as_mut()
            .and_then(|port| port.newest(Message::check));
        let state = health.and_then(|health| HealthState::from_code(health.state));
        let is_set_up = matches!(state, Some(HealthState::Ready | HealthState::Running));
        if is_set_up && !self.is_ready {
            self.is_ready = true;
            self.mirror.update_connections();
        }
    }

    /// Publishes a message of the vehicle.
    ///
    /// # Errors
    /// As [`Mirror::write`].
    pub fn write(&mut self, row: RowId, bytes: &[u8], shift: Shift) -> Result<(), Reason> {
        self.mirror.write(row, bytes, shift)
    }

    /// Gives what the program has published, as it is sent.
    pub fn answer(&mut self, mapped: Option<Shift>, push: &mut dyn FnMut(RowId, Arc<[u8]>)) {
        let shift = match self.lockstep {
            true => Shift::default(),
            false => mapped.unwrap_or_default(),
        };
        let mut push = |service: &str, bytes| {
            if let Some(row) = RowId::of(service) {
                push(row, bytes);
            }
        };
        match &mut self.answers {
            Answers::Judge(advices, requests) => {
                if let Some(mut advice) = advices.newest(Message::check) {
                    for at_ns in instants(&mut advice) {
                        *at_ns = shift.there(*at_ns);
                    }
                    push(ADVICE.name, bytes_of(&advice));
                }
                if let Some(mut request) = requests.newest(Message::check) {
                    request.header.taken_ns = shift.there(request.header.taken_ns);
                    push(FRAME_REQUEST.name, bytes_of(&request));
                }
            }
            Answers::Learner(learning, weights, signer, run) => {
                let signed = weights.visit(|weights| match weights.check() {
                    Ok(()) => Some(signed_bytes(weights, *run, signer)),
                    Err(_) => None,
                });
                if let Some(bytes) = signed.flatten() {
                    push(WEIGHTS.name, bytes);
                }
                if let Some(learning) = learning.newest(Message::check) {
                    push(LEARNING.name, bytes_of(&learning));
                }
            }
            Answers::None => {}
        }
    }

    /// Starts the program when it is due, and connects to what came.
    ///
    /// # Errors
    /// One line: the program ends each time.
    pub fn look(&mut self, now: Instant) -> Result<(), String> {
        if let (Some(program), Some(process)) = (&mut self.program, self.role.stands_for()) {
            match program.look(now) {
                Look::Same => self.is_ready &= program.is_running(),
                Look::Started(pid) => {
                    self.is_ready = false;
                    self.mirror.name(process, pid);
                    self.mirror.wire.sweep();
                }
                Look::GivenUp(why) => return Err(why),
            }
        }
        self.mirror.update_connections();
        if let Some(health) = &mut self.health {
            health.update_connections();
        }
        match &mut self.answers {
            Answers::Judge(advices, requests) => {
                advices.update_connections();
                requests.update_connections();
            }
            Answers::Learner(learning, weights, ..) => {
                learning.update_connections();
                weights.update_connections();
            }
            Answers::None => {}
        }
        Ok(())
    }

    /// Asks the program to end, without waiting for it; whether it has.
    pub fn has_ended(&mut self, now: Instant) -> bool {
        let program = self.program.as_mut();
        program.is_none_or(|program| program.has_ended(now))
    }

    /// Leaves the run; its paths, which can be removed as soon as no process is part of it.
    pub fn close(self) -> RunPaths {
        self.mirror.paths.clone()
    }
}

impl Answers {
    fn open(options: &Options, role: Role, mirror: &Mirror) -> Result<Self, String> {
        let wire = &mirror.wire;
        let failed = |error: WireError| error.to_string();
        Ok(match role {
            Role::Judge => Self::Judge(
                wire.latest(ADVICE).map_err(failed)?,
                wire.latest(FRAME_REQUEST).map_err(failed)?,
            ),
            Role::Learner => {
                let signer = options.bundle.signer();
                Self::Learner(
                    wire.latest(LEARNING).map_err(failed)?,
                    wire.latest(WEIGHTS).map_err(failed)?,
                    Box::new(signer.map_err(|error| error.to_string())?),
                    options.bundle.identity,
                )
            }
            Role::View | Role::Recorder | Role::Actor => Self::None,
        })
    }
}

/// Makes the folder of a run on this machine, with the one of its logs.
///
/// # Errors
/// One line: it is not the user's own, or cannot be made.
pub fn make_folder(options: &Options) -> Result<PathBuf, String> {
    let folder = PathBuf::from(format!("runs/{}", options.name));
    let failed = |error: std::io::Error| format!("{}: {error}", folder.display());
    make_folders(&folder).map_err(failed)?;
    let made = Folder::open(&folder, Entry::Readable).map_err(failed)?;
    made.make_inside("logs", Entry::Readable).map_err(failed)?;
    Ok(folder)
}
