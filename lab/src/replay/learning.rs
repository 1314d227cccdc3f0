//! The learner's weights and progress, recomputed with the shipped session from the steps
//! that the learner had.
//!
//! The learner sends a message for each step that it considered, so the recording says which
//! steps it had, and in which order; its updates follow from these, from its seed and from
//! its blocks, in real time as in lockstep. A learner that is restarted goes on from its files,
//! which the session writes to a temporary folder.

use std::collections::VecDeque;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use learner::session::Session;
use policy::{Mlp, Net};
use shm_config::config::{Clock as RunClock, Config};
use shm_config::message::{Header, Learning, Message, Step};
use shm_config::services::Process;
use tempfile::TempDir;

use super::findings::{Findings, Found};
use super::messages::{Stretch, taken};
use super::source::Offer;

const PROCESS: Process = Process::Learner;
/// Steps that a learner may have taken before it was killed without saying so.
const UNTOLD: u64 = 4;
/// Offers of other processes that are kept until their producer is known.
const ASIDE: usize = 16;

/// Offers of weights in the order of the recording.
pub type Offers = Box<dyn Iterator<Item = anyhow::Result<Offer>> + Send>;

/// Recomputes what the learner published.
pub struct Learners {
    config: Config,
    folder: TempDir,
    /// How many folders were begun in it.
    folders: u32,
    offers: Offers,
    aside: VecDeque<Offer>,
    living: Option<Living>,
    /// Recorded steps that no message has named yet, and the number of the last stretch
    /// whose steps are in it.
    steps: VecDeque<Box<Step>>,
    fed: u64,
    /// Why nothing more can be recomputed.
    given_up: Option<String>,
}

/// One learner process.
struct Living {
    session: Session,
    folder: PathBuf,
    header: Header,
}

impl Learners {
    /// Of a run of this configuration, with the weights that were offered in it.
    ///
    /// # Errors
    /// When there is no room for temporary files.
    pub fn new(config: &Config, offers: Offers) -> anyhow::Result<Self> {
        let mut config = config.clone();
        // All cores: their number changes no bit.
        config.run.clock = RunClock::Lockstep;
        Ok(Self {
            config,
            folder: tempfile::tempdir().context("a temporary folder for the learner")?,
            folders: 0,
            offers,
            aside: VecDeque::new(),
            living: None,
            steps: VecDeque::new(),
            fed: 0,
            given_up: None,
        })
    }

    /// Why messages could not be recomputed; `None` when all were.
    pub fn given_up(&self) -> Option<&str> {
        self.given_up.as_deref()
    }

    /// Recomputes the learner's messages of a stretch from this tick on.
    ///
    /// # Errors
    /// When an offer cannot be read, or a temporary file cannot be written.
    pub fn check(
        &mut self,
        stretch: &Stretch,
        from: u64,
        findings: &mut Findings,
    ) -> anyhow::Result<()> {
        self.feed(stretch);
        for recorded in &stretch.now.learning.all {
            let is_wanted = recorded.header.tick >= from;
            if self.given_up.is_none() {
                let found = self.message(stretch.number, recorded)?;
                if is_wanted && self.given_up.is_none() {
                    findings.count(PROCESS, 1);
                    findings.add(PROCESS, found);
                    continue;
                }
            }
            if is_wanted {
                findings.unknown(PROCESS);
            }
        }
        Ok(())
    }

    /// Takes the steps of this stretch and the next, among which a message's step is.
    fn feed(&mut self, stretch: &Stretch) {
        let mut add = |number: u64, steps: &[Step]| {
            if number >= self.fed {
                self.steps.extend(steps.iter().map(|step| Box::new(*step)));
                self.fed = number + 1;
            }
        };
        add(stretch.number, &stretch.now.steps.all);
        add(stretch.number + 1, &stretch.beside[1].steps.all);
    }

