//! The bodies of the frames.

use shm_config::layout::Layout as _;
use shm_config::message::{Message, Step};

use super::envelope::{Kind, Outgoing, Rejection, STEPS_MAX};

/// Episodes of a block that have numbers of their own: a block of the default 200 steps has
/// two. A longer block repeats numbers of the next one, and so its scenarios.
const NUMBERS_BITS: u32 = 12;
/// Most ticks of an episode that the learner asks for; 100 times MetaDrive's horizon. It
/// bounds the steps that are held for one actor.
pub const TICKS_MAX: u32 = 100_000;

/// One episode of a block. It follows from the training's seed and from this alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct EpisodeKey {
    /// The block, from 0.
    pub block: u64,
    /// The episode in it, from 0.
    pub episode: u32,
}

impl EpisodeKey {
    /// Its number in the training, of which scenario and random numbers follow.
    pub fn number(self) -> u32 {
        let begin = (self.block << NUMBERS_BITS) as u32;
        begin.wrapping_add(self.episode)
    }
}

/// An episode that an actor shall drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Assignment {
    /// Which.
    pub key: EpisodeKey,
    /// The block needs no more ticks of it than these.
    pub ticks_max: u32,
    /// Steps that its policy has learnt from; 0 for none.
    pub version: u64,
}

/// Reads a body from its beginning.
struct Body<'a>(&'a [u8]);

impl<'a> Body<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], Rejection> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or(Rejection::Content)?;
        self.0 = rest;
        Ok(taken)
    }

    fn u32(&mut self) -> Result<u32, Rejection> {
        let bytes = self.take(4)?.try_into().map_err(|_| Rejection::Content)?;
        Ok(u32::from_le_bytes(bytes))
    }

    fn u64(&mut self) -> Result<u64, Rejection> {
        let bytes = self.take(8)?.try_into().map_err(|_| Rejection::Content)?;
        Ok(u64::from_le_bytes(bytes))
    }

    fn key(&mut self) -> Result<EpisodeKey, Rejection> {
        Ok(EpisodeKey {
            block: self.u64()?,
            episode: self.u32()?,
        })
    }

    fn end(&self) -> Result<(), Rejection> {
        match self.0.is_empty() {
            true => Ok(()),
            false => Err(Rejection::Content),
        }
    }
}

/// A text, as body.
pub fn put_text(out: &mut Outgoing, text: &str, bytes_max: usize) {
    let end = text.floor_char_boundary(bytes_max);
    out.begin().extend_from_slice(&text.as_bytes()[..end]);
}

/// The text of a body.
///
/// # Errors
/// When it is not UTF-8.
pub fn text(body: &[u8]) -> Result<&str, Rejection> {
    std::str::from_utf8(body).map_err(|_| Rejection::Content)
}

/// Build and identity of an actor, as body.
pub fn put_hello(out: &mut Outgoing, build: &str, identity: &str) {
    put_text(
        out,
        &format!("{build}\n{identity}"),
        Kind::Hello.bytes_max(),
    );
}

/// Build and identity of a body.
///
/// # Errors
/// When it is not UTF-8, or has no second line.
pub fn hello(body: &[u8]) -> Result<(&str, &str), Rejection> {
    text(body)?.split_once('\n').ok_or(Rejection::Content)
}

/// A policy file with its version, as body.
pub fn put_policy(out: &mut Outgoing, version: u64, file: &[u8]) {
    let bytes = out.begin();
    bytes.extend_from_slice(&version.to_le_bytes());
    bytes.extend_from_slice(file);
}

/// The version and the policy file of a body.
///
/// # Errors
/// When it is too short.
pub fn policy(body: &[u8]) -> Result<(u64, &[u8]), Rejection> {
    let mut body = Body(body);
    let version = body.u64()?;
    Ok((version, body.0))
}

/// An assignment, as body.
pub fn put_assignment(out: &mut Outgoing, assignment: &Assignment) {
    let bytes = out.begin();
    put_key(bytes, assignment.key);
    bytes.extend_from_slice(&assignment.ticks_max.to_le_bytes());
    bytes.extend_from_slice(&assignment.version.to_le_bytes());
}

/// The assignment of a body.
///
/// # Errors
/// When its length is wrong, or it asks for no tick or too many.
pub fn assignment(body: &[u8]) -> Result<Assignment, Rejection> {
    let mut body = Body(body);
    let assignment = Assignment {
        key: body.key()?,
        ticks_max: body.u32()?,
        version: body.u64()?,
    };
    body.end()?;
    match (1..=TICKS_MAX).contains(&assignment.ticks_max) {
        true => Ok(assignment),
        false => Err(Rejection::Content),
    }
}

fn put_key(bytes: &mut Vec<u8>, key: EpisodeKey) {
    bytes.extend_from_slice(&key.block.to_le_bytes());
    bytes.extend_from_slice(&key.episode.to_le_bytes());
}

/// The end of an episode, as body.
pub fn put_ended(out: &mut Outgoing, key: EpisodeKey, ticks: u32) {
    let bytes = out.begin();
    put_key(bytes, key);
    bytes.extend_from_slice(&ticks.to_le_bytes());
}

/// Episode and number of ticks of a body.
///
/// # Errors
/// When its length is wrong.
pub fn ended(body: &[u8]) -> Result<(EpisodeKey, u32), Rejection> {
    let mut body = Body(body);
    let ended = (body.key()?, body.u32()?);
    body.end()?;
    Ok(ended)
}

