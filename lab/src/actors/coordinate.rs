//! A training with actors: gives episodes out, learns their steps in order, and offers the next
//! policy with the next block's episodes.

use std::collections::BTreeSet;
use std::io;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, bail};
use learner::session::Session;
use shm_config::config::Config;
use stack::Clock;
use supervisor::machine::signals::pause;

use super::children::Children;
use super::connection::{Asked, Guest, OfferedPolicy, SeatEvent};
use super::door::Door;
use super::drive::in_lockstep;
use super::envelope::{Broken, Rejection};
use super::feed::feed;
use super::held;
use super::message::{Assignment, EpisodeKey, TICKS_MAX};
use super::order::{BlockOrder, EpisodePace, LOSSES_MAX, Reception, SeatNumber};
use super::pool::{Pool, UNKNOWN};
use super::tally::ActorsTally;
use crate::stop::Stop;

/// Interval of the checks for a stop request and for new connections.
const LOOK: Duration = Duration::from_millis(100);
/// How long an actor on another machine may take to end its last episode.
const FAREWELL: Duration = Duration::from_secs(10);
/// Reasons that are printed; further ones are counted.
const WARNINGS_MAX: u32 = 20;

/// What a training tells while it waits for its actors.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Notice {
    /// As expected.
    News(String),
    /// Not as expected.
    Warning(String),
}

/// See [`Watch::look`].
pub type Look<'a> = dyn FnMut(&[Notice], &ActorsTally) -> anyhow::Result<()> + 'a;

/// The training's surroundings.
pub struct Watch<'a> {
    /// Measures how long episodes take.
    pub clock: Clock,
    /// A stop request.
    pub stop: &'a Stop,
    /// Called again and again while the actors drive, with new notices and what the actors did.
    pub look: &'a mut Look<'a>,
}

/// One training.
pub struct Coordinator {
    session: Session,
    period_ns: u64,
    block_steps: u64,
    pool: Pool,
    children: Children,
    door: Option<Door>,
    order: BlockOrder,
    pace: EpisodePace,
    policy: Option<OfferedPolicy>,
    tally: ActorsTally,
    /// Notices that are not shown yet, and how many warnings there were.
    notices: Vec<Notice>,
    warnings: u32,
    /// Reasons of which a refusal was told.
    told: BTreeSet<Rejection>,
}

impl Coordinator {
    /// Opens the session in this folder and starts so many actors on this machine; those of
    /// other machines come through the door.
    ///
    /// # Errors
    /// If the folder holds another session, or a process cannot be started.
    pub fn new(
        config: &Config,
        folder: &Path,
        (actors, door): (u32, Option<Door>),
    ) -> anyhow::Result<Coordinator> {
        let config = in_lockstep(config)?;
        held::restore(folder)?;
        let session = Session::open(&config, folder)?;
        if session.driven() != session.learnt() {
            bail!(
                "{}: holds steps of a block that was not driven by actors; move it away to start \
                 anew",
                folder.display()
            );
        }
        let policy = session.driving_policy()?;
        let policy = policy.map(|file| offered(&session, file));
        let mut pool = Pool::new(toml::to_string(&config).context("the configuration")?);
        let children = Children::start(actors, &mut pool)?;
        Ok(Coordinator {
            session,
            period_ns: config.run.period_ns(),
            block_steps: u64::from(config.learner.block_steps),
            pool,
            children,
            door,
            order: BlockOrder::new(0),
            pace: EpisodePace::default(),
            policy,
            tally: ActorsTally::default(),
            notices: Vec::new(),
            warnings: 0,
            told: BTreeSet::new(),
        })
    }

    /// Adds an actor that is connected within this machine, such as one of a test.
    ///
    /// # Errors
    /// When the system refuses a thread.
    pub fn join(&mut self, name: &str, line: UnixStream) -> io::Result<()> {
        self.pool.add_local(name.to_string(), line).map(drop)
    }

    /// Trains until so many steps are learnt, or a stop is requested.
    ///
    /// # Errors
    /// If the actors cannot drive, or a policy is not finite.
    pub fn train(
        &mut self,
        (folder, steps): (&Path, u64),
        mut watch: Watch<'_>,
    ) -> anyhow::Result<()> {
        while self.session.learnt() < steps {
            let learnt = self.session.learnt();
            held::hold(folder, learnt)?;
            self.order = BlockOrder::new(self.block_steps);
            if !self.drive_block(learnt / self.block_steps, &mut watch)? {
                break;
            }
            self.tally.surplus += self.order.surplus();
            self.session.finish();
            let block = self.session.learn(|| {})?;
            self.policy = Some(offered(&self.session, block.policy));
            self.show(&mut watch)?;
        }
        Ok(())
    }

    /// Drives and feeds a block; `false` if a stop is requested before its end.
    fn drive_block(&mut self, block: u64, watch: &mut Watch<'_>) -> anyhow::Result<bool> {
        let mut again = 0;
        while !self.order.is_complete() {
            if watch.stop.is_asked() {
                return Ok(false);
            }
            self.admit(watch)?;
            self.give_out(block, watch);
            if let Some(event) = self.pool.event(LOOK) {
                self.take(event, block, watch)?;
            }
            self.tally.given_again += self.order.again() - again;
            again = self.order.again();
            while let Some((episode, steps)) = self.order.take() {
                feed(
                    &mut self.session,
                    EpisodeKey { block, episode },
                    steps,
                    self.period_ns,
                );
            }
            self.show(watch)?;
        }
        Ok(true)
    }

