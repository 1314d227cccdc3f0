//! The run on the machine that joins: its own place and shared memory, in which the mirrored
//! services are published and an unchanged program of the build runs.
//!
//! Its roster names this process as world, controller and all else that is mirrored, so the
//! program takes their messages from it, and from nothing else on this machine.

use std::collections::BTreeMap;
use std::mem::offset_of;
use std::time::Duration;

use shm_config::Message;
use shm_config::config::Config;
use shm_config::file::{Durable, replace};
use shm_config::layout::Layout as _;
use shm_config::message::{
    Advice, Camera, Episode, Foresight, Frame, Header, Health, Learning, PolicyStatus, Progress,
    Roster, Step, Timing,
};
use shm_config::run::{Origin, RunLock, RunName, RunPaths};
use shm_config::services::{
    ADVICE, EPISODE, FORESIGHT, FRAME, LEARNING, POLICY_STATUS, PROGRESS, Process, ROSTER, STEP,
    Service, health, timing,
};
use shm_config::wire::{Publisher, Wire, WireError};

use crate::refusal::Reason;
use crate::role::{Role, RowId};
use crate::rows::message_of;

/// How far the vehicle's clock is mapped, ns that are added to its instants.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Shift(pub i64);

impl Shift {
    /// An instant of the vehicle on this machine's clock; 0 stays "never".
    pub fn here(self, taken_ns: u64) -> u64 {
        match taken_ns {
            0 => 0,
            _ => taken_ns.saturating_add_signed(self.0),
        }
    }

    /// The way back, to the nanosecond.
    pub fn there(self, taken_ns: u64) -> u64 {
        Self(-self.0).here(taken_ns)
    }
}

/// Messages with instants that their readers compare with their own clock.
trait Dated: Message {
    fn dated(&mut self, shift: Shift) {
        let header = self.header_mut();
        header.taken_ns = shift.here(header.taken_ns);
    }
}

/// The instants of advice, all on the run's clock.
pub fn instants(advice: &mut Advice) -> [&mut u64; 7] {
    [
        &mut advice.header.taken_ns,
        &mut advice.question_taken_ns,
        &mut advice.answered_ns,
        &mut advice.considered_ns,
        &mut advice.holds_until_ns,
        &mut advice.label_from_ns,
        &mut advice.label_until_ns,
    ]
}

impl Dated for Advice {
    fn dated(&mut self, shift: Shift) {
        for at_ns in instants(self) {
            *at_ns = shift.here(*at_ns);
        }
    }
}
impl Dated for Episode {}
impl Dated for Foresight {}
impl Dated for Health {}
impl Dated for Learning {}
impl Dated for PolicyStatus {}
impl Dated for Progress {}
impl Dated for Timing {}
impl Dated for Step {
    fn dated(&mut self, shift: Shift) {
        for taken_ns in [
            &mut self.header.taken_ns,
            &mut self.observation.header.taken_ns,
            &mut self.timings.scheduled_ns,
            &mut self.timings.released_ns,
            &mut self.timings.started_ns,
            &mut self.timings.planned_ns,
            &mut self.timings.decided_ns,
            &mut self.timings.commanded_ns,
        ] {
            *taken_ns = shift.here(*taken_ns);
        }
    }
}

trait Write {
    fn write(&mut self, bytes: &[u8], shift: Shift) -> Result<(), Reason>;
    fn update_connections(&mut self);
}

impl<M: Dated> Write for Publisher<M> {
    fn write(&mut self, bytes: &[u8], shift: Shift) -> Result<(), Reason> {
        let mut message: M = message_of(bytes)?;
        message.dated(shift);
        self.pass_on(&message);
        Ok(())
    }

    fn update_connections(&mut self) {
        Publisher::update_connections(self);
    }
}

struct Pictures(Publisher<Frame>);

impl Write for Pictures {
    fn write(&mut self, bytes: &[u8], shift: Shift) -> Result<(), Reason> {
        let part = |from: usize, size: usize| bytes.get(from..from + size).ok_or(Reason::Content);
        let header = part(offset_of!(Frame, header), size_of::<Header>())?;
        let camera = part(offset_of!(Frame, camera), size_of::<Camera>())?;
        let width = part(offset_of!(Frame, width), 4)?;
        let pixels = bytes
            .get(offset_of!(Frame, pixels)..)
            .ok_or(Reason::Content)?;
        let mut header = Header::from_bytes(header).ok_or(Reason::Content)?;
        let camera = Camera::from_bytes(camera).ok_or(Reason::Content)?;
        let width = width.try_into().map(u32::from_le_bytes).unwrap_or_default();
        camera.check().map_err(|_| Reason::Content)?;
        header.taken_ns = shift.here(header.taken_ns);
        match self.0.show(header, camera, width, pixels) {
            true => Ok(()),
            false => Err(Reason::Content),
        }
    }

