//! The action log: the tick's thread records the actions that moved the world and the
//! instants that were observed. From these and the seed, each of them can be
//! reproduced.

use std::collections::VecDeque;

use rtrb::{Consumer, Producer, RingBuffer};
use shm_config::message::Header;
use vehicle::Action;

/// Capacity of the queue to the render thread: in real time 30 s at the highest rate,
/// 1,000 instants and 50 moves a second; 2.6 MB.
const QUEUE: usize = 1 << 16;
/// Episodes that are kept: the running one, and the one before, whose last ticks may
/// still be requested.
const EPISODES: usize = 2;
/// Instants and moves that are kept of an episode, each: six minutes at 1,000 Hz,
/// twelve megabytes. Later ones are dropped.
const REEL_ENTRIES: usize = 360_000;

#[derive(Clone, Copy, Debug)]
enum Entry {
    Began { episode: u32, seed: u64 },
    Moved(Move),
    Saw(Seen),
}

/// Sub-steps with one action.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move {
    /// The action that was applied.
    pub action: Action,
    /// The number of its sub-steps.
    pub substeps: u64,
}

/// An instant that was observed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// The run's tick.
    pub tick: u64,
    /// When it was taken, on the run's clock, ns.
    pub taken_ns: u64,
    /// Share of the next sub-step that had passed, [0, 1).
    pub passed: f64,
}

/// The writing end of the log, for the tick's thread. It never waits and never
/// allocates. When the reading end is too slow, the rest of the present episode is
/// dropped.
pub struct LogWriter {
    queue: Producer<Entry>,
    is_lost: bool,
}

/// An empty log: its writing and its reading end.
pub fn action_log() -> (LogWriter, ActionLog) {
    with_capacity(QUEUE)
}

fn with_capacity(entries: usize) -> (LogWriter, ActionLog) {
    let (producer, consumer) = RingBuffer::new(entries);
    let writer = LogWriter {
        queue: producer,
        is_lost: true,
    };
    let log = ActionLog {
        queue: consumer,
        episodes: VecDeque::with_capacity(EPISODES),
    };
    (writer, log)
}

impl LogWriter {
    /// Records the beginning of an episode.
    pub fn begin(&mut self, episode: u32, seed: u64) {
        self.is_lost = false;
        self.push(Entry::Began { episode, seed });
    }

    /// Records a move of the world.
    pub fn moved(&mut self, step: Move) {
        self.push(Entry::Moved(step));
    }

    /// Records an observed instant. Call it before the observation is published, so
    /// that no request can precede its entry.
    pub fn saw(&mut self, seen: Seen) {
        self.push(Entry::Saw(seen));
    }

    fn push(&mut self, entry: Entry) {
        // The moves after a gap would describe another world.
        if !self.is_lost {
            self.is_lost = self.queue.push(entry).is_err();
        }
    }
}

/// The reading end of the log, for the render thread.
pub struct ActionLog {
    queue: Consumer<Entry>,
    episodes: VecDeque<EpisodeLog>,
}

/// The log of one episode.
#[derive(Debug, Default)]
pub struct EpisodeLog {
    /// Its number in the run.
    pub episode: u32,
    /// Its seed.
    pub seed: u64,
    moves: Vec<Move>,
    /// The observed instants, each with the number of moves before it.
    seen: Vec<(Seen, usize)>,
}

impl ActionLog {
    /// Takes the entries written since the last call. The number is limited, so that a
    /// fast writer does not keep the reader here.
    pub fn drain(&mut self) {
        for _ in 0..QUEUE {
            let Ok(entry) = self.queue.pop() else {
                return;
            };
            match entry {
                Entry::Began { episode, seed } => self.begin(episode, seed),
                Entry::Moved(_) | Entry::Saw(_) => {
                    if let Some(episode_log) = self.episodes.back_mut() {
                        episode_log.add(entry);
                    }
                }
            }
        }
    }

    /// The log of an episode; `None` when it was dropped or never known.
    pub fn episode(&self, episode: u32) -> Option<&EpisodeLog> {
        self.episodes
            .iter()
            .rev()
            .find(|episode_log| episode_log.episode == episode)
    }

    fn begin(&mut self, episode: u32, seed: u64) {
        // The memory of the oldest episode is used again.
        let oldest = match self.episodes.len() < EPISODES {
            true => None,
            false => self.episodes.pop_front(),
        };
        let mut episode_log = oldest.unwrap_or_default();
        (episode_log.episode, episode_log.seed) = (episode, seed);
        episode_log.moves.clear();
        episode_log.seen.clear();
        self.episodes.push_back(episode_log);
    }
}

impl EpisodeLog {
    fn add(&mut self, entry: Entry) {
        if self.moves.len() >= REEL_ENTRIES || self.seen.len() >= REEL_ENTRIES {
            return;
        }
        match entry {
            Entry::Moved(step) => self.moves.push(step),
            Entry::Saw(seen) => self.seen.push((seen, self.moves.len())),
            Entry::Began { .. } => {}
        }
    }

