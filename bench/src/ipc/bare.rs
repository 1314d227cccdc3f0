//! Bare iceoryx2, set up as in its own benchmark. Apart from the wire crate this is the
//! only file that uses the library, since the wire is compared with it.
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

/// Time limit of one wait for an event.
const WAIT_MAX: Duration = Duration::from_millis(500);

/// One end of a connection through bare iceoryx2.
pub struct Bare<M: ZeroCopySend + Copy + std::fmt::Debug + 'static> {
    publisher: Publisher<Ipc, M, ()>,
    subscriber: Subscriber<Ipc, M, ()>,
    loan: Option<SampleMutUninit<Ipc, MaybeUninit<M>, ()>>,
    events: Option<(Notifier<Ipc>, Listener<Ipc>)>,
    message: M,
    _node: Node<Ipc>,
}

impl<M: ZeroCopySend + Copy + std::fmt::Debug + 'static> Bare<M> {
    /// Opens both directions: an overflowing queue of one, no history, one publisher and one
    /// subscriber; service names begin with `prefix`. Its files are among the run's, so that
    /// they are removed with it.
    ///
    /// # Errors
    /// If the library refuses.
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
            loan: publisher.loan_uninit().ok(),
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
        let loan = self
            .loan
            .take()
            .or_else(|| self.publisher.loan_uninit().ok());
        let sent = loan.is_some_and(|loan| loan.write_payload(self.message).send().is_ok());
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
        self.loan = self.publisher.loan_uninit().ok();
    }

    fn wait(&self) {
        if let Some((_, listener)) = &self.events {
            let _ = listener.timed_wait(|_| {}, WAIT_MAX);
        }
    }
}
