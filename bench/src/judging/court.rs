//! One judge, asked about scene after scene.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, anyhow};
use judge::audit::Agreement;
use judge::picture::{Style, picture};
use judge::record::{Asking, Occasion, Record, Verdict};
use judge::statistics::Share;
use judge::store::Store;
use judge::{Asker, Fault, Party, Prompt, Reply, Showing};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::Rng;
use serde::Serialize;
use shm_config::config::{View, Vlm};
use vehicle::Vehicle;

use super::scenes::Scene;

/// How long is waited when the own limit of requests per minute is reached.
const PACE: Duration = Duration::from_secs(1);

/// One row of the table.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// From where the scenes were seen.
    pub view: &'static str,
    /// Who was asked.
    pub who: String,
    /// Once, or twice with the paths swapped.
    pub asked: &'static str,
    /// Right answers of those given.
    pub right_of_answered: Share,
    /// Right answers of all questions.
    pub right_of_all: Share,
    /// Cohen's kappa of the answers given.
    pub kappa: Option<f64>,
    /// Answers for the path that was in the first place (when it was asked first),
    /// of those that prefer one.
    pub first_place: Share,
    /// Rows: who truly is safer (expert, policy); columns: who was said to be
    /// (expert, policy, abstained, failed).
    pub confusion: [[usize; 4]; 2],
    /// Without a preference.
    pub abstained: usize,
    /// Without an answer.
    pub failed: usize,
}

/// What was counted of one way to ask.
#[derive(Default)]
struct Tally {
    agreement: Agreement,
    first_place: Share,
}

impl Tally {
    /// Counts what was said where `safer` is right and `first` was in the first
    /// place.
    fn count(&mut self, safer: Party, first: Party, said: (Verdict, Option<Party>)) {
        self.agreement.count(safer, said.0);
        if let Some(party) = said.1 {
            self.first_place.trials += 1;
            self.first_place.hits += usize::from(party == first);
        }
    }
}

/// A judge and what it has said so far.
pub struct Court {
    name: String,
    vlm: Vlm,
    vehicle: Vehicle,
    /// Which of a scene's pictures it is shown.
    shot: usize,
    asker: Asker,
    store: Option<Store>,
    once: Tally,
    twice: Tally,
}

/// As in the configuration.
pub fn view_word(view: View) -> &'static str {
    shm_config::message::View::from(view).word()
}

/// Places and colours at random.
pub fn showing(chance: &mut Xoshiro256PlusPlus) -> Showing {
    // The upper half of a product: uniform up to 1 in 2^64.
    Showing::at_random(|end| ((u128::from(chance.next_u64()) * end as u128) >> 64) as usize)
}

impl Court {
    /// A judge at the address of `vlm`, who is shown each scene's picture of that
    /// number, and whose record goes to a folder.
    ///
    /// # Errors
    /// When it cannot be asked, or the folder not be written.
    pub fn open(
        (name, vlm): (&str, Vlm),
        vehicle: Vehicle,
        (shot, folder): (usize, Option<&Path>),
    ) -> anyhow::Result<Self> {
        let store = folder.map(|folder| Store::open(folder, vlm.record_bytes_max));
        Ok(Self {
            name: name.into(),
            asker: Asker::new(&vlm)?,
            store: store.transpose()?,
            vlm,
            vehicle,
            shot,
            once: Tally::default(),
            twice: Tally::default(),
        })
    }

    /// Asks about a scene, and once more with the paths swapped.
    ///
    /// # Errors
    /// When no picture can be drawn.
    pub async fn hear(&mut self, scene: &Scene, showing: Showing) -> anyhow::Result<()> {
        let mut askings = Vec::new();
        let mut pictures = Vec::new();
        for showing in [showing, showing.swapped()] {
            let shot = scene.shots.get(self.shot).context("no such picture")?;
            let style = Style::of(&self.vlm);
            let proposals = scene.proposals(&self.vehicle);
            let shown = picture(shot.photo(), &proposals, showing, &style)?;
            let Vlm {
                view, horizon_s, ..
            } = self.vlm;
            let prompt = Prompt::new(self.vlm.prompt, showing, view, horizon_s);
            let deadline = Duration::from_secs_f64(self.vlm.deadline_s);
            let asked = loop {
                let asked = self.asker.ask(&prompt, &shown, deadline).await;
                match asked.reply {
                    // Nobody is in a hurry here.
                    Err(Fault::OwnRate) => tokio::time::sleep(PACE).await,
                    Ok(_) | Err(_) => break asked,
                }
            };
            if let Err(fault) = asked.reply
                && (fault.is_permanent() || fault == Fault::Budget)
            {
                return Err(anyhow!("{}: {}", fault.word(), fault.advice()));
            }
            askings.push(Asking::new(&prompt, &asked));
            pictures.push(shown);
        }
        let first = showing.first;
        let said = of_replies(&askings[..1]);
        self.once.count(scene.safer(), first, said);
        let said = of_replies(&askings);
        self.twice.count(scene.safer(), first, said);
        if let Some(store) = &mut self.store {
            let record = record(scene, askings, &self.vlm);
            let question = store.begin(record, &pictures);
            store.complete(question);
        }
        Ok(())
    }

    /// What it has said: asked once, and asked twice.
    pub fn rows(self) -> [Row; 2] {
        [("once", self.once), ("twice, swapped", self.twice)].map(|(asked, tally)| {
            let counts = tally.agreement.counts;
            Row {
                view: view_word(self.vlm.view),
                who: self.name.clone(),
                asked,
                right_of_answered: tally.agreement.of_answered(),
                right_of_all: tally.agreement.of_all(),
                kappa: tally.agreement.kappa(),
                first_place: tally.first_place,
                confusion: counts,
                abstained: counts[0][2] + counts[1][2],
                failed: counts[0][3] + counts[1][3],
            }
        })
    }
}

/// What askings say together, and whom they prefer: "similar" lets the policy
/// drive, but is no preference for a place.
fn of_replies(askings: &[Asking]) -> (Verdict, Option<Party>) {
    let verdict = judge::replay::verdict(askings);
    let is_similar = askings
        .iter()
        .all(|asking| asking.reply == Some(Reply::Similar));
    let party = match verdict {
        Verdict::Expert => Some(Party::Expert),
        Verdict::Policy if !is_similar => Some(Party::Policy),
        Verdict::Policy | Verdict::Abstain | Verdict::Failed => None,
    };
    (verdict, party)
}

fn record(scene: &Scene, askings: Vec<Asking>, vlm: &Vlm) -> Record {
    Record {
        version: judge::record::VERSION,
        question: 0,
        tick: scene.tick,
        episode: scene.seed as u32,
        taken_ns: scene.tick * 100_000_000,
        occasion: Occasion::Period,
        judge: "vlm".into(),
        preset: vlm.prompt.word().into(),
        model: vlm.model_name().into(),
        speed_mps: scene.speed_mps,
        expert: Some(scene.proposed[0]),
        policy: Some(scene.proposed[1]),
        verdict: of_replies(&askings).0,
        votes: Vec::new(),
        fault: askings
            .iter()
            .find_map(|asking| asking.fault.clone())
            .unwrap_or_default(),
        latency_s: askings.iter().map(|asking| asking.latency_s).sum(),
        cost_usd: askings.iter().map(|asking| asking.cost_usd).sum(),
        heard_tick: 0,
        heard_ns: 0,
        foresight: Some(scene.outlooks),
        aftermath: None,
        askings,
    }
}