    /// What differs in a message and in the weights that it says were published.
    fn message(&mut self, stretch: u64, recorded: &Learning) -> anyhow::Result<Vec<Found>> {
        let header = recorded.header;
        let mut living = match self.living.take() {
            Some(living) if living.header.producer == header.producer => {
                let is_next = header.sequence == living.header.sequence.wrapping_add(1);
                self.consider(living, recorded, is_next)
            }
            living => self.begin(living, recorded)?,
        };
        let Some(own) = &mut living else {
            return Ok(Vec::new());
        };
        own.header = header;
        let again = Learning {
            header,
            steps: own.session.driven(),
            version: recorded.version,
            block_steps: u64::from(self.config.learner.block_steps),
        };
        let pair = (recorded, &again);
        let differs = Found::in_message(PROCESS, stretch, "learning", pair);
        let mut found: Vec<Found> = differs.into_iter().collect();
        let is_first = header.sequence == 1;
        if own.session.is_due() {
            match own.session.learn(|| {}) {
                Ok(_) => found.extend(self.weights(stretch, own)?),
                Err(refusal) => self.give_up(format!("tick {}: {refusal}", header.tick)),
            }
        } else if is_first && own.session.driven() > 0 {
            found.extend(self.weights(stretch, own)?);
        }
        self.living = living;
        Ok(found)
    }

    fn give_up(&mut self, why: String) {
        self.given_up.get_or_insert(why);
    }

    /// Takes the step that a message names. Steps before it that no message names were lost
    /// on the way to the learner, or their messages on the way to the recorder.
    fn consider(
        &mut self,
        mut living: Living,
        recorded: &Learning,
        is_next: bool,
    ) -> Option<Living> {
        let wanted = taken(&recorded.header);
        let Some(at) = self.steps.iter().position(|s| taken(&s.header) == wanted) else {
            let tick = recorded.header.tick;
            self.give_up(format!("the step of tick {tick} is not in the recording"));
            return None;
        };
        for (index, step) in self.steps.drain(..=at).enumerate() {
            if (index == at || !is_next) && step.check().is_ok() {
                living.session.push(&step);
                if index < at && living.session.is_due() {
                    // The message of the block's end is not recorded; its weights may be.
                    let _ = living.session.learn(|| {});
                }
            }
        }
        Some(living)
    }

    /// A learner that was started: the run's first, or one that goes on from the files of
    /// the one before it.
    fn begin(
        &mut self,
        before: Option<Living>,
        first: &Learning,
    ) -> anyhow::Result<Option<Living>> {
        let (wanted, header) = (first.steps, first.header);
        if header.sequence != 1 {
            self.give_up("the learner's first messages are not in the recording".into());
            return Ok(None);
        }
        let Some(mut before) = before else {
            let folder = self.new_folder();
            let living = self.open(folder, header)?;
            if wanted > 0 {
                self.give_up(format!(
                    "the learner went on with {wanted} steps from before the recording, whose \
                     files are not in it"
                ));
                return Ok(None);
            }
            return Ok(Some(living));
        };
        for _ in 0..UNTOLD {
            let folder = self.new_folder();
            copy(&before.folder, &folder)?;
            let living = self.open(folder, header)?;
            if living.session.driven() == wanted {
                return Ok(Some(living));
            }
            match self.steps.pop_front() {
                Some(step) if step.check().is_ok() => before.session.push(&step),
                Some(_) | None => break,
            }
        }
        self.give_up(format!(
            "the restarted learner went on with {wanted} steps, which the recorded ones do not \
             give"
        ));
        Ok(None)
    }

    fn new_folder(&mut self) -> PathBuf {
        self.folders += 1;
        self.folder.path().join(self.folders.to_string())
    }

    fn open(&self, folder: PathBuf, header: Header) -> anyhow::Result<Living> {
        let session = Session::open(&self.config, &folder).context("the learner's session")?;
        Ok(Living {
            session,
            folder,
            header,
        })
    }

