//! The episodes of one block: which actor drives which, and in which order they are learnt.
//!
//! No clock, thread or socket: the result of a block is its episodes in order, whichever
//! actors drove them, and however often.

use std::collections::{BTreeMap, VecDeque};

use shm_config::Instant;
use shm_config::message::Step;

/// Most episodes beyond the first one that is missing: what is held in memory until then.
pub const AHEAD_MAX: u32 = 64;
/// Actors that drive the same episode at a time, if one of them is slow.
const COPIES_MAX: usize = 2;
/// Actors that an episode may lose before the training gives up: the episode ends them.
pub const LOSSES_MAX: u32 = 8;
/// An episode that takes this many times the median is slow. Episodes of the same training
/// differ by less: an early crash takes a tenth of a whole route.
const SLOW_FACTOR: u64 = 10;
/// No episode is slow before, ns: a busy machine stops a process for as long.
const SLOW_MIN_NS: u64 = 1_000_000_000;
/// Before any episode is known, ns.
const SLOW_UNKNOWN_NS: u64 = 60_000_000_000;
/// Durations that the median is of.
const DURATIONS: usize = 32;

/// A connection of an actor.
pub type SeatNumber = u64;

/// What is known of all episodes so far: their length, and how long they take.
#[derive(Clone, Debug, Default)]
pub struct EpisodePace {
    episodes: u64,
    ticks: u64,
    durations_ns: VecDeque<u64>,
}

impl EpisodePace {
    fn note(&mut self, ticks: u64, duration_ns: u64) {
        self.episodes += 1;
        self.ticks += ticks;
        if self.durations_ns.len() == DURATIONS {
            self.durations_ns.pop_front();
        }
        self.durations_ns.push_back(duration_ns);
    }

    /// Mean length of an episode, ticks; `None` before the first.
    fn length(&self) -> Option<u64> {
        (self.episodes > 0).then(|| self.ticks.div_ceil(self.episodes).max(1))
    }

    /// From when on an episode is slow, ns.
    pub fn slow_ns(&self) -> u64 {
        let mut sorted: Vec<u64> = self.durations_ns.iter().copied().collect();
        sorted.sort_unstable();
        match sorted.get(sorted.len() / 2) {
            Some(median) => median.saturating_mul(SLOW_FACTOR).max(SLOW_MIN_NS),
            None => SLOW_UNKNOWN_NS,
        }
    }
}

/// One episode of the block.
#[derive(Default)]
struct Given {
    /// Actors that drive it now, and since when.
    holders: Vec<(SeatNumber, Instant)>,
    /// All actors that were asked for it.
    asked: Vec<SeatNumber>,
    /// How many of them ended while they drove it.
    losses: u32,
    /// Its steps, until they are taken.
    whole: Option<Vec<Box<Step>>>,
    is_known: bool,
}

/// What becomes of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reception {
    /// It is the first one.
    Kept,
    /// The episode is known already: a double, which is ignored.
    Double,
    /// This actor was not asked for it.
    Unasked,
}

/// Episodes of a block between their assignment and the learner.
pub struct BlockOrder {
    needed: u64,
    taken: u64,
    given: BTreeMap<u32, Given>,
    /// The next episode that is learnt.
    next: u32,
    /// The next one that no actor was asked for.
    new: u32,
    /// Episodes that were given to an actor again.
    again: u64,
    /// Steps of the last episode beyond the end of the block.
    cut: u64,
}

impl BlockOrder {
    /// A block of so many steps.
    pub fn new(needed: u64) -> BlockOrder {
        BlockOrder {
            needed,
            taken: 0,
            given: BTreeMap::new(),
            next: 0,
            new: 0,
            again: 0,
            cut: 0,
        }
    }

    /// Episodes that were given to an actor again so far.
    pub fn again(&self) -> u64 {
        self.again
    }

    /// Steps that are known and that the block, which is complete, does not need.
    pub fn surplus(&self) -> u64 {
        self.cut + self.known()
    }

    /// Steps that are known and were not taken yet.
    fn known(&self) -> u64 {
        let whole = self.given.values().filter_map(|given| given.whole.as_ref());
        whole.map(|steps| steps.len() as u64).sum()
    }

