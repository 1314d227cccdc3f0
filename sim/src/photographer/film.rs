//! What the tick's thread tells the photographer: which actions moved the world,
//! and which instants were observed. From these and the seed any of them can be
//! made again.

use std::collections::VecDeque;

use rtrb::{Consumer, Producer, RingBuffer};
use shm_config::message::Header;
use vehicle::Action;

/// Entries that the photographer may be behind: in real time 30 s at the highest
/// rate, 1,000 instants and 50 moves a second; 2.6 MB.
const QUEUE: usize = 1 << 16;
/// Episodes that are kept: the one that runs, and the one before, of whose last
/// ticks somebody may just be asking.
const REELS: usize = 2;
/// Instants and moves that are kept of an episode, each: six minutes at 1,000 Hz,
/// twelve megabytes. What comes later is lost.
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
    /// What was obeyed.
    pub action: Action,
    /// For how many sub-steps.
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

/// The end of the film that the tick's thread writes on. It never waits and never
/// allocates; where the other end does not follow, what is left of an episode is
/// lost, and only that.
pub struct Recorder {
    queue: Producer<Entry>,
    is_lost: bool,
}

/// A film that is empty: both its ends.
pub fn film() -> (Recorder, Film) {
    film_of(QUEUE)
}

fn film_of(entries: usize) -> (Recorder, Film) {
    let (producer, consumer) = RingBuffer::new(entries);
    let recorder = Recorder {
        queue: producer,
        is_lost: true,
    };
    let film = Film {
        queue: consumer,
        reels: VecDeque::with_capacity(REELS),
    };
    (recorder, film)
}

impl Recorder {
    /// An episode begins.
    pub fn begin(&mut self, episode: u32, seed: u64) {
        self.is_lost = false;
        self.push(Entry::Began { episode, seed });
    }

    /// The world moves.
    pub fn moved(&mut self, step: Move) {
        self.push(Entry::Moved(step));
    }

    /// The world is observed. To be told before the observation is published, so
    /// that nobody can ask for what is not on the film yet.
    pub fn saw(&mut self, seen: Seen) {
        self.push(Entry::Saw(seen));
    }

    fn push(&mut self, entry: Entry) {
        // A gap in the moves would make another world of the rest.
        if !self.is_lost {
            self.is_lost = self.queue.push(entry).is_err();
        }
    }
}

/// The end that the photographer reads.
pub struct Film {
    queue: Consumer<Entry>,
    reels: VecDeque<Reel>,
}

/// What is known of one episode.
#[derive(Debug, Default)]
pub struct Reel {
    /// The episode of the run.
    pub episode: u32,
    /// Its seed.
    pub seed: u64,
    moves: Vec<Move>,
    /// With the number of moves before each.
    seen: Vec<(Seen, usize)>,
}

impl Film {
    /// Takes over what was told since the last look; bounded, so that a world that
    /// tells faster than this does not hold it for ever.
    pub fn develop(&mut self) {
        for _ in 0..QUEUE {
            let Ok(entry) = self.queue.pop() else {
                return;
            };
            match entry {
                Entry::Began { episode, seed } => self.begin(episode, seed),
                Entry::Moved(_) | Entry::Saw(_) => {
                    if let Some(reel) = self.reels.back_mut() {
                        reel.add(entry);
                    }
                }
            }
        }
    }

    /// The reel of an episode; `None` when it is gone, or not known.
    pub fn reel(&self, episode: u32) -> Option<&Reel> {
        self.reels.iter().rev().find(|reel| reel.episode == episode)
    }

    fn begin(&mut self, episode: u32, seed: u64) {
        // The room of the oldest is used again.
        let oldest = match self.reels.len() < REELS {
            true => None,
            false => self.reels.pop_front(),
        };
        let mut reel = oldest.unwrap_or_default();
        (reel.episode, reel.seed) = (episode, seed);
        reel.moves.clear();
        reel.seen.clear();
        self.reels.push_back(reel);
    }
}

impl Reel {
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

