//! Ports on shared memory: the only place that talks to iceoryx2.

use std::mem::MaybeUninit;
use std::rc::Rc;
use std::time::Duration;

use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use iceoryx2::sample_mut_uninit::SampleMutUninit;
use iceoryx2::service::Service as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory as Topic;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::time::Timespec;

use crate::message::{
    Camera, FRAME_BYTES_MAX, Frame, Header, Message, PixelFormat, WEIGHTS_BYTES_MAX, Weights,
};
use crate::run::{RunError, RunLock, RunName, RunPaths};
use crate::services::{Process, Service};

type Ipc = ipc::Service;

/// Publishers of one service at a time: the living one, and dead ones that have
/// not been swept yet.
pub const PUBLISHERS_MAX: usize = 4;
/// Readers of one service at a time: processes, command-line tools, recorders.
pub const SUBSCRIBERS_MAX: usize = 16;
/// Publishers that have gone and left something unread, of one service and reader. Each
/// look passes over a place for every one: the library's own 128 cost 0.1 us a look.
const GONE_MAX: usize = 2 * PUBLISHERS_MAX;
/// Processes that may look at one service.
pub const NODES_MAX: usize = 32;

/// The service attribute that carries the layout's fingerprint.
pub const LAYOUT_KEY: &str = "layout";

/// Why a port could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum WireError {
    /// The run's folder.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Two binaries disagree on a message.
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
    /// Shared memory refused.
    #[error(
        "service '{service}': shared memory refuses ({what}): no space in /dev/shm, or its files \
         were removed or written over while the run drives; `./vlaps doctor` shows the space, `./vlaps down` ends the run"
    )]
    Port {
        /// The service.
        service: &'static str,
        /// What iceoryx2 said.
        what: String,
    },
}

/// A process's membership in a run.
pub struct Wire {
    node: Node<Ipc>,
    config: Config,
    _alive: RunLock,
}

/// Publishes one service and wakes its readers.
pub struct Publisher<M: Message> {
    /// Room for the next message, borrowed between ticks: the library allocates
    /// a handle for each loan.
    room: Option<SampleMutUninit<Ipc, MaybeUninit<M>, ()>>,
    port: iceoryx2::port::publisher::Publisher<Ipc, M, ()>,
    bells: Vec<Rc<Notifier<Ipc>>>,
    sequence: u64,
    producer: u32,
}

/// Reads one service.
pub struct Subscriber<M: Message> {
    port: iceoryx2::port::subscriber::Subscriber<Ipc, M, ()>,
    topic: Topic<Ipc, M, ()>,
    /// At the last tending at most one message could wait.
    holds_one: bool,
    depth: usize,
    producer: u32,
    sequence: u64,
    lost: u64,
}

/// Where a process sleeps until one of its services has something new.
pub struct Doorbell {
    listener: Listener<Ipc>,
}