    fn show(&mut self, watch: &mut Watch<'_>) -> anyhow::Result<()> {
        let notices = std::mem::take(&mut self.notices);
        (watch.look)(&notices, &self.tally)
    }

    fn warn(&mut self, line: String) {
        self.warnings += 1;
        if self.warnings <= WARNINGS_MAX {
            self.notices.push(Notice::Warning(line));
        }
    }

    /// Counts a refusal, and tells the first of each reason.
    fn refuse(&mut self, why: Rejection) {
        self.tally.refuse(why);
        if self.told.insert(why) {
            let line = format!(
                "a peer is refused: {}; further ones are counted",
                why.word()
            );
            self.notices.push(Notice::Warning(line));
        }
    }

    /// Takes new connections of other machines, and ends those whose invitation is revoked.
    fn admit(&mut self, watch: &Watch<'_>) -> anyhow::Result<()> {
        let Some(door) = &mut self.door else {
            return Ok(());
        };
        let mut refused = Vec::new();
        for arrival in door.look(self.pool.room())? {
            match arrival {
                Ok(arrived) => {
                    let guest = Guest::Certified(arrived.certificate);
                    self.pool.add(guest, arrived.line, arrived.close)?;
                }
                Err(why) => refused.push(why),
            }
        }
        let revoked = door.revoked((watch.clock)(), self.pool.certified());
        for why in refused {
            self.refuse(why);
        }
        for seat in revoked {
            self.lose(seat, &Rejection::Revoked.into())?;
        }
        Ok(())
    }

    /// Gives episodes to idle actors.
    fn give_out(&mut self, block: u64, watch: &Watch<'_>) {
        let ticks_max = self.block_steps.min(u64::from(TICKS_MAX)) as u32;
        for seat in self.pool.idle() {
            let Some(episode) = self.order.assign(seat, &self.pace, (watch.clock)()) else {
                continue;
            };
            let version = self.policy.as_ref().map_or(0, |policy| policy.version);
            let asked = Asked {
                assignment: Assignment {
                    key: EpisodeKey { block, episode },
                    ticks_max,
                    version,
                },
                policy: self.policy.clone(),
            };
            self.pool.ask(seat, asked);
        }
    }

    fn take(&mut self, event: SeatEvent, block: u64, watch: &Watch<'_>) -> anyhow::Result<()> {
        match event {
            SeatEvent::Ready(_, name) => {
                if !self.tally.actors.contains_key(&name) {
                    self.notices
                        .push(Notice::News(format!("{name} has joined")));
                }
                self.tally.of(&name).connected += 1;
            }
            SeatEvent::Whole(seat, key, steps) => {
                let Some(name) = self.pool.name(seat).map(String::from) else {
                    // It was ended meanwhile, and its episode is given to another one.
                    return Ok(());
                };
                let transitions = steps.len() as u64;
                let reception = match key.block.cmp(&block) {
                    std::cmp::Ordering::Less => Reception::Double,
                    std::cmp::Ordering::Greater => Reception::Unasked,
                    std::cmp::Ordering::Equal => {
                        let now = (watch.clock)();
                        let from = (seat, key.episode);
                        self.order.answer(from, steps, &mut self.pace, now)
                    }
                };
                match reception {
                    Reception::Kept => {
                        let actor = self.tally.of(&name);
                        actor.episodes += 1;
                        actor.transitions += transitions;
                        self.children.thrives(seat);
                    }
                    Reception::Double => self.tally.doubles += 1,
                    Reception::Unasked => {
                        return self.lose(seat, &Rejection::Unasked.into());
                    }
                }
            }
            SeatEvent::Gone(seat, broken) => return self.lose(seat, &broken),
        }
        Ok(())
    }

    /// A connection is gone: its episode is given to another actor.
    fn lose(&mut self, seat: SeatNumber, broken: &Broken) -> anyhow::Result<()> {
        let Some(name) = self.pool.name(seat).map(String::from) else {
            // It was removed already.
            return Ok(());
        };
        self.pool.remove(seat);
        if name == UNKNOWN {
            match broken {
                Broken::Rejected(why) => self.refuse(*why),
                _ => self.warn(format!("a peer was not admitted: {broken}")),
            }
            return Ok(());
        }
        let actor = self.tally.of(&name);
        actor.deaths += 1;
        actor.connected = actor.connected.saturating_sub(1);
        if let Broken::Rejected(why) = broken {
            self.tally.refuse(*why);
        }
        if let Err(episode) = self.order.lose(seat) {
            bail!(
                "episode {episode} of the block after step {} ended {LOSSES_MAX} actors that drove \
                 it, the last one: {broken}; --resume tries the block again",
                self.session.learnt()
            );
        }
        let ended = self
            .children
            .restart(seat, &mut self.pool, &broken.to_string())?;
        self.warn(match ended {
            Some(ended) => format!(
                "{name} has ended ({ended}, {broken}) and is started again; another actor gets its \
                 episode"
            ),
            None => format!("{name} is gone ({broken}); another actor gets its episode"),
        });
        Ok(())
    }

    /// Ends the actors; returns what they did.
    pub fn finish(mut self) -> ActorsTally {
        drop((self.children, self.door));
        let patience = match self.pool.certified().next() {
            None => Duration::ZERO,
            Some(_) => FAREWELL,
        };
        self.pool.finish(patience, pause);
        for actor in self.tally.actors.values_mut() {
            actor.connected = 0;
        }
        self.tally
    }
}

fn offered(session: &Session, file: Vec<u8>) -> OfferedPolicy {
    OfferedPolicy {
        // 0 says that there is none.
        version: session.learnt().max(1),
        file: file.into(),
    }
}
