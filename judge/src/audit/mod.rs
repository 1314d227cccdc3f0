//! The audit of a judge: the figures of its records, and a page that shows them.

mod charts;
mod figures;
mod page;
mod questions;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

pub use crate::statistics::Bin;
pub use figures::{Agreement, BINS, Figures, Flips, Truth};

use shm_config::text::printable_lines;

use gate::record::Record;
use gate::record::store::Records;

/// Larger pictures are linked instead of embedded, bytes.
const PICTURE_BYTES_MAX: u64 = 4 << 20;

/// The page, and the pictures that it needs beside it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Page {
    /// HTML of the page.
    pub html: String,
    /// Names of the linked pictures.
    pub linked: BTreeSet<String>,
}

/// Makes the page of a folder of records. It embeds the first `pictures_max` pictures
/// and links the others; `link` is the path from the page's folder to that of the
/// pictures. All text of a model is escaped, and the page forbids scripts.
pub fn page(records: &Records, pictures_max: usize, link: &Path) -> Page {
    let pictures = Pictures::of(records, pictures_max, link);
    let html = page::page(records, &Figures::of(&records.questions), &pictures).into_string();
    Page {
        // Any part of the text may come from a model, a server or a path.
        html: printable_lines(&html).into_owned(),
        linked: pictures.linked,
    }
}

/// The pictures of the page, embedded or linked.
struct Pictures {
    /// Data URLs by picture name.
    embedded: BTreeMap<String, String>,
    /// Names of the existing pictures that are not embedded.
    linked: BTreeSet<String>,
    link: PathBuf,
}

/// How the page shows a picture.
enum Shown<'a> {
    Embedded(&'a str),
    Linked(String),
    Nowhere,
}

impl Pictures {
    /// Embeds pictures of wrong answers first, since they matter most.
    fn of(records: &Records, most: usize, link: &Path) -> Self {
        let mut order: Vec<&Record> = records.questions.iter().collect();
        order.sort_by_key(|record| (rank(record), record.question));
        let askings = order.into_iter().flat_map(|record| &record.askings);
        let names = askings.map(|asking| &asking.picture);
        let (mut embedded, mut linked) = (BTreeMap::new(), BTreeSet::new());
        for name in names.filter(|name| is_inside(name)) {
            let path = records.folder.join(name);
            let url = match embedded.len() < most {
                true => data_url(&path),
                false => None,
            };
            match url {
                Some(url) => _ = embedded.insert(name.clone(), url),
                None if path.is_file() => _ = linked.insert(name.clone()),
                None => {}
            }
        }
        Self {
            embedded,
            linked,
            link: link.into(),
        }
    }

    fn shown(&self, name: &str) -> Shown<'_> {
        if let Some(url) = self.embedded.get(name) {
            return Shown::Embedded(url);
        }
        match self.linked.contains(name) {
            true => Shown::Linked(self.link.join(name).display().to_string()),
            false => Shown::Nowhere,
        }
    }
}

fn rank(record: &Record) -> u8 {
    match (Truth::of(record), record.said().preference()) {
        (Truth::Safer(safer), Some(preferred)) if preferred != safer => 0,
        (Truth::Safer(_), None) => 1,
        _ => 2,
    }
}

/// Whether a name stays within the records' folder: records may be untrusted.
fn is_inside(name: &str) -> bool {
    !name.is_empty()
        && Path::new(name)
            .components()
            .all(|part| matches!(part, Component::Normal(_)))
}

fn data_url(path: &Path) -> Option<String> {
    let mime = match path.extension()?.to_str()? {
        "png" => "image/png",
        "jpg" => "image/jpeg",
        _ => return None,
    };
    let length = std::fs::metadata(path).ok()?.len();
    if length > PICTURE_BYTES_MAX {
        return None;
    }
    let bytes = std::fs::read(path).ok()?;
    Some(format!("data:{mime};base64,{}", STANDARD.encode(bytes)))
}