    /// The episode that an idle actor drives next; `None` if there is nothing for it.
    pub fn assign(&mut self, seat: SeatNumber, pace: &EpisodePace, now: Instant) -> Option<u32> {
        let is_lost = |given: &Given| !given.is_known && given.holders.is_empty();
        let lost = self.given.iter().find(|(_, given)| is_lost(given));
        let episode = lost.map(|(episode, _)| *episode);
        let episode = episode.or_else(|| self.new_episode(pace));
        let episode = episode.or_else(|| self.slow_episode(seat, pace, now))?;
        let given = self.given.entry(episode).or_default();
        self.again += u64::from(!given.asked.is_empty());
        given.holders.push((seat, now));
        if !given.asked.contains(&seat) {
            given.asked.push(seat);
        }
        Some(episode)
    }

    /// A new one, while those that are known or driven are too few for the block.
    fn new_episode(&mut self, pace: &EpisodePace) -> Option<u32> {
        let driven = self.given.values().filter(|given| !given.is_known).count() as u64;
        // An unknown length is no reason to wait.
        let coming = pace.length().map_or(0, |length| driven * length);
        let expected = self.taken + self.known() + coming;
        if expected >= self.needed || self.new - self.next >= AHEAD_MAX {
            return None;
        }
        self.new += 1;
        Some(self.new - 1)
    }

    /// The one that takes longest, if it is slow and another actor drives it.
    fn slow_episode(&self, seat: SeatNumber, pace: &EpisodePace, now: Instant) -> Option<u32> {
        let slow_ns = pace.slow_ns();
        let ages = self.given.iter().filter_map(|(episode, given)| {
            let is_free = given.holders.iter().all(|(holder, _)| *holder != seat);
            let is_open = !given.is_known && given.holders.len() < COPIES_MAX && is_free;
            let since = given.holders.iter().map(|(_, since)| *since).max()?;
            let age_ns = now.since_ns(since);
            (is_open && age_ns > slow_ns).then_some((age_ns, *episode))
        });
        ages.max().map(|(_, episode)| episode)
    }

    /// Takes the steps of an episode from an actor.
    pub fn answer(
        &mut self,
        (seat, episode): (SeatNumber, u32),
        steps: Vec<Box<Step>>,
        pace: &mut EpisodePace,
        now: Instant,
    ) -> Reception {
        let Some(given) = self.given.get_mut(&episode) else {
            // Taken already; its entry is gone.
            return match episode < self.next {
                true => Reception::Double,
                false => Reception::Unasked,
            };
        };
        if !given.asked.contains(&seat) {
            return Reception::Unasked;
        }
        let held = given.holders.iter().position(|(holder, _)| *holder == seat);
        let since = held.map(|at| given.holders.swap_remove(at).1);
        if given.is_known {
            return Reception::Double;
        }
        if let Some(since) = since {
            pace.note(steps.len() as u64, now.since_ns(since));
        }
        given.is_known = true;
        given.whole = Some(steps);
        Reception::Kept
    }

    /// An actor is gone; its episode is given to another one.
    ///
    /// # Errors
    /// The episode, if it has ended too many actors.
    pub fn lose(&mut self, seat: SeatNumber) -> Result<(), u32> {
        for (episode, given) in &mut self.given {
            let held = given.holders.len();
            given.holders.retain(|(holder, _)| *holder != seat);
            given.losses += u32::from(given.holders.len() < held);
            if given.losses >= LOSSES_MAX && !given.is_known {
                return Err(*episode);
            }
        }
        Ok(())
    }

    /// The next episode in order, if it is known: its number and the steps that the block
    /// needs of it.
    pub fn take(&mut self) -> Option<(u32, Vec<Box<Step>>)> {
        if self.is_complete() {
            return None;
        }
        let whole = self.given.get_mut(&self.next)?.whole.take()?;
        let episode = self.next;
        self.given.remove(&episode);
        self.next += 1;
        let mut steps = whole;
        let length = steps.len() as u64;
        steps.truncate(usize::try_from(self.needed - self.taken).unwrap_or(usize::MAX));
        self.cut += length - steps.len() as u64;
        self.taken += steps.len() as u64;
        Some((episode, steps))
    }

