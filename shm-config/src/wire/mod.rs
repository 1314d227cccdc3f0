//! Ports on shared memory: the only place that talks to iceoryx2.

mod cause;
mod doorbell;
mod ports;
mod producers;
mod publisher;
mod subscriber;

use std::rc::Rc;
use std::time::Duration;

use iceoryx2::prelude::*;
use iceoryx2::service::Service as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory as Topic;

use rustix::event::poll;
use rustix::time::Timespec;

pub use doorbell::Doorbell;
pub use ports::{Family, Use};
pub use producers::Foreigner;
use producers::Producers;
pub use publisher::Publisher;
pub use subscriber::Subscriber;

use crate::message::{Message, Refusal, Refusals, Roster};
use crate::run::{RunError, RunLock, RunName, RunPaths};
use crate::services::{Process, ROSTER, Row, SERVICES, Service};

type Ipc = ipc::Service;
/// A reading end, and the service that it reads.
type OpenPort<M> = (
    iceoryx2::port::subscriber::Subscriber<Ipc, M, ()>,
    Topic<Ipc, M, ()>,
);

/// Publishers of one service at a time: the living one, and dead ones that are not
/// swept yet.
pub const PUBLISHERS_MAX: usize = 4;
/// Readers of one service at a time: processes, command-line tools, recorders.
pub const SUBSCRIBERS_MAX: usize = 16;
/// Publishers of one service that have ended and left unread messages, for each reader.
/// Each read examines a place for every one: the library's default of 128 costs 0.1 us
/// a read.
const GONE_MAX: usize = 2 * PUBLISHERS_MAX;
/// Processes that may open one service.
pub const NODES_MAX: usize = 32;

/// Time between two reads of a roster that is awaited. A supervisor publishes it every
/// 5 ms while processes start, and every 50 ms while they drive.
const NAMED_LOOK: Timespec = Timespec {
    tv_sec: 0,
    tv_nsec: 500_000,
};
/// Reads until the wait for a roster is given up: 5 s.
const NAMED_LOOKS: u32 = 10_000;

/// How long a process beside the run waits after each port that it opens or closes. A
/// producer connects to a new reader, and parts from one that has gone, at its next send:
/// some 20 us a port, and up to a millisecond in a sandbox whose system calls are slow. So
/// no tick pays for many.
const PORT_PAUSE: Timespec = Timespec {
    tv_sec: 0,
    tv_nsec: 3_000_000,
};

/// The service attribute that carries the layout's fingerprint.
pub const LAYOUT_KEY: &str = "layout";

/// Why a port could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum WireError {
    /// The run's folder.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Two programs have different layouts of a message.
    #[error(
        "service '{service}': the running side uses message layout {theirs}, this binary {ours}; \
         stop the run (./vlaps down) and rebuild both sides from one source"
    )]
    Layout {
        /// The service.
        service: &'static str,
        /// The other side's layout.
        theirs: String,
        /// This side's layout.
        ours: String,
    },
    /// The run's supervisor has not started the process.
    #[error(
        "process {pid} is not named as the run's {process} by the process that started it; \
         `./vlaps up` starts all processes of a run"
    )]
    Unnamed {
        /// The process as which it would join.
        process: Process,
        /// Its process id.
        pid: u32,
    },
    /// Shared memory refused.
    #[error("service '{service}': shared memory refuses ({what}): {cause}")]
    Port {
        /// The service.
        service: &'static str,
        /// The error of iceoryx2.
        what: String,
        /// The cause, and what to do.
        cause: String,
    },
}

impl WireError {
    /// The error of shared memory for this service, with the library's text.
    pub fn port(service: &'static str, what: impl std::fmt::Display) -> Self {
        let what = what.to_string();
        let cause = cause::of(&what);
        Self::Port {
            service,
            what,
            cause,
        }
    }
}

/// A process's membership in a run.
pub struct Wire {
    producers: Rc<Producers>,
    node: Node<Ipc>,
    config: Config,
    process: Process,
    _alive: RunLock,
}

fn pause() {
    let _ = poll(&mut [], Some(&PORT_PAUSE));
}

fn iceoryx_config(paths: &RunPaths) -> Result<Config, WireError> {
    let port_error = |what: String| WireError::port("run", what);
    let mut config = Config::default();
    let root = paths.dir();
    let root = root.to_string_lossy();
    let root = iceoryx2::prelude::Path::new(root.as_bytes())
        .map_err(|error| port_error(format!("folder {root}: {error:?}")))?;
    config.global.set_root_path(&root);
    config.global.prefix = FileName::new(paths.prefix().as_bytes())
        .map_err(|error| port_error(format!("prefix {}: {error:?}", paths.prefix())))?;
    let topics = &mut config.defaults.publish_subscribe;
    topics.subscriber_expired_connection_buffer = GONE_MAX;
    Ok(config)
}

