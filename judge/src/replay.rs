//! Asks the configured model the questions of a record again.

use shm_config::message::Preference;
use std::collections::BTreeSet;
use std::io::Cursor;
use std::path::Path;
use std::time::Duration;

use image::ImageReader;
use shm_config::config::{PromptPreset, Vlm};

use crate::statistics::kappa;
use gate::model::{Asker, Fault};
use gate::presentation::picture::{Encoding, Picture};
use gate::presentation::{Prompt, Reply, Showing, combine};
use gate::record::store::{Records, Store, read};
use gate::record::{Asking, Record};

/// Pause when the configured limit of requests per minute is reached.
const PACE: Duration = Duration::from_secs(1);

/// Asks question by question and records the answers in a folder of its own.
pub struct Replay {
    vlm: Vlm,
    asker: Asker,
    store: Store,
    /// Questions that an earlier replay into this folder has asked.
    done: BTreeSet<Key>,
}

/// Identifies a question: episode, tick, and the observation's time.
type Key = (u32, u64, u64);

/// Result of one question.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// It was asked, and the answer is recorded.
    Asked,
    /// It had been asked before.
    Before,
    /// Not asked: a picture of it is missing, or its preset is unknown.
    Gone,
    /// The model cannot be asked any more, for this reason; nothing was recorded.
    Closed(Fault),
}

impl Replay {
    /// Asks with the settings of `vlm` through `asker`; continues an earlier replay into the
    /// same folder.
    ///
    /// # Errors
    /// If the folder cannot be written.
    pub fn new(
        vlm: &Vlm,
        asker: Asker,
        folder: &Path,
    ) -> Result<Self, gate::record::store::StoreError> {
        let store = Store::open(folder, vlm.record_bytes_max)?;
        let done = read(folder).map_or_else(|_| Vec::new(), |records| records.questions);
        Ok(Self {
            vlm: vlm.clone(),
            asker,
            store,
            // Failed questions are asked again.
            done: done
                .iter()
                .filter(|record| record.preference.is_some())
                .map(key)
                .collect(),
        })
    }

    /// Asks one question of a record again, with the same pictures and words.
    pub async fn ask(&mut self, records: &Records, record: &Record) -> Step {
        if self.done.contains(&key(record)) {
            return Step::Before;
        }
        let preset = [PromptPreset::Blind, PromptPreset::Paper]
            .into_iter()
            .find(|preset| preset.word() == record.preset);
        let pictures: Option<Vec<Picture>> = record
            .askings
            .iter()
            .map(|asking| kept(&records.folder, &asking.picture))
            .collect();
        let (Some(preset), Some(pictures)) = (preset, pictures) else {
            return Step::Gone;
        };
        let mut askings = Vec::new();
        for (asking, picture) in record.askings.iter().zip(&pictures) {
            match self.ask_once(preset, asking, picture).await {
                Ok(asking) => askings.push(asking),
                Err(fault) => return Step::Closed(fault),
            }
        }
        let fault = askings.iter().find_map(|asking| asking.fault.clone());
        let said = Record {
            model: self.vlm.model_name().into(),
            judge: "vlm".into(),
            preference: preference_of(&askings),
            fault: fault.unwrap_or_default(),
            latency_s: askings.iter().map(|asking| asking.latency_s).sum(),
            cost_usd: askings.iter().map(|asking| asking.cost_usd).sum(),
            askings,
            ..record.clone()
        };
        let question = self.store.begin(said, &pictures);
        self.store.complete(question);
        self.done.insert(key(record));
        Step::Asked
    }

    async fn ask_once(
        &self,
        preset: PromptPreset,
        asking: &Asking,
        picture: &Picture,
    ) -> Result<Asking, Fault> {
        let prompt = Prompt {
            preset,
            showing: asking.showing,
            system: asking.system.clone(),
            user: asking.user.clone(),
        };
        let deadline = Duration::from_secs_f64(self.vlm.deadline_s);
        loop {
            let asked = self.asker.ask(&prompt, picture, deadline).await;
            match asked.reply {
                // An offline replay has no deadline.
                Err(Fault::OwnRate) => tokio::time::sleep(PACE).await,
                Err(Fault::Budget) => return Err(Fault::Budget),
                Err(fault) if fault.is_permanent() => return Err(fault),
                Ok(_) | Err(_) => return Ok(Asking::new(&prompt, &asked)),
            }
        }
    }

    /// Total cost so far, US dollars.
    pub fn spent_usd(&self) -> f64 {
        self.asker.spent_usd()
    }

    /// Records that could not be written.
    pub fn lost(&self) -> &gate::record::store::Lost {
        self.store.lost()
    }
}

fn key(record: &Record) -> Key {
    (record.episode, record.tick, record.taken_ns)
}

/// A picture of the record, as it was sent.
fn kept(folder: &Path, name: &str) -> Option<Picture> {
    let encoding = match Path::new(name).extension()?.to_str()? {
        "png" => Encoding::Png,
        "jpg" => Encoding::Jpeg,
        _ => return None,
    };
    let bytes = std::fs::read(folder.join(name)).ok()?;
    let reader = ImageReader::new(Cursor::new(&bytes)).with_guessed_format();
    let (width, height) = reader.ok()?.into_dimensions().ok()?;
    Some(Picture {
        bytes,
        encoding,
        width,
        height,
    })
}

/// The combined preference of the replies; `None` unless each request has a reply.
pub fn preference_of(askings: &[Asking]) -> Option<Preference> {
    let replies: Option<Vec<(Showing, Reply)>> = askings
        .iter()
        .map(|asking| Some((asking.showing, asking.reply?)))
        .collect();
    replies.map(|replies| combine(&replies))
}

/// Agreement of two judges on the same questions. Rows: one judge, columns: the other;
/// expert, policy, abstained, failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Comparison {
    /// The counts.
    pub counts: [[usize; 4]; 4],
}

impl Comparison {
    /// Counts the questions that both were asked.
    pub fn of(one: &Records, other: &Records) -> Self {
        let mut counts = [[0; 4]; 4];
        for record in &one.questions {
            // A question that failed and was asked again has two records: the last one counts.
            let mut same = other.questions.iter().rev();
            if let Some(again) = same.find(|again| key(again) == key(record)) {
                counts[place(record.preference)][place(again.preference)] += 1;
            }
        }
        Self { counts }
    }

    /// Cohen's kappa of the questions that both answered.
    pub fn kappa(&self) -> Option<f64> {
        let [expert, policy, ..] = self.counts;
        kappa(&[[expert[0], expert[1]], [policy[0], policy[1]]])
    }
}

fn place(preference: Option<Preference>) -> usize {
    match preference {
        Some(Preference::Expert) => 0,
        Some(Preference::Policy) => 1,
        Some(Preference::Abstain) => 2,
        None => 3,
    }
}