fn iceoryx_config(paths: &RunPaths) -> Result<Config, WireError> {
    let port_error = |what: String| WireError::Port {
        service: "run",
        what,
    };
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
    /// Joins a run, making it if it does not exist. Dead members are swept.
    ///
    /// # Errors
    /// When the run's folder or shared memory cannot be used.
    pub fn join(name: &RunName, process: Process) -> Result<Self, WireError> {
        let paths = RunPaths::new(name.clone());
        let alive = paths.hold_alive()?;
        // Its messages go to stderr from inside ports; errors come as values.
        set_log_level(LogLevel::Fatal);
        let config = iceoryx_config(&paths)?;
        let node_name = NodeName::new(process.word()).map_err(|error| WireError::Port {
            service: "run",
            what: format!("node name: {error:?}"),
        })?;
        let node = NodeBuilder::new()
            .name(&node_name)
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Ipc>()
            .map_err(|error| WireError::Port {
                service: "run",
                what: format!("cannot join run '{name}': {error:?}"),
            })?;
        paths.make_private()?;
        Ok(Self {
            node,
            config,
            _alive: alive,
        })
    }

    /// Frees what dead processes held, so that their successors can start. Slow;
    /// never from a tick.
    pub fn sweep(&self) {
        self.node
            .blocking_cleanup_dead_nodes(Duration::from_millis(200));
    }

    /// Opens the publishing end of a service.
    ///
    /// # Errors
    /// When the layout differs from the running side's, or shared memory refuses.
    pub fn publisher<M: Message>(&self, service: Service<M>) -> Result<Publisher<M>, WireError> {
        let topic = self.topic(service)?;
        let failed = |what: String| WireError::Port {
            service: service.name,
            what,
        };
        let port = topic
            .publisher_builder()
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(|error| failed(format!("{error:?}")))?;
        let mut bells = Vec::new();
        for process in service.to {
            let bell = self.bell(*process)?;
            let notifier = bell
                .notifier_builder()
                .create()
                .map_err(|error| failed(format!("doorbell of {process}: {error:?}")))?;
            bells.push(Rc::new(notifier));
        }
        Ok(Publisher {
            room: port.loan_uninit().ok(),
            port,
            bells,
            sequence: 0,
            producer: std::process::id(),
        })
    }

    /// Opens the reading end of a service, with the table's queue.
    ///
    /// # Errors
    /// As [`Wire::publisher`].
    pub fn subscriber<M: Message>(&self, service: Service<M>) -> Result<Subscriber<M>, WireError> {
        let (depth, _) = service.delivery.queue();
        self.subscriber_of_depth(service, depth)
    }

    /// Opens the reading end of a queue that is read for its newest message only.
    ///
    /// # Errors
    /// As [`Wire::publisher`].
    pub fn latest<M: Message>(&self, service: Service<M>) -> Result<Subscriber<M>, WireError> {
        self.subscriber_of_depth(service, 1)
    }

    fn subscriber_of_depth<M: Message>(
        &self,
        service: Service<M>,
        depth: usize,
    ) -> Result<Subscriber<M>, WireError> {
        let topic = self.topic(service)?;
        let port = topic
            .subscriber_builder()
            .buffer_size(depth)
            .create()
            .map_err(|error| WireError::Port {
                service: service.name,
                what: format!("{error:?}"),
            })?;
        Ok(Subscriber {
            port,
            topic,
            holds_one: false,
            depth,
            producer: 0,
            sequence: 0,
            lost: 0,
        })
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
            .map_err(|error| WireError::Port {
                service: "doorbell",
                what: format!("{process}: {error:?}"),
            })?;
        Ok(Doorbell { listener })
    }

    fn bell(
        &self,
        process: Process,
    ) -> Result<iceoryx2::service::port_factory::event::PortFactory<Ipc>, WireError> {
        let failed = |what: String| WireError::Port {
            service: "doorbell",
            what,
        };
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
        let failed = |what: String| WireError::Port {
            service: service.name,
            what,
        };
        let name = ServiceName::new(service.name).map_err(|error| failed(format!("{error:?}")))?;
        let ours = format!("{:016x}", M::FINGERPRINT);
        let verifier = attributes(&ours).map_err(&failed)?;
        let (depth, history) = service.delivery.queue();
        self.node
            .service_builder(&name)
            .publish_subscribe::<M>()
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(depth)
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

impl<M: Message> Publisher<M> {
    /// Numbers the message, publishes it and wakes its readers. Never blocks,
    /// never waits for a reader. Returns whether it went out: only exhausted
    /// shared memory can prevent that, and the next message tries again.
    pub fn send(&mut self, message: &mut M) -> bool {
        let sent = self.send_quietly(message);
        for bell in &self.bells {
            // A full bell is already ringing; a dead one is swept by others.
            let _ = bell.notify();
        }
        sent
    }

    /// The same, but nobody is woken: who is awake finds the newest.
    pub fn send_quietly(&mut self, message: &mut M) -> bool {
        self.sequence += 1;
        let (sequence, producer) = (self.sequence, self.producer);
        let header = message.header_mut();
        header.sequence = sequence;
        header.producer = producer;
        let room = self.room.take().or_else(|| self.port.loan_uninit().ok());
        room.is_some_and(|room| room.write_payload(*message).send().is_ok())
    }

    /// Connects to readers that came since the last message, gives them the
    /// history, and borrows room for the next message. To be called between
    /// ticks, so that no tick pays for it.
    pub fn tend(&mut self) {
        // A failure here shows again at the next send.
        let _ = self.port.update_connections();
        if self.room.is_none() {
            self.room = self.port.loan_uninit().ok();
        }
    }
}

impl<M: Message> Publisher<M> {
    /// Publishes a message that is written where it will be read, over zeros:
    /// megabytes do not belong on a stack. Returns whether it went out.
    fn send_written(&mut self, write: impl FnOnce(&mut M)) -> bool
    where
        M: Numbers,
    {
        self.sequence += 1;
        let (sequence, producer) = (self.sequence, self.producer);
        let room = self.room.take().or_else(|| self.port.loan_uninit().ok());
        let Some(mut room) = room else {
            return false;
        };
        // SAFETY: the pointer is to the room's payload, which is ours alone until
        // it is sent; `Numbers` is only said of messages made of numbers and arrays
        // of them, so all zeros are one, and the rest is written over it.
        #[allow(unsafe_code)]
        let room = unsafe {
            let payload = room.payload_mut().as_mut_ptr();
            payload.write_bytes(0, 1);
            let message = &mut *payload;
            write(message);
            let header = message.header_mut();
            (header.sequence, header.producer) = (sequence, producer);
            room.assume_init()
        };
        let sent = room.send().is_ok();
        for bell in &self.bells {
            let _ = bell.notify();
        }
        sent
    }
}

/// Messages of megabytes. They are made of numbers and arrays of them alone.
trait Numbers {}
impl Numbers for Weights {}
impl Numbers for Frame {}

impl Publisher<Weights> {
    /// Publishes a policy file. Returns whether it went out; it does not when it is
    /// over [`WEIGHTS_BYTES_MAX`] or shared memory is exhausted.
    pub fn offer(&mut self, version: u64, sha256: [u8; 32], file: &[u8]) -> bool {
        file.len() <= WEIGHTS_BYTES_MAX
            && self.send_written(|weights| {
                weights.version = version;
                weights.byte_count = file.len() as u64;
                weights.sha256 = sha256;
                weights.bytes[..file.len()].copy_from_slice(file);
            })
    }
}

impl Publisher<Frame> {
    /// Publishes a picture of that width, pixels row by row from the top, in three bytes a
    /// pixel. Returns whether it went out; it does not when it is over
    /// [`FRAME_BYTES_MAX`] or shared memory is exhausted.
    pub fn show(&mut self, header: Header, camera: Camera, width: u32, rgb: &[u8]) -> bool {
        let row_bytes = width as usize * 3;
        row_bytes > 0
            && rgb.len() <= FRAME_BYTES_MAX
            && rgb.len().is_multiple_of(row_bytes)
            && self.send_written(|frame| {
                (frame.header, frame.camera) = (header, camera);
                (frame.width, frame.height) = (width, (rgb.len() / row_bytes) as u32);
                frame.format = PixelFormat::Rgb8.code();
                frame.pixels[..rgb.len()].copy_from_slice(rgb);
            })
    }
}

impl<M: Message> Subscriber<M> {
    /// The next message of the queue, not yet admitted; `None` when there is none.
    pub fn receive(&mut self) -> Option<M> {
        let sample = self.port.receive().ok()??;
        self.count(sample.payload().header());
        Some(*sample.payload())
    }

    /// Notes what was overwritten between the last message and this one.
    fn count(&mut self, header: &Header) {
        let (producer, sequence) = (header.producer, header.sequence);
        if producer == self.producer {
            self.lost += sequence.saturating_sub(self.sequence + 1);
        }
        (self.producer, self.sequence) = (producer, sequence);
    }

    /// Looks at the next message of the queue where it lies, not yet admitted;
    /// for messages too large for a stack. `None` when there is none.
    pub fn visit<R>(&mut self, look: impl FnOnce(&M) -> R) -> Option<R> {
        let sample = self.port.receive().ok()??;
        Some(look(sample.payload()))
    }

    /// The newest message since the last look, not yet admitted; `None` when
    /// nothing new came. Two publishers exist while a dead one is replaced, so
    /// this reads until there is nothing left, unless the last [`tend`](Self::tend)
    /// found one publisher and room for one message: a second look costs as much as
    /// the first, and who came since then is heard at the next. Of several messages
    /// one that makes no sense never hides one that does.
    pub fn newest(&mut self) -> Option<M> {
        let mut newest = None;
        self.newest_into(&mut newest);
        newest
    }

    /// The same over what is kept, which stays when nothing new came; returns
    /// whether something did. Copied once, to where it is used: a step has 4.9 kB.
    pub fn newest_into(&mut self, kept: &mut Option<M>) -> bool {
        let mut came = false;
        // Bounded: a hostile publisher cannot hold a tick.
        for _ in 0..PUBLISHERS_MAX {
            let Ok(Some(sample)) = self.port.receive() else {
                break;
            };
            let message = sample.payload();
            self.count(message.header());
            if !came || message.check().is_ok() {
                *kept = Some(*message);
                came = true;
            }
            if self.holds_one {
                break;
            }
        }
        came
    }

    /// Messages that were overwritten before they were read.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Connects to publishers that came since the last look, and counts them. To be
    /// called between ticks, so that no tick pays for it.
    pub fn tend(&mut self) {
        // A failure here shows again at the next receive.
        let _ = self.port.update_connections();
        let publishers = self.topic.dynamic_config().number_of_publishers();
        self.holds_one = self.depth * publishers <= 1;
    }
}

impl Doorbell {
    /// Sleeps until the bell rings or `timeout` has passed; returns at once when
    /// it rang since the last look. May return early.
    pub fn wait(&self, timeout: Duration) {
        let timeout = Timespec {
            tv_sec: timeout.as_secs() as i64,
            tv_nsec: i64::from(timeout.subsec_nanos()),
        };
        // poll(2) has the high-resolution timer that the listener's own timed
        // wait lacks: that one sets a socket option counted in jiffies.
        // SAFETY: the descriptor is open for as long as the listener lives.
        #[allow(unsafe_code)]
        let descriptor = unsafe {
            std::os::fd::BorrowedFd::borrow_raw(self.listener.file_descriptor().native_handle())
        };
        let _ = poll(
            &mut [PollFd::from_borrowed_fd(descriptor, PollFlags::IN)],
            Some(&timeout),
        );
        let _ = self.listener.try_wait(|_| {});
    }
}
