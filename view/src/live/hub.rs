//! What the reader of a run shares with the page's connections: the newest state wins.
//!
//! The reader never waits for a connection. Each connection remembers what it has sent;
//! when its browser has room again, it gets the newest scene and the samples that it has
//! not had. A slow browser gets fewer scenes, and a stalled one costs nothing.

use std::collections::VecDeque;
use std::fmt::Write as _;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use shm_config::message::Step;
use tokio::sync::watch;

use super::events::Event;

/// Samples that are kept for a page that comes later: a minute at 20 Hz, 0.4 MB.
pub const SAMPLES_MAX: usize = 1_200;
/// Scenes that are kept, so that a page that comes later can go back too: a minute, 8 MB.
pub const SCENES_MAX: usize = SAMPLES_MAX;
/// Scenes of one answer.
const FRAMES_MAX: usize = 64;
/// Events that are kept, of the whole run.
pub const EVENTS_MAX: usize = 1_000;

/// The shared state.
#[derive(Debug)]
pub struct Hub {
    state: Mutex<State>,
    changed: watch::Sender<u64>,
    clients: AtomicUsize,
}

#[derive(Debug, Default)]
struct State {
    /// Counts what was published.
    version: u64,
    /// Changes with every run that is read.
    generation: u64,
    hello: Arc<str>,
    status: Numbered,
    scene: Numbered,
    /// Ticks and scenes.
    scenes: VecDeque<(u64, Arc<str>)>,
    samples: VecDeque<Numbered>,
    events: VecDeque<Numbered>,
    step: Option<Box<Step>>,
}

/// A text with the version in which it came.
#[derive(Debug, Clone, Default)]
struct Numbered {
    version: u64,
    text: Arc<str>,
}

/// What a connection has sent.
#[derive(Debug, Clone, Copy, Default)]
pub struct Cursor {
    generation: u64,
    version: u64,
}

impl Default for Hub {
    fn default() -> Self {
        Self {
            state: Mutex::default(),
            changed: watch::Sender::new(0),
            clients: AtomicUsize::new(0),
        }
    }
}

/// A moment of a run, to be published.
#[derive(Debug, Default)]
pub struct Moment {
    /// The scene with its tick, JSON; `None` without a step.
    pub scene: Option<(u64, String)>,
    /// The sample, JSON; `None` without a step.
    pub sample: Option<String>,
    /// What happened.
    pub events: Vec<Event>,
    /// How the processes do, JSON; `None` when it is not due.
    pub status: Option<String>,
    /// The newest step.
    pub step: Option<Box<Step>>,
}

impl Hub {
    fn state(&self) -> MutexGuard<'_, State> {
        // The state is whole between two statements that change it.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins another run, or the time without one; all that was kept is forgotten.
    pub fn begin(&self, hello: &str) {
        let mut state = self.state();
        let version = state.version + 1;
        *state = State {
            version,
            generation: state.generation + 1,
            hello: hello.into(),
            ..State::default()
        };
        drop(state);
        self.changed.send_replace(version);
    }

    /// Publishes a moment.
    pub fn publish(&self, moment: Moment) {
        let mut state = self.state();
        state.version += 1;
        let version = state.version;
        let numbered = |text: String| Numbered {
            version,
            text: text.into(),
        };
        if let Some((tick, scene)) = moment.scene {
            let scene = numbered(scene);
            state.scenes.push_back((tick, scene.text.clone()));
            state.scene = scene;
        }
        if let Some(status) = moment.status {
            state.status = numbered(status);
        }
        if let Some(sample) = moment.sample {
            state.samples.push_back(numbered(sample));
        }
        for event in &moment.events {
            let text = serde_json::to_string(event).unwrap_or_default();
            state.events.push_back(numbered(text));
        }
        if moment.step.is_some() {
            state.step = moment.step;
        }
        while state.samples.len() > SAMPLES_MAX {
            state.samples.pop_front();
        }
        while state.scenes.len() > SCENES_MAX {
            state.scenes.pop_front();
        }
        while state.events.len() > EVENTS_MAX {
            state.events.pop_front();
        }
        drop(state);
        self.changed.send_replace(version);
    }

    /// The newest step; `None` before the first.
    pub fn step(&self) -> Option<Box<Step>> {
        self.state().step.clone()
    }

    /// The scenes that are kept from a tick on, and the last one before it, JSON.
    pub fn frames(&self, from: u64, count: usize) -> String {
        let state = self.state();
        let later = state.scenes.partition_point(|(tick, _)| *tick <= from);
        let scenes = state.scenes.iter().skip(later.saturating_sub(1));
        let texts = scenes.take(count.min(FRAMES_MAX)).map(|(_, text)| &**text);
        format!("[{}]", texts.collect::<Vec<_>>().join(","))
    }

    /// The description of the run, JSON.
    pub fn hello(&self) -> Arc<str> {
        self.state().hello.clone()
    }