    /// Whether all steps of the block are taken.
    pub fn is_complete(&self) -> bool {
        self.taken >= self.needed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;

    fn steps(count: u64) -> Vec<Box<Step>> {
        (0..count).map(|_| Box::default()).collect()
    }

    fn at(seconds: u64) -> Instant {
        Instant(seconds * S)
    }

    #[test]
    fn episodes_are_taken_in_order_and_the_last_one_is_cut() {
        let (mut order, mut pace) = (BlockOrder::new(100), EpisodePace::default());
        for seat in 0..3 {
            assert_eq!(order.assign(seat, &pace, at(0)), Some(seat as u32));
        }
        let mut answer = |order: &mut BlockOrder, seat: u64, count| {
            order.answer((seat, seat as u32), steps(count), &mut pace, at(1))
        };
        assert_eq!(answer(&mut order, 2, 60), Reception::Kept);
        assert_eq!(answer(&mut order, 1, 30), Reception::Kept);
        assert!(order.take().is_none(), "the first one is missing");
        assert_eq!(answer(&mut order, 0, 30), Reception::Kept);
        let taken: Vec<_> = std::iter::from_fn(|| order.take())
            .map(|(episode, steps)| (episode, steps.len()))
            .collect();
        assert_eq!(taken, [(0, 30), (1, 30), (2, 40)]);
        assert!(order.is_complete());
        assert_eq!(order.surplus(), 20);
    }

    #[test]
    fn a_lost_episode_is_given_again_and_a_double_is_ignored() {
        let (mut order, mut pace) = (BlockOrder::new(1000), EpisodePace::default());
        assert_eq!(order.assign(7, &pace, at(0)), Some(0));
        order.lose(7).expect("the first loss");
        assert_eq!(order.assign(8, &pace, at(1)), Some(0));
        assert_eq!(order.again(), 1);
        let mut answer = |order: &mut BlockOrder, seat, episode| {
            order.answer((seat, episode), steps(10), &mut pace, at(2))
        };
        assert_eq!(answer(&mut order, 9, 0), Reception::Unasked);
        assert_eq!(answer(&mut order, 8, 0), Reception::Kept);
        assert_eq!(answer(&mut order, 7, 0), Reception::Double);
        assert_eq!(order.take().map(|(episode, _)| episode), Some(0));
        assert_eq!(answer(&mut order, 7, 0), Reception::Double);
        assert_eq!(answer(&mut order, 7, 1), Reception::Unasked);
    }

    #[test]
    fn a_slow_episode_is_given_to_an_idle_actor_once() {
        let (mut order, mut pace) = (BlockOrder::new(20), EpisodePace::default());
        pace.note(20, 2 * S);
        assert_eq!(order.assign(1, &pace, at(0)), Some(0));
        assert_eq!(order.assign(2, &pace, at(19)), None, "not slow yet");
        assert_eq!(order.assign(1, &pace, at(21)), None, "it drives it itself");
        assert_eq!(order.assign(2, &pace, at(21)), Some(0));
        assert_eq!(order.assign(3, &pace, at(99)), None, "two are enough");
        assert_eq!(order.again(), 1);
    }

    #[test]
    fn no_more_episodes_are_given_than_the_block_is_expected_to_need() {
        let (mut order, mut pace) = (BlockOrder::new(100), EpisodePace::default());
        pace.note(40, S);
        let given: Vec<_> = (0..8)
            .map(|seat| order.assign(seat, &pace, at(0)))
            .collect();
        assert_eq!(given.iter().flatten().count(), 3);
        // They were shorter than expected.
        for seat in 0..3 {
            order.answer((seat, seat as u32), steps(20), &mut pace, at(1));
        }
        assert_eq!(order.assign(0, &pace, at(1)), Some(3));
    }

    #[test]
    fn an_episode_that_ends_every_actor_ends_the_training() {
        let (mut order, pace) = (BlockOrder::new(100), EpisodePace::default());
        for seat in 0..u64::from(LOSSES_MAX) {
            assert_eq!(order.assign(seat, &pace, at(0)), Some(0));
            let is_last = seat + 1 == u64::from(LOSSES_MAX);
            assert_eq!(order.lose(seat), if is_last { Err(0) } else { Ok(()) });
        }
    }

    #[test]
    fn what_is_held_in_memory_is_bounded() {
        let (mut order, mut pace) = (BlockOrder::new(u64::MAX), EpisodePace::default());
        for seat in 0..u64::from(AHEAD_MAX) {
            let episode = order.assign(seat, &pace, at(0)).expect("an episode");
            if episode > 0 {
                order.answer((seat, episode), steps(1), &mut pace, at(0));
            }
        }
        assert_eq!(order.assign(99, &pace, at(0)), None);
        order.answer((0, 0), steps(1), &mut pace, at(0));
        assert!(order.take().is_some());
        assert_eq!(order.assign(99, &pace, at(0)), Some(AHEAD_MAX));
    }
}