impl Wire {
    /// Joins a run, and creates it if it does not exist. Dead members are swept.
    ///
    /// # Errors
    /// When the run's folder or shared memory cannot be used.
    pub fn join(name: &RunName, process: Process) -> Result<Self, WireError> {
        let paths = RunPaths::new(name.clone());
        let alive = paths.hold_alive()?;
        // The library's own messages go to stderr; errors are returned as values.
        set_log_level(LogLevel::Fatal);
        let config = iceoryx_config(&paths)?;
        let node_name = NodeName::new(process.word())
            .map_err(|error| WireError::port("run", format!("node name: {error:?}")))?;
        let node = NodeBuilder::new()
            .name(&node_name)
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Ipc>()
            .map_err(|error| {
                WireError::port("run", format!("cannot join run '{name}': {error:?}"))
            })?;
        paths.make_private()?;
        Ok(Self {
            producers: Rc::new(Producers::open()),
            node,
            config,
            process,
            _alive: alive,
        })
    }

    /// From now on takes state only from the processes on this roster; for the
    /// supervisor, which publishes it.
    pub fn trust(&self, roster: &Roster) {
        self.producers.set(roster);
    }

    /// From now on takes state only from the processes on the rosters of the process
    /// `author`. Messages that arrive before its first roster are refused.
    ///
    /// # Errors
    /// As [`Wire::publisher`].
    pub fn follow(&self, author: u32) -> Result<(), WireError> {
        let port = self.port(ROSTER, 1)?.0;
        self.producers.follow(author, port);
        Ok(())
    }

    /// Whether the process only reads what others publish: a recorder, or a command that
    /// follows a supervisor and has joined in its place.
    fn is_beside(&self) -> bool {
        match self.process {
            Process::Recorder => true,
            Process::Supervisor => self.producers.follows(),
            _ => false,
        }
    }

    /// Waits until the roster names this process id. Ports that are opened afterwards
    /// miss no message sent after it.
    ///
    /// # Errors
    /// When it does not within five seconds.
    pub fn await_named(&self, process: Process, pid: u32) -> Result<(), WireError> {
        for _ in 0..NAMED_LOOKS {
            if self.named(process) == Some(pid) {
                return Ok(());
            }
            // A signal may end the sleep early; then it reads a little earlier.
            let _ = poll(&mut [], Some(&NAMED_LOOK));
        }
        Err(WireError::Unnamed { process, pid })
    }

    /// The process id on the roster; `None` when the roster names none or has not
    /// arrived.
    pub fn named(&self, process: Process) -> Option<u32> {
        self.producers.pid(process)
    }

    /// Counts a message that its reader refused after it was received.
    pub fn refuse(&self, refusal: &Refusal) {
        self.producers.count(refusal.kind());
    }

    /// Messages that the ports of this membership refused, by reason.
    pub fn refused(&self) -> Refusals {
        self.producers.refused()
    }

    /// The number of messages refused because a living process sent them in place of
    /// one that the run has started. While it grows, one state has two producers.
    pub fn contests(&self) -> u64 {
        self.producers.contests()
    }

    /// The last process that sent such a message; `None` when there was none.
    pub fn foreigner(&self) -> Option<Foreigner> {
        self.producers.foreigner()
    }

    /// Frees what dead processes held, so that their successors can start. It is slow;
    /// never call it within a tick.
    pub fn sweep(&self) {
        self.node
            .blocking_cleanup_dead_nodes(Duration::from_millis(200));
    }

    /// Compares the layouts of the process's rows with those that the run uses already.
    /// Opening a port compares too; a program that cannot be rebuilt beside the run, such
    /// as one on the C library, learns it before it opens any.
    ///
    /// # Errors
    /// The first service whose layout differs.
    pub fn compare_layouts(&self, process: Process) -> Result<(), WireError> {
        let is_of = |row: &&Row| row.is_produced_by(process) || row.is_consumed_by(process);
        for row in SERVICES.iter().filter(is_of) {
            let ours = format!("{:016x}", row.message.fingerprint);
            for service in row.instances {
                let name = ServiceName::new(service)
                    .map_err(|error| WireError::port(service, format!("{error:?}")))?;
                if let Some(error) = self.layout_error(&name, service, &ours) {
                    return Err(error);
                }
            }
        }
        Ok(())
    }

    /// Opens the publishing end of a service.
    ///
    /// # Errors
    /// When the layout differs from the running side's, or shared memory refuses.
    pub fn publisher<M: Message>(&self, service: Service<M>) -> Result<Publisher<M>, WireError> {
        let topic = self.topic(service)?;
        let failed = |what: String| WireError::port(service.name, what);
        let port = topic
            .publisher_builder()
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(|error| failed(format!("{error:?}")))?;
        let mut bells = Vec::new();
        for process in service.row.wakes {
            let bell = self.bell(*process)?;
            let notifier = bell
                .notifier_builder()
                .create()
                .map_err(|error| failed(format!("doorbell of {process}: {error:?}")))?;
            bells.push(Rc::new(notifier));
        }
        Ok(Publisher::new(port, bells))
    }