    /// Wakes when something was published.
    pub fn listen(&self) -> watch::Receiver<u64> {
        self.changed.subscribe()
    }

    /// Server-sent events with all that the connection has not had; empty when there is
    /// nothing new.
    pub fn since(&self, cursor: &mut Cursor) -> String {
        let state = self.state();
        let mut text = String::new();
        if cursor.generation != state.generation {
            *cursor = Cursor {
                generation: state.generation,
                version: 0,
            };
            write_event(&mut text, "hello", &state.hello);
        }
        let is_new = |numbered: &&Numbered| numbered.version > cursor.version;
        if is_new(&&state.status) {
            write_event(&mut text, "status", &state.status.text);
        }
        let listed = |all: &VecDeque<Numbered>| -> Option<String> {
            // They are in order: the new ones are at the end.
            let count = all.iter().rev().take_while(is_new).count();
            let new = all.iter().skip(all.len() - count);
            let texts: Vec<&str> = new.map(|numbered| &*numbered.text).collect();
            (count > 0).then(|| format!("[{}]", texts.join(",")))
        };
        let samples = listed(&state.samples);
        let events = listed(&state.events);
        let scene = Some(&state.scene).filter(is_new).map(|scene| &*scene.text);
        if samples.is_some() || events.is_some() || scene.is_some() {
            let data = format!(
                "{{\"samples\":{},\"events\":{},\"scene\":{}}}",
                samples.as_deref().unwrap_or("[]"),
                events.as_deref().unwrap_or("[]"),
                scene.unwrap_or("null")
            );
            write_event(&mut text, "moment", &data);
        }
        cursor.version = state.version;
        text
    }

    /// Counts a connection in; `None` when there are `most` already.
    pub fn enter(self: &Arc<Self>, most: usize) -> Option<Client> {
        let client = Client(self.clone());
        match self.clients.fetch_add(1, Ordering::SeqCst) < most {
            true => Some(client),
            // Dropping it counts it out again.
            false => None,
        }
    }

    /// Pages that are open.
    pub fn clients(&self) -> usize {
        self.clients.load(Ordering::SeqCst)
    }
}

/// A connection that is counted as long as it lives.
#[derive(Debug)]
pub struct Client(Arc<Hub>);

impl Drop for Client {
    fn drop(&mut self) {
        self.0.clients.fetch_sub(1, Ordering::SeqCst);
    }
}

/// Neither name nor JSON has a line end.
fn write_event(text: &mut String, name: &str, data: &str) {
    // Writing to a string cannot fail.
    let _ = write!(text, "event: {name}\ndata: {data}\n\n");
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moment(k: u64) -> Moment {
        Moment {
            scene: Some((k, format!("{{\"tick\":{k}}}"))),
            sample: Some(k.to_string()),
            ..Moment::default()
        }
    }

    #[test]
    fn a_slow_page_gets_the_newest_scene_and_every_sample() {
        let hub = Arc::new(Hub::default());
        hub.begin("{}");
        let (mut quick, mut slow) = (Cursor::default(), Cursor::default());
        assert!(
            hub.since(&mut quick)
                .starts_with("event: hello\ndata: {}\n\n")
        );
        for k in 1..=5 {
            hub.publish(moment(k));
            let text = hub.since(&mut quick);
            assert!(text.contains(&format!("\"samples\":[{k}],")), "{text}");
        }
        assert_eq!(hub.since(&mut quick), "");
        let text = hub.since(&mut slow);
        assert!(text.contains("\"samples\":[1,2,3,4,5],"), "{text}");
        assert_eq!(text.matches("\"scene\":{\"tick\":5}").count(), 1, "{text}");
        // Paused, a page asks for what it has not had.
        assert_eq!(hub.frames(3, 2), "[{\"tick\":3},{\"tick\":4}]");
        assert_eq!(hub.frames(9, 2), "[{\"tick\":5}]");
        assert_eq!(hub.frames(0, usize::MAX).matches("tick").count(), 5);
    }

    #[test]
    fn what_is_kept_is_bounded_and_another_run_begins_empty() {
        let hub = Hub::default();
        hub.begin("1");
        (0..SAMPLES_MAX as u64 + 50).for_each(|k| hub.publish(moment(k)));
        let mut cursor = Cursor::default();
        let text = hub.since(&mut cursor);
        assert!(text.contains("\"samples\":[50,51,"), "{}", &text[..80]);
        hub.begin("2");
        let text = hub.since(&mut cursor);
        assert_eq!(text, "event: hello\ndata: 2\n\n");
    }

    #[test]
    fn connections_are_counted_and_limited() {
        let hub = Arc::new(Hub::default());
        let first = hub.enter(2).expect("room");
        let second = hub.enter(2).expect("room");
        assert!(hub.enter(2).is_none());
        assert_eq!(hub.clients(), 2);
        drop(first);
        assert!(hub.enter(2).is_some());
        drop(second);
        assert_eq!(hub.clients(), 0);
    }
}
