//! Asks one judge about a series of scenes and counts its answers.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, anyhow};
use gate::model::{Asker, Fault};
use gate::presentation::picture::{Style, picture};
use gate::presentation::{Party, Prompt, Showing};
use gate::query::Occasion;
use gate::record::store::Store;
use gate::record::{Asking, Record, Said};
use judge::audit::Agreement;
use judge::replay::preference_of;
use judge::statistics::Share;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::Rng;
use serde::Serialize;
use shm_config::config::{View, Vlm};
use shm_config::seen::Seen;
use vehicle::Vehicle;

use super::scenes::Scene;

/// The word for questions that are asked without a second, swapped question.
pub const ONCE: &str = "once";
/// Pause when the configured limit of requests per minute is reached.
const PACE: Duration = Duration::from_secs(1);

/// One row of the table.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Camera of the scenes: ego or `top_down`.
    pub view: &'static str,
    /// Name of the judge.
    #[serde(rename = "who")]
    pub judge: String,
    /// Whether each question is asked once, or twice with the paths swapped.
    pub asked: &'static str,
    /// Share of the preferences that are right.
    pub right_of_preferences: Share,
    /// Share of all questions with a right preference.
    pub right_of_all: Share,
    /// Cohen's kappa of the preferences.
    pub kappa: Option<f64>,
    /// Share of the answers with a preference that prefer the path in the first place
    /// (of the first question).
    pub first_place: Share,
    /// Confusion matrix. Rows: the driver that is safer by the simulator (expert, policy);
    /// columns: the answer (expert, policy, similar, abstained, failed).
    pub confusion: [[usize; Said::ALL.len()]; 2],
    /// Answers that neither path is clearly safer.
    pub similar: usize,
    /// Abstentions: the two replies disagree.
    pub abstained: usize,
    /// Questions without a usable reply.
    pub failed: usize,
    /// Count of each reason for a missing reply, by its keyword.
    pub faults: BTreeMap<String, usize>,
}

impl Row {
    /// Whether no question got a usable answer.
    pub fn is_unanswered(&self) -> bool {
        self.failed == self.confusion.iter().flatten().sum::<usize>()
    }
}

/// Counts for one way of asking.
#[derive(Default)]
struct Tally {
    agreement: Agreement,
    first_place: Share,
    faults: BTreeMap<String, usize>,
}

impl Tally {
    /// Counts the combined answer of these questions; `safer` is the right answer,
    /// `first` the driver whose path was in the first place.
    fn count(&mut self, safer: Party, first: Party, askings: &[Asking]) {
        let said = Said::of(preference_of(askings), askings);
        self.agreement.count(safer, said);
        if let Some(party) = said.preference() {
            self.first_place.trials += 1;
            self.first_place.hits += usize::from(party == first);
        }
        if said == Said::Failed {
            *self.faults.entry(fault(askings)).or_default() += 1;
        }
    }
}

/// One judge under test, with the counts of its answers so far.
pub struct Evaluation {
    name: String,
    vlm: Vlm,
    vehicle: Vehicle,
    /// Index of the picture of each scene that the judge is shown.
    shot: usize,
    asker: Asker,
    store: Option<Store>,
    once: Tally,
    twice: Tally,
}

/// The name of a view in the configuration.
pub fn view_word(view: View) -> &'static str {
    shm_config::message::View::from(view).word()
}

/// Draws the order and colours of the paths at random.
pub fn showing(chance: &mut Xoshiro256PlusPlus) -> Showing {
    // The upper half of the product is uniform within 1 in 2^64.
    Showing::at_random(|end| ((u128::from(chance.next_u64()) * end as u128) >> 64) as usize)
}

impl Evaluation {
    /// Opens a judge at the address in `vlm`. It is shown the picture of index `shot` of
    /// each scene; its questions are recorded into `folder`.
    ///
    /// # Errors
    /// If the client cannot be made, or the folder cannot be written.
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
    /// If a picture cannot be drawn.
    pub async fn ask(&mut self, scene: &Scene, showing: Showing) -> anyhow::Result<()> {
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
                    // This benchmark has no deadline.
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
        self.once.count(scene.safer(), first, &askings[..1]);
        self.twice.count(scene.safer(), first, &askings);
        if let Some(store) = &mut self.store {
            let record = record(scene, askings, &self.vlm);
            let question = store.begin(record, &pictures);
            store.complete(question);
        }
        Ok(())
    }

    /// The rows of the table: asked once, and asked twice.
    pub fn rows(self) -> [Row; 2] {
        [(ONCE, self.once), ("twice, swapped", self.twice)].map(|(asked, tally)| {
            let agreement = tally.agreement;
            Row {
                view: view_word(self.vlm.view),
                judge: self.name.clone(),
                asked,
                right_of_preferences: agreement.of_preferences(),
                right_of_all: agreement.of_all(),
                kappa: agreement.kappa(),
                first_place: tally.first_place,
                confusion: agreement.counts,
                similar: agreement.said(Said::Similar),
                abstained: agreement.said(Said::Abstained),
                failed: agreement.said(Said::Failed),
                faults: tally.faults,
            }
        })
    }
}

/// The reason for a missing answer: the first failure of the questions.
fn fault(askings: &[Asking]) -> String {
    let mut faults = askings.iter().filter_map(|asking| asking.fault.clone());
    faults.next().unwrap_or_default()
}

fn record(scene: &Scene, askings: Vec<Asking>, vlm: &Vlm) -> Record {
    Record {
        version: gate::record::VERSION,
        question: 0,
        tick: scene.tick,
        episode: scene.seed as u32,
        taken_ns: scene.tick * 100_000_000,
        occasion: Occasion::Period,
        judge: "vlm".into(),
        preset: vlm.prompt.word().into(),
        model: vlm.model_name().into(),
        speed_mps: scene.speed_mps,
        observation: Some(Box::new(Seen::new(&scene.observation))),
        expert: Some(scene.proposed[0]),
        policy: Some(scene.proposed[1]),
        preference: preference_of(&askings),
        fault: fault(&askings),
        latency_s: askings.iter().map(|asking| asking.latency_s).sum(),
        cost_usd: askings.iter().map(|asking| asking.cost_usd).sum(),
        heard_tick: 0,
        heard_ns: 0,
        net: None,
        foresight: Some(scene.outlooks),
        aftermath: None,
        askings,
    }
}