    /// The first difference in the weights that were published now.
    fn weights(&mut self, stretch: u64, own: &mut Living) -> anyhow::Result<Option<Found>> {
        let steps = own.session.learnt();
        let Some(offer) = self.offer(own.header.producer, steps)? else {
            self.give_up(format!(
                "the weights of {steps} steps are not in the recording"
            ));
            return Ok(None);
        };
        let at = (stretch, &own.header);
        let hash = policy::sha256(&offer.file);
        if hash != offer.sha256 {
            let values = (short(&offer.sha256), short(&hash));
            return Ok(Some(Found::new(PROCESS, at, "weights.sha256", values)));
        }
        let recorded = policy::decode(&offer.file).context("recorded weights")?;
        if let Some(provenance) = &recorded.provenance {
            // Of the build that recorded it.
            own.session.set_commit(provenance.commit.clone());
        }
        let again = own.session.policy_file().context("recomputed weights")?;
        if again == offer.file {
            return Ok(None);
        }
        let (field, left, right) = differing_weight(&recorded.net, &again)
            .unwrap_or_else(|| ("weights.sha256".into(), short(&hash), short_of(&again)));
        Ok(Some(Found::new(PROCESS, at, field, (left, right))))
    }

    /// The recorded offer of a learner after so many steps.
    fn offer(&mut self, producer: u32, steps: u64) -> anyhow::Result<Option<Offer>> {
        let is_it = |offer: &Offer| {
            let learnt = || policy::decode(&offer.file).ok()?.provenance;
            offer.header.producer == producer
                && learnt().is_none_or(|provenance| provenance.steps == steps)
        };
        if let Some(at) = self.aside.iter().position(is_it) {
            return Ok(self.aside.remove(at));
        }
        while self.aside.len() < ASIDE {
            match self.offers.next().transpose()? {
                Some(offer) if is_it(&offer) => return Ok(Some(offer)),
                Some(offer) => self.aside.push_back(offer),
                None => break,
            }
        }
        self.aside.clear();
        Ok(None)
    }
}

/// The first weight in which a recorded network differs from this file's, with both values.
fn differing_weight(recorded: &Net, again: &[u8]) -> Option<(String, String, String)> {
    let again = policy::decode(again).ok()?.net;
    let (Net::Mlp { mlp: left, .. }, Net::Mlp { mlp: right, .. }) = (recorded, &again) else {
        return None;
    };
    let numbers = |mlp: &Mlp| {
        let convolutions = mlp.convolutions().iter().enumerate();
        let convolutions =
            convolutions.map(|(k, layer)| ("convolutions", k, &layer.weights, &layer.bias));
        let layers = mlp.layers().iter().enumerate();
        let layers = layers.map(|(k, layer)| ("layers", k, &layer.weights, &layer.bias));
        let of_layer = convolutions
            .chain(layers)
            .flat_map(|(kind, k, weights, bias)| {
                let named = move |part: &'static str, (i, value): (usize, &f32)| {
                    (format!("weights.{kind}[{k}].{part}[{i}]"), *value)
                };
                let weights = weights.iter().enumerate();
                let bias = bias.iter().enumerate();
                weights
                    .map(move |numbered| named("weights", numbered))
                    .chain(bias.map(move |numbered| named("bias", numbered)))
            });
        of_layer.collect::<Vec<_>>()
    };
    let (left, right) = (numbers(left), numbers(right));
    let pairs = left.into_iter().zip(right);
    let mut differing = pairs.filter(|((_, a), (_, b))| a.to_bits() != b.to_bits());
    let ((field, left), (_, right)) = differing.next()?;
    Some((field, format!("{left:?}"), format!("{right:?}")))
}

fn short(sha256: &[u8; 32]) -> String {
    format!("{:016x}", policy::short_hash(sha256))
}

fn short_of(file: &[u8]) -> String {
    short(&policy::sha256(file))
}

/// Copies a session's folder, as a learner that is killed leaves it.
fn copy(from: &Path, to: &Path) -> anyhow::Result<()> {
    fs::create_dir_all(to).with_context(|| to.display().to_string())?;
    for entry in fs::read_dir(from).with_context(|| from.display().to_string())? {
        let (path, target) = entry.map(|entry| (entry.path(), to.join(entry.file_name())))?;
        match path.is_dir() {
            true => copy(&path, &target)?,
            false => {
                fs::copy(&path, &target).with_context(|| path.display().to_string())?;
            }
        }
    }
    Ok(())
}