/// A body of steps that is being filled.
pub struct StepsBody<'a>(&'a mut Vec<u8>);

/// Where the number of steps stands in the body: after block, episode and first tick.
const COUNT_AT: usize = super::envelope::HEAD_BYTES + 16;

impl<'a> StepsBody<'a> {
    /// Begins one whose first step is of this tick.
    pub fn begin(out: &'a mut Outgoing, key: EpisodeKey, first: u32) -> StepsBody<'a> {
        let bytes = out.begin();
        put_key(bytes, key);
        bytes.extend_from_slice(&first.to_le_bytes());
        bytes.extend_from_slice(&0_u32.to_le_bytes());
        StepsBody(bytes)
    }

    /// Goes on with one that was begun.
    pub fn of(out: &'a mut Outgoing) -> StepsBody<'a> {
        StepsBody(out.more())
    }

    /// Adds the bytes of a step that are used.
    pub fn add(&mut self, step: &Step) {
        let used = &step.as_bytes()[..step.used_bytes()];
        self.0.extend_from_slice(&(used.len() as u32).to_le_bytes());
        self.0.extend_from_slice(used);
        let count = self.count() + 1;
        self.0[COUNT_AT..COUNT_AT + 4].copy_from_slice(&count.to_le_bytes());
    }

    /// Number of steps in it.
    pub fn count(&self) -> u32 {
        let mut word = [0; 4];
        word.copy_from_slice(&self.0[COUNT_AT..COUNT_AT + 4]);
        u32::from_le_bytes(word)
    }
}

/// Steps of an episode that were received.
pub struct Received {
    /// Of which episode.
    pub key: EpisodeKey,
    /// Tick of the first one in the episode.
    pub first: u32,
    /// The steps, checked.
    pub steps: Vec<Box<Step>>,
}

/// The steps of a body; `scratch` is memory that is used again.
///
/// # Errors
/// When a length or a count is wrong, or a step is refused by its own check.
pub fn steps(body: &[u8], scratch: &mut Vec<u8>) -> Result<Received, Rejection> {
    let mut body = Body(body);
    let (key, first, count) = (body.key()?, body.u32()?, body.u32()? as usize);
    if count == 0 || count > STEPS_MAX || first > TICKS_MAX {
        return Err(Rejection::Content);
    }
    let mut steps = Vec::with_capacity(count);
    for index in 0..count {
        let length = body.u32()? as usize;
        if length > size_of::<Step>() {
            return Err(Rejection::Content);
        }
        let used = body.take(length)?;
        scratch.clear();
        scratch.extend_from_slice(used);
        scratch.resize(size_of::<Step>(), 0);
        let step = Step::from_bytes(scratch).ok_or(Rejection::Content)?;
        // The bytes that are used follow from the step, so no two bodies mean the same.
        let is_exact = step.used_bytes() == length;
        if !is_exact || step.check().is_err() {
            return Err(Rejection::Content);
        }
        if step.header.tick != u64::from(first) + index as u64 {
            return Err(Rejection::Sequence);
        }
        steps.push(Box::new(step));
    }
    body.end()?;
    Ok(Received { key, first, steps })
}

#[cfg(test)]
mod tests {
    use shm_config::draw::Draw;

    use super::super::envelope::HEAD_BYTES;
    use super::*;

    const KEY: EpisodeKey = EpisodeKey {
        block: 3,
        episode: 5,
    };

    fn body(count: u64) -> Vec<u8> {
        let mut out = Outgoing::default();
        let mut body = StepsBody::begin(&mut out, KEY, 7);
        for tick in 7..7 + count {
            let mut step = Step::default();
            step.header.tick = tick;
            step.observation.beam_count = 16;
            body.add(&step);
        }
        out.close(Kind::Steps)[HEAD_BYTES..].to_vec()
    }

    #[test]
    fn steps_travel_as_they_are() {
        let received = steps(&body(4), &mut Vec::new()).expect("steps");
        assert_eq!((received.key, received.first), (KEY, 7));
        assert_eq!(received.steps.len(), 4);
        assert_eq!(received.steps[3].header.tick, 10);
        assert_eq!(received.steps[3].observation.beam_count, 16);
    }

    #[test]
    fn damaged_bodies_are_refused_or_hold_steps_that_pass_their_check() {
        let whole = body(2);
        let mut scratch = Vec::new();
        for cut in 0..whole.len() {
            assert!(steps(&whole[..cut], &mut scratch).is_err(), "cut at {cut}");
        }
        let (mut refused, mut admitted) = (0, 0);
        for seed in 0..4000 {
            let (mut draw, mut damaged) = (Draw::new(seed), whole.clone());
            for _ in 0..1 + draw.below(3) {
                let at = draw.below(damaged.len() as u64) as usize;
                damaged[at] ^= 1 << draw.below(8);
            }
            match steps(&damaged, &mut scratch) {
                Ok(received) => {
                    admitted += 1;
                    let mut all = received.steps.iter();
                    assert!(all.all(|step| step.check().is_ok()), "seed {seed}");
                }
                Err(_) => refused += 1,
            }
        }
        assert!(refused > 100 && admitted > 100, "{refused} and {admitted}");
        assert!(steps(&body(0), &mut scratch).is_err(), "no step");
        assert!(
            steps(&body(STEPS_MAX as u64 + 1), &mut scratch).is_err(),
            "too many"
        );
    }
}
