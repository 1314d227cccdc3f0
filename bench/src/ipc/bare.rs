//! Bare iceoryx2, as its own benchmark sets it up: the one file beside the wire that
//! names the library, since it is what the wire is compared with.
#![allow(clippy::disallowed_types)]

use std::mem::MaybeUninit;
use std::time::Duration;

use anyhow::anyhow;
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::sample_mut_uninit::SampleMutUninit;

use shm_config::run::{RunName, RunPaths};

use super::arguments::Wake;
use super::link::Link;
use super::port::End;

type Ipc = ipc::Service;

/// How long one wait for an event lasts at most.
const NAP: Duration = Duration::from_millis(500);

/// One end over the library alone.
pub struct Bare<M: ZeroCopySend + Copy + std::fmt::Debug + 'static> {
    publisher: Publisher<Ipc, M, ()>,
    subscriber: Subscriber<Ipc, M, ()>,
    room: Option<SampleMutUninit<Ipc, MaybeUninit<M>, ()>>,
    events: Option<(Notifier<Ipc>, Listener<Ipc>)>,
    message: M,
    _node: Node<Ipc>,
}

impl<M: ZeroCopySend + Copy + std::fmt::Debug + 'static> Bare<M> {
    /// Opens both directions: a queue of one that overflows, no history, one
    /// publisher and one subscriber; names begin with `prefix`. Its files are among
    /// those of the run, so that they go with it.
    ///
    /// # Errors
    /// When the library refuses.
    pub fn open(
        run: &RunName,
        prefix: &str,
        (end, wake): (End, Wake),
        message: M,
    ) -> anyhow::Result<Self> {
        let node = NodeBuilder::new()
            .config(&config(run)?)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Ipc>()
            .map_err(|error| anyhow!("bare iceoryx2: {error:?}"))?;
        let [ours, theirs] = end.places();
        let topic = |place: usize| {
            let name = name(prefix, ["there", "back"][place])?;
            node.service_builder(&name)
                .publish_subscribe::<M>()
                .max_publishers(1)
                .max_subscribers(1)
                .history_size(0)
                .subscriber_max_buffer_size(1)
                .enable_safe_overflow(true)
                .open_or_create()
                .map_err(|error| anyhow!("bare iceoryx2: {error:?}"))
        };
        let event = |place: usize| {
            let name = name(prefix, ["bell-there", "bell-back"][place])?;
            let service = node.service_builder(&name).event().open_or_create();
            service.map_err(|error| anyhow!("bare iceoryx2: {error:?}"))
        };
        let failed = |error: &dyn std::fmt::Debug| anyhow!("bare iceoryx2: {error:?}");
        let publisher = topic(ours)?.publisher_builder().create();
        let subscriber = topic(theirs)?.subscriber_builder().create();
        let events = match wake {
            Wake::Spin | Wake::Grid => None,
            Wake::Bell => {
                let notifier = event(ours)?.notifier_builder().create();
                let listener = event(theirs)?.listener_builder().create();
                Some((
                    notifier.map_err(|error| failed(&error))?,
                    listener.map_err(|error| failed(&error))?,
                ))
            }
        };
        let publisher = publisher.map_err(|error| failed(&error))?;
        Ok(Self {
            room: publisher.loan_uninit().ok(),
            publisher,
            subscriber: subscriber.map_err(|error| failed(&error))?,
            events,
            message,
            _node: node,
        })
    }
}

fn config(run: &RunName) -> anyhow::Result<Config> {
    let paths = RunPaths::new(run.clone());
    let root = paths.dir();
    let mut config = Config::default();
    let root = iceoryx2::prelude::Path::new(root.to_string_lossy().as_bytes())
        .map_err(|error| anyhow!("bare iceoryx2: {error:?}"))?;
    config.global.set_root_path(&root);
    config.global.prefix = FileName::new(paths.prefix().as_bytes())
        .map_err(|error| anyhow!("bare iceoryx2: {error:?}"))?;
    Ok(config)
}

fn name(prefix: &str, place: &str) -> anyhow::Result<ServiceName> {
    ServiceName::new(&format!("{prefix}/{place}")).map_err(|error| anyhow!("{error:?}"))
}

impl<M: ZeroCopySend + Copy + std::fmt::Debug + 'static> Link for Bare<M> {
    fn send(&mut self) -> bool {
        let room = self
            .room
            .take()
            .or_else(|| self.publisher.loan_uninit().ok());
        let sent = room.is_some_and(|room| room.write_payload(self.message).send().is_ok());
        if let Some((notifier, _)) = &self.events {
            let _ = notifier.notify();
        }
        sent
    }

    fn receive(&mut self) -> anyhow::Result<bool> {
        match self.subscriber.receive() {
            Ok(Some(sample)) => {
                self.message = *sample.payload();
                Ok(true)
            }
            Ok(None) => Ok(false),
            Err(error) => Err(anyhow!("bare iceoryx2: {error:?}")),
        }
    }

    fn update_connections(&mut self) {
        self.room = self.publisher.loan_uninit().ok();
    }

    fn wait(&self) {
        if let Some((_, listener)) = &self.events {
            let _ = listener.timed_wait(|_| {}, NAP);
        }
    }
}