    fn update_connections(&mut self) {
        self.0.update_connections();
    }
}

/// The mirrored run. Ports are dropped before the membership.
pub struct Mirror {
    rows: BTreeMap<RowId, Box<dyn Write>>,
    roster: Roster,
    roster_port: Publisher<Roster>,
    /// The membership of this process.
    pub wire: Wire,
    /// Its paths.
    pub paths: RunPaths,
    lock: RunLock,
}

/// What the configuration of the vehicle becomes on this machine.
///
/// # Errors
/// When it is none.
pub fn local_config(
    text: &str,
    name: &RunName,
    role: Role,
    own: &Config,
) -> Result<Config, String> {
    let mut config = shm_config::config::from_toml(text, "the vehicle's configuration")
        .map_err(|error| error.to_string())?;
    config.run.name = name.to_string();
    config.run.folder = format!("runs/{name}");
    config.programs = Default::default();
    config.link = Default::default();
    config.supervisor.realtime = false;
    config.run.faults = false;
    // The model that is asked, and its key, are this machine's.
    config.vlm.server.clone_from(&own.vlm.server);
    config.vlm.key_env.clone_from(&own.vlm.key_env);
    config.vlm.key_file.clone_from(&own.vlm.key_file);
    config.vlm.ca_file.clone_from(&own.vlm.ca_file);
    config.vlm.key_over_http = own.vlm.key_over_http;
    // Paths in the vehicle's configuration are not used on this machine. The program of a
    // judge alone opens the gate's files; the others only read which gate the vehicle has.
    config
        .policy
        .onnxruntime
        .clone_from(&own.policy.onnxruntime);
    if role == Role::Judge {
        config.gate.distilled.clone_from(&own.gate.distilled);
        config.gate.recording.clone_from(&own.gate.recording);
    }
    config.validated().map_err(|error| {
        format!("{error}; settings of this machine are those of `./vlaps join --config FILE`")
    })
}

impl Mirror {
    /// Takes the place of a run on this machine and opens the services that the role hears.
    ///
    /// # Errors
    /// When the run lives already, or shared memory refuses.
    pub fn open(config: &Config, role: Role, origin: &Origin) -> Result<Self, String> {
        let name: RunName = config
            .run
            .name
            .parse()
            .map_err(|error| format!("{error}"))?;
        let paths = RunPaths::new(name.clone());
        let lock = paths.hold_supervisor().map_err(|error| error.to_string())?;
        let lock = lock.ok_or_else(|| {
            format!("run '{name}' lives on this machine already; choose another --run NAME")
        })?;
        let cleaned = paths.clean_if_dead().map_err(|error| error.to_string())?;
        if cleaned.is_none() {
            return Err(format!(
                "a process of run '{name}' lives; choose another --run NAME"
            ));
        }
        let text = toml::to_string(config).map_err(|error| error.to_string())?;
        let failed = |error: &dyn std::fmt::Display| format!("run '{name}': {error}");
        replace(&paths.config_file(), text.as_bytes(), Durable::No).map_err(|e| failed(&e))?;
        paths.keep_origin(origin).map_err(|error| failed(&error))?;
        let mirror = Self::join(paths, lock, role).map_err(|error| failed(&error))?;
        let opened = mirror.paths.open(&mirror.lock);
        opened.map_err(|error| failed(&error))?;
        Ok(mirror)
    }