    /// The instant of an observation, and the moves from the beginning of the episode
    /// to it; `None` when its tick is not in the log. A tick may have several instants.
    /// The result is the last one not later than requested or, if all are later, the
    /// first.
    pub fn at(&self, asked: &Header) -> Option<(Seen, &[Move])> {
        let (tick, taken_ns) = (asked.tick, asked.taken_ns);
        let first = self.seen.partition_point(|(seen, _)| seen.tick < tick);
        let is_due = |(seen, _): &(Seen, usize)| seen.tick == tick && seen.taken_ns <= taken_ns;
        let due = self.seen[first..].partition_point(is_due);
        let (seen, moves) = *self.seen.get(first + due.saturating_sub(1))?;
        (seen.tick == tick).then(|| (seen, &self.moves[..moves]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(pedal: f64) -> Move {
        Move {
            action: Action { steer: 0.0, pedal },
            substeps: 5,
        }
    }

    fn seen(tick: u64) -> Seen {
        Seen {
            tick,
            taken_ns: tick * 100,
            passed: 0.0,
        }
    }

    fn asked(tick: u64) -> Header {
        Header {
            tick,
            taken_ns: tick * 100,
            ..Header::default()
        }
    }

    /// Writes an episode of these ticks, with a move before each but the first.
    fn tell(writer: &mut LogWriter, episode: u32, ticks: std::ops::Range<u64>) {
        writer.begin(episode, 100 + u64::from(episode));
        for tick in ticks.clone() {
            if tick > ticks.start {
                writer.moved(step(tick as f64));
            }
            writer.saw(seen(tick));
        }
    }

    #[test]
    fn instants_are_found_with_the_moves_before_them() {
        let (mut writer, mut log) = action_log();
        tell(&mut writer, 0, 0..4);
        log.drain();
        let episode_log = log.episode(0).expect("the episode");
        assert_eq!(episode_log.seed, 100);
        assert_eq!(episode_log.at(&asked(0)), Some((seen(0), &[][..])));
        assert_eq!(
            episode_log.at(&asked(2)),
            Some((seen(2), &[step(1.0), step(2.0)][..]))
        );
        assert_eq!(episode_log.at(&asked(4)), None, "not yet");
        writer.moved(step(4.0));
        writer.saw(seen(6));
        log.drain();
        let episode_log = log.episode(0).expect("the episode");
        assert_eq!(episode_log.at(&asked(4)), None, "a tick that was skipped");
        assert_eq!(
            episode_log.at(&asked(6)).map(|(_, moves)| moves.len()),
            Some(4)
        );
    }

    #[test]
    fn among_a_ticks_instants_the_observed_one_is_found() {
        let (mut writer, mut log) = action_log();
        writer.begin(0, 7);
        for (tick, taken_ns) in [(1, 100), (2, 200), (2, 220), (2, 240), (3, 300)] {
            writer.moved(step(0.0));
            writer.saw(Seen {
                tick,
                taken_ns,
                passed: 0.0,
            });
        }
        log.drain();
        let episode_log = log.episode(0).expect("the episode");
        for (taken_ns, wanted_ns) in [(200, 200), (220, 220), (239, 220), (900, 240), (0, 200)] {
            let asked = Header {
                tick: 2,
                taken_ns,
                ..Header::default()
            };
            let (seen, moves) = episode_log.at(&asked).expect("the tick");
            assert_eq!(seen.taken_ns, wanted_ns, "asked for {taken_ns}");
            let instants = (wanted_ns as usize - 200) / 20;
            assert_eq!(moves.len(), 2 + instants, "asked for {taken_ns}");
        }
    }

    #[test]
    fn the_previous_episode_is_kept_and_older_ones_are_dropped() {
        let (mut writer, mut log) = action_log();
        for episode in 0..3 {
            let first = u64::from(episode) * 10;
            tell(&mut writer, episode, first..first + 10);
        }
        log.drain();
        assert!(log.episode(0).is_none());
        let before = log.episode(1).expect("the one before");
        assert_eq!(before.at(&asked(19)).map(|(_, moves)| moves.len()), Some(9));
        let now = log.episode(2).expect("the one that runs");
        assert_eq!((now.seed, now.at(&asked(19))), (102, None));
        assert_eq!(now.at(&asked(29)).map(|(_, moves)| moves.len()), Some(9));
    }

    #[test]
    fn entries_beyond_the_capacity_are_dropped_until_the_next_episode() {
        let (mut writer, mut log) = with_capacity(8);
        // The queue holds: begin, 0, move, 1, move, 2, move, 3; the rest is dropped.
        tell(&mut writer, 0, 0..50);
        log.drain();
        writer.moved(step(50.0));
        writer.saw(seen(50));
        log.drain();
        let episode_log = log.episode(0).expect("the episode");
        assert!(
            episode_log.at(&asked(3)).is_some(),
            "what came before is whole"
        );
        assert!(episode_log.at(&asked(4)).is_none() && episode_log.at(&asked(50)).is_none());
        tell(&mut writer, 1, 51..53);
        log.drain();
        let episode_log = log.episode(1).expect("the next episode");
        assert_eq!(
            episode_log.at(&asked(52)).map(|(_, moves)| moves),
            Some(&[step(52.0)][..])
        );
    }
}