    /// The instant of an observation, and the moves that led to it from the episode's
    /// beginning; `None` when its tick is not on the reel. A tick may have several
    /// instants: it is the last one that was not taken later than asked for, or, when
    /// all were, the first.
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

    /// An episode of so many ticks, a move before each but the first.
    fn tell(recorder: &mut Recorder, episode: u32, ticks: std::ops::Range<u64>) {
        recorder.begin(episode, 100 + u64::from(episode));
        for tick in ticks.clone() {
            if tick > ticks.start {
                recorder.moved(step(tick as f64));
            }
            recorder.saw(seen(tick));
        }
    }

    #[test]
    fn instants_are_found_with_the_moves_before_them() {
        let (mut recorder, mut film) = film();
        tell(&mut recorder, 0, 0..4);
        film.develop();
        let reel = film.reel(0).expect("the episode");
        assert_eq!(reel.seed, 100);
        assert_eq!(reel.at(&asked(0)), Some((seen(0), &[][..])));
        assert_eq!(
            reel.at(&asked(2)),
            Some((seen(2), &[step(1.0), step(2.0)][..]))
        );
        assert_eq!(reel.at(&asked(4)), None, "not yet");
        recorder.moved(step(4.0));
        recorder.saw(seen(6));
        film.develop();
        let reel = film.reel(0).expect("the episode");
        assert_eq!(reel.at(&asked(4)), None, "a tick that was skipped");
        assert_eq!(reel.at(&asked(6)).map(|(_, moves)| moves.len()), Some(4));
    }

    #[test]
    fn of_a_ticks_instants_the_one_that_was_observed_is_found() {
        let (mut recorder, mut film) = film();
        recorder.begin(0, 7);
        for (tick, taken_ns) in [(1, 100), (2, 200), (2, 220), (2, 240), (3, 300)] {
            recorder.moved(step(0.0));
            recorder.saw(Seen {
                tick,
                taken_ns,
                passed: 0.0,
            });
        }
        film.develop();
        let reel = film.reel(0).expect("the episode");
        for (taken_ns, wanted_ns) in [(200, 200), (220, 220), (239, 220), (900, 240), (0, 200)] {
            let asked = Header {
                tick: 2,
                taken_ns,
                ..Header::default()
            };
            let (seen, moves) = reel.at(&asked).expect("the tick");
            assert_eq!(seen.taken_ns, wanted_ns, "asked for {taken_ns}");
            let instants = (wanted_ns as usize - 200) / 20;
            assert_eq!(moves.len(), 2 + instants, "asked for {taken_ns}");
        }
    }

    #[test]
    fn the_episode_before_is_kept_and_older_ones_are_gone() {
        let (mut recorder, mut film) = film();
        for episode in 0..3 {
            let first = u64::from(episode) * 10;
            tell(&mut recorder, episode, first..first + 10);
        }
        film.develop();
        assert!(film.reel(0).is_none());
        let before = film.reel(1).expect("the one before");
        assert_eq!(before.at(&asked(19)).map(|(_, moves)| moves.len()), Some(9));
        let now = film.reel(2).expect("the one that runs");
        assert_eq!((now.seed, now.at(&asked(19))), (102, None));
        assert_eq!(now.at(&asked(29)).map(|(_, moves)| moves.len()), Some(9));
    }

    #[test]
    fn what_does_not_fit_is_lost_until_the_next_episode() {
        let (mut recorder, mut film) = film_of(8);
        // Began, 0, move, 1, move, 2, move, 3: the rest has no room.
        tell(&mut recorder, 0, 0..50);
        film.develop();
        recorder.moved(step(50.0));
        recorder.saw(seen(50));
        film.develop();
        let reel = film.reel(0).expect("the episode");
        assert!(reel.at(&asked(3)).is_some(), "what came before is whole");
        assert!(reel.at(&asked(4)).is_none() && reel.at(&asked(50)).is_none());
        tell(&mut recorder, 1, 51..53);
        film.develop();
        let reel = film.reel(1).expect("the next episode");
        assert_eq!(
            reel.at(&asked(52)).map(|(_, moves)| moves),
            Some(&[step(52.0)][..])
        );
    }
}