    fn join(paths: RunPaths, lock: RunLock, role: Role) -> Result<Self, WireError> {
        let wire = Wire::join(paths.name(), Process::Supervisor)?;
        let mut roster = Roster::default();
        for process in Process::ALL {
            roster.set(*process, Some(std::process::id()));
        }
        let mut roster_port = wire.publisher(ROSTER)?;
        roster_port.send(&mut roster);
        wire.trust(&roster);
        let mut mirror = Self {
            rows: BTreeMap::new(),
            roster,
            roster_port,
            wire,
            paths,
            lock,
        };
        mirror.mirror(role, STEP)?;
        mirror.mirror(role, EPISODE)?;
        mirror.mirror(role, FORESIGHT)?;
        mirror.mirror(role, POLICY_STATUS)?;
        mirror.mirror(role, PROGRESS)?;
        if role.stands_for().is_none() {
            mirror.mirror(role, ADVICE)?;
            mirror.mirror(role, LEARNING)?;
            for process in Process::ALL {
                mirror.mirror(role, health(*process))?;
                mirror.mirror(role, timing(*process))?;
            }
        }
        if let Some(row) = RowId::of(FRAME.name).filter(|row| role.hears(*row)) {
            let port = mirror.wire.publisher(FRAME)?;
            mirror.rows.insert(row, Box::new(Pictures(port)));
        }
        Ok(mirror)
    }

    fn mirror<M: Dated>(&mut self, role: Role, service: Service<M>) -> Result<(), WireError> {
        if let Some(row) = RowId::of(service.name).filter(|row| role.hears(*row)) {
            let port = self.wire.publisher(service)?;
            self.rows.insert(row, Box::new(port));
        }
        Ok(())
    }

    /// Names the process that runs in this place.
    pub fn name(&mut self, process: Process, pid: u32) {
        self.roster.set(process, Some(pid));
        self.roster_port.send(&mut self.roster);
        self.wire.trust(&self.roster);
    }

    /// Publishes a message of the vehicle.
    ///
    /// # Errors
    /// When its content is wrong, or the row is not mirrored.
    pub fn write(&mut self, row: RowId, bytes: &[u8], shift: Shift) -> Result<(), Reason> {
        let port = self.rows.get_mut(&row).ok_or(Reason::NotAllowed)?;
        port.write(bytes, shift)
    }

    /// Connects to processes that came.
    pub fn update_connections(&mut self) {
        self.roster_port.update_connections();
        for port in self.rows.values_mut() {
            port.update_connections();
        }
    }
}

impl Drop for Mirror {
    fn drop(&mut self) {
        // Observers let go of the run before its lock is free.
        self.paths.close();
    }
}

/// How long a process that ends may keep a run alive, ns; the next start removes the rest.
pub const REMOVED_NS: u64 = 2_000_000_000;
/// Time between two attempts to remove it.
const REMOVE_AGAIN: Duration = Duration::from_millis(50);

/// Removes what a mirrored run left on the machine, once its ports are closed; whether there
/// is nothing more to do.
pub fn is_removed(paths: &RunPaths) -> bool {
    match paths.clean_if_dead() {
        Ok(Some(_)) => {
            paths.remove_dir();
            true
        }
        Ok(None) => false,
        Err(_) => true,
    }
}

/// The same, with a wait for a process that ends.
pub fn remove(paths: &RunPaths) {
    for _ in 0..REMOVED_NS / REMOVE_AGAIN.as_nanos() as u64 {
        if is_removed(paths) {
            return;
        }
        std::thread::park_timeout(REMOVE_AGAIN);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shm_config::config::GateMode;

    /// No file that the vehicle names is opened on this machine.
    #[test]
    fn files_are_those_of_this_machine() {
        let mut there = Config::default();
        there.gate.mode = GateMode::Replay;
        there.gate.recording = "/vehicle/answers.jsonl".into();
        there.gate.distilled = "/vehicle/judge.json".into();
        there.policy.onnxruntime = "/vehicle/libonnxruntime.so".into();
        let text = toml::to_string(&there).expect("a text");
        let name: RunName = "drive-judge".parse().expect("a name");
        let mut own = Config::default();
        let refused = local_config(&text, &name, Role::Judge, &own).expect_err("no recording");
        assert!(refused.contains("gate.recording"), "{refused}");
        own.gate.recording = "/here/answers.jsonl".into();
        let config = local_config(&text, &name, Role::Judge, &own).expect("a configuration");
        assert_eq!(config.gate.recording, "/here/answers.jsonl");
        assert_eq!(
            (&*config.gate.distilled, &*config.policy.onnxruntime),
            ("", "")
        );
        let config = local_config(&text, &name, Role::View, &own).expect("a configuration");
        assert_eq!(config.gate.mode, GateMode::Replay);
        assert_eq!(config.policy.onnxruntime, "");
    }
}