    /// Opens the reading end of a service, with the table's queue.
    ///
    /// # Errors
    /// As [`Wire::publisher`].
    pub fn subscriber<M: Message>(&self, service: Service<M>) -> Result<Subscriber<M>, WireError> {
        let (depth, _) = service.row.delivery.queue();
        self.subscriber_of_depth(service, depth)
    }

    /// Opens the reading end of a queue that is read for its newest message only.
    ///
    /// # Errors
    /// As [`Wire::publisher`].
    pub fn latest<M: Message>(&self, service: Service<M>) -> Result<Subscriber<M>, WireError> {
        self.subscriber_of_depth(service, 1)
    }

    /// Opens the reading end of a service for a reader that wants every message. It may fall
    /// behind by as many as [`Row::recorded_depth`](crate::services::Row::recorded_depth).
    ///
    /// # Errors
    /// As [`Wire::publisher`].
    pub fn every<M: Message>(&self, service: Service<M>) -> Result<Subscriber<M>, WireError> {
        self.subscriber_of_depth(service, service.row.recorded_depth())
    }

    fn subscriber_of_depth<M: Message>(
        &self,
        service: Service<M>,
        depth: usize,
    ) -> Result<Subscriber<M>, WireError> {
        let (port, topic) = self.port(service, depth)?;
        let producers = self.producers.clone();
        Ok(Subscriber::new(
            port,
            topic,
            producers,
            (service, depth),
            self.is_beside(),
        ))
    }

    fn port<M: Message>(
        &self,
        service: Service<M>,
        depth: usize,
    ) -> Result<OpenPort<M>, WireError> {
        let topic = self.topic(service)?;
        let port = topic
            .subscriber_builder()
            .buffer_size(depth)
            .create()
            .map_err(|error| WireError::port(service.name, format!("{error:?}")))?;
        if self.is_beside() {
            pause();
        }
        Ok((port, topic))
    }

    /// Opens the process's own doorbell.
    ///
    /// # Errors
    /// When shared memory or the socket refuses.
    pub fn doorbell(&self, process: Process) -> Result<Doorbell, WireError> {
        let listener = self
            .bell(process)?
            .listener_builder()
            .create()
            .map_err(|error| WireError::port("doorbell", format!("{process}: {error:?}")))?;
        Ok(Doorbell::new(listener))
    }

    fn bell(
        &self,
        process: Process,
    ) -> Result<iceoryx2::service::port_factory::event::PortFactory<Ipc>, WireError> {
        let failed = |what: String| WireError::port("doorbell", what);
        let name = ServiceName::new(&format!("doorbell/{process}"))
            .map_err(|error| failed(format!("{process}: {error:?}")))?;
        self.node
            .service_builder(&name)
            .event()
            .max_nodes(NODES_MAX)
            .max_listeners(PUBLISHERS_MAX)
            .max_notifiers(NODES_MAX)
            .event_id_max_value(1)
            .open_or_create()
            .map_err(|error| failed(format!("{process}: {error:?}")))
    }

    fn topic<M: Message>(&self, service: Service<M>) -> Result<Topic<Ipc, M, ()>, WireError> {
        let failed = |what: String| WireError::port(service.name, what);
        let name = ServiceName::new(service.name).map_err(|error| failed(format!("{error:?}")))?;
        let ours = format!("{:016x}", M::FINGERPRINT);
        let verifier = attributes(&ours).map_err(&failed)?;
        let (_, history) = service.row.delivery.queue();
        self.node
            .service_builder(&name)
            .publish_subscribe::<M>()
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(service.row.recorded_depth())
            .subscriber_max_borrowed_samples(1)
            .history_size(history)
            .max_publishers(PUBLISHERS_MAX)
            .max_subscribers(SUBSCRIBERS_MAX)
            .max_nodes(NODES_MAX)
            .open_or_create_with_attributes(&verifier)
            .map_err(|error| {
                self.layout_error(&name, service.name, &ours)
                    .unwrap_or_else(|| failed(format!("{error:?}")))
            })
    }

    /// The error that names both layouts, when it is a layout that differs.
    fn layout_error(
        &self,
        name: &ServiceName,
        service: &'static str,
        ours: &str,
    ) -> Option<WireError> {
        let details =
            Ipc::details(name, &self.config, MessagingPattern::PublishSubscribe).ok()??;
        let attributes = details.static_details.attributes();
        let key = LAYOUT_KEY.try_into().ok()?;
        let theirs = attributes.key_value(&key, 0)?.to_string();
        (theirs != ours).then(|| WireError::Layout {
            service,
            theirs,
            ours: ours.into(),
        })
    }
}

fn attributes(layout: &str) -> Result<AttributeVerifier, String> {
    let failed = |error: SemanticStringError| format!("{error:?}");
    let key = LAYOUT_KEY.try_into().map_err(failed)?;
    let layout = layout.try_into().map_err(failed)?;
    AttributeVerifier::new()
        .require(&key, &layout)
        .map_err(|error| format!("{error:?}"))
}
