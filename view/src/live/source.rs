//! What a page shows: a living run, or a recording.

use std::path::Path;
use std::sync::Arc;

use axum::http::StatusCode;
use bytes::Bytes;
use shm_config::config;
use shm_config::file::read_ours;
use shm_config::run::{RunName, RunPaths};

use super::fleet::Fleet;
use super::guard::Refused;
use super::hub::Hub;
use super::reader::Wanted;
use super::server::json;
use super::status::{RunFolder, is_picture};
use super::tape::Tape;
use super::tree::search;

/// Longest picture that is sent, bytes: one of the largest frame without compression.
const PICTURE_BYTES_MAX: u64 = 8 << 20;

/// An answer: its type, and its content.
pub type Told = Result<(&'static str, Bytes), Refused>;

const WITHOUT_TICK: Refused = (StatusCode::BAD_REQUEST, "the request names no tick\n");
const DAMAGED: Refused = (
    StatusCode::UNPROCESSABLE_ENTITY,
    "the recording is damaged there\n",
);
const NOTHING: Refused = (StatusCode::NOT_FOUND, "there is nothing here\n");
const NO_RUN: Refused = (
    StatusCode::NOT_FOUND,
    "no run of this name lives, or too many runs are open\n",
);

/// What a page shows.
#[derive(Debug)]
pub enum Source {
    /// A living run, by name or by folder.
    Live(Arc<Hub>, Wanted),
    /// A recording.
    Recorded(Arc<Tape>),
    /// All living runs of the user.
    Fleet(Arc<Fleet>),
}

/// What a path of a request leads to.
#[derive(Debug)]
pub enum Place<'a> {
    /// The path below this source's page.
    Below(Arc<Source>, &'a str),
    /// A page whose path lacks the slash at its end.
    WithoutSlash,
}

impl Source {
    /// Of a living run, what its reader has read.
    pub fn hub(&self) -> Option<&Arc<Hub>> {
        match self {
            Self::Live(hub, _) => Some(hub),
            Self::Recorded(_) => None,
            Self::Fleet(fleet) => Some(&fleet.hub),
        }
    }

    /// The name of the page's own file.
    pub fn page(&self) -> &'static str {
        match self {
            Self::Live(..) | Self::Recorded(_) => "",
            Self::Fleet(_) => "fleet.html",
        }
    }

    /// Where a path leads: of all runs, `run/NAME/` leads to the page of one.
    ///
    /// # Errors
    /// When the name is none, or no run has it.
    pub fn place<'a>(self: &Arc<Self>, path: &'a str) -> Result<Place<'a>, Refused> {
        let Self::Fleet(fleet) = &**self else {
            return Ok(Place::Below(self.clone(), path));
        };
        let Some(below) = path.strip_prefix("run/") else {
            return Ok(Place::Below(self.clone(), path));
        };
        let (name, rest) = match below.split_once('/') {
            Some((name, rest)) => (name, Some(rest)),
            None => (below, None),
        };
        // The name becomes part of a path only after this check.
        let name: RunName = name.parse().map_err(|_| NOTHING)?;
        let entry = fleet.open(&name).ok_or(NO_RUN)?;
        Ok(match rest {
            Some(rest) => {
                let run = Self::Live(entry.hub.clone(), Wanted::Named(name));
                Place::Below(Arc::new(run), rest)
            }
            None => Place::WithoutSlash,
        })
    }

    /// The answer to a path; it may read files and take some milliseconds.
    ///
    /// # Errors
    /// When there is nothing at the path.
    pub fn tell(&self, path: &str, query: &str) -> Told {
        match (self, path) {
            (Self::Live(hub, _), "hello") => Ok(json(hub.hello().to_string())),
            (Self::Live(hub, _), "frames") => {
                let from = number(query, "from").ok_or(WITHOUT_TICK)?;
                Ok(json(hub.frames(from, count_in(query))))
            }
            (Self::Live(hub, wanted), "tree") => live_tree(hub, wanted),
            (Self::Live(_, wanted), path) => match path.strip_prefix("picture/") {
                Some(name) => live_picture(wanted, name),
                None => Err(NOTHING),
            },
            (Self::Recorded(tape), path) => recorded(tape, path, query),
            (Self::Fleet(fleet), "hello") => Ok(json(fleet.hub.hello().to_string())),
            (Self::Fleet(_), _) => Err(NOTHING),
        }
    }
}

fn recorded(tape: &Tape, path: &str, query: &str) -> Told {
    let tick = || number(query, "tick").ok_or(WITHOUT_TICK);
    match path {
        "hello" => Ok(json(tape.hello())),
        "overview" => Ok(json(tape.overview())),
        "frames" => {
            let from = number(query, "from").ok_or(WITHOUT_TICK)?;
            let stride = number(query, "stride").unwrap_or(1);
            tape.frames(from, count_in(query), stride)
                .map(json)
                .map_err(|_| DAMAGED)
        }
        "status" => tape
            .status(tick()?)
            .map_err(|_| DAMAGED)?
            .map(json)
            .ok_or(NOTHING),
        "tree" => {
            let tree = tape.tree(tick()?).map_err(|_| DAMAGED)?.ok_or(NOTHING)?;
            serde_json::to_string(&tree).map(json).map_err(|_| NOTHING)
        }
        path => {
            let name = path.strip_prefix("picture/").ok_or(NOTHING)?;
            let is_ours = is_picture(name);
            let bytes = is_ours.then(|| tape.picture(name)).ok_or(NOTHING)?;
            Ok(shown(bytes.map_err(|_| DAMAGED)?.ok_or(NOTHING)?))
        }
    }
}

/// A number of a request, such as `from=12&count=3`; `None` when it is missing or none.
fn number(query: &str, name: &str) -> Option<u64> {
    let mut pairs = query.split('&').filter_map(|pair| pair.split_once('='));
    let (_, value) = pairs.find(|(key, _)| *key == name)?;
    value.parse().ok()
}

/// How many scenes a request wants.
fn count_in(query: &str) -> usize {
    let count = number(query, "count").unwrap_or(1);
    usize::try_from(count).unwrap_or(usize::MAX)
}

/// Plans for the newest step again.
fn live_tree(hub: &Hub, wanted: &Wanted) -> Told {
    let (paths, _) = living(wanted)?;
    let config = config::load(&paths.config_file()).map_err(|_| NOTHING)?;
    let step = hub.step().ok_or(NOTHING)?;
    let tree = search(&config, &step).map_err(|_| NOTHING)?;
    serde_json::to_string(&tree).map(json).map_err(|_| NOTHING)
}

fn living(wanted: &Wanted) -> Result<(RunPaths, u32), Refused> {
    wanted.find().ok().flatten().ok_or(NOTHING)
}

fn live_picture(wanted: &Wanted, name: &str) -> Told {
    let (paths, _) = living(wanted)?;
    let origin = paths.origin().ok_or(NOTHING)?;
    picture(&RunFolder::new(&origin.folder).pictures(), name)
}

/// A judge's picture of this name.
fn picture(folder: &Path, name: &str) -> Told {
    if !is_picture(name) {
        return Err(NOTHING);
    }
    let bytes = read_ours(&folder.join(name), PICTURE_BYTES_MAX).map_err(|_| NOTHING)?;
    Ok(shown(bytes))
}

/// A picture with its type.
fn shown(bytes: Vec<u8>) -> (&'static str, Bytes) {
    let media_type = match bytes.starts_with(b"\x89PNG") {
        true => "image/png",
        false => "image/jpeg",
    };
    (media_type, bytes.into())
}
