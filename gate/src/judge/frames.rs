//! The world's pictures of a question's scene.

use std::time::Duration;

use shm_config::config::{Config, View, Vlm};
use shm_config::message::{Camera, Foresight, Frame, FrameRequest, Header, View as Seat};
use shm_config::services::Process;
use shm_config::wire::{Wire, WireError};
use shm_config::{Instant, Message};

use crate::ports::PicturePorts;
use crate::presentation::Party;
use crate::presentation::picture::Photo;
use crate::query::Question;
use crate::record::Outlook;

/// Interval at which questions and frames are polled. A model takes a hundred times as
/// long, and 200 polls a second cost well under a hundredth of a core.
pub const POLL: Duration = Duration::from_millis(5);
/// How long to wait for a frame, ns. A world with a camera draws it within some ms.
const FRAME_NS: u64 = 1_000_000_000;
/// How long to wait for the simulator's foresight after the frame, ns. It follows the
/// frame immediately, or there is none.
const FORESIGHT_NS: u64 = 200_000_000;

/// The judge thread's own membership in the run, with its ports.
pub struct Frames {
    ports: PicturePorts,
    _wire: Wire,
}

impl Frames {
    /// Joins the run.
    ///
    /// # Errors
    /// When the run or one of its services cannot be opened.
    pub fn open(config: &Config) -> Result<Self, WireError> {
        let failed =
            |error: shm_config::run::InvalidRunName| WireError::port("run", error.to_string());
        let wire = runtime::join_as(&config.run.name.parse().map_err(failed)?, Process::Gate)?;
        Ok(Self {
            ports: PicturePorts::open(&wire)?,
            _wire: wire,
        })
    }

    /// Updates the connections to restarted peers.
    pub fn update_connections(&mut self) {
        self.ports.update_connections();
    }
}

/// A question's scene as the world drew it.
pub struct Scene {
    /// The frame; `None` if none arrived in time.
    pub shot: Option<Shot>,
    /// What the simulator foresees for the expert's and the policy's proposal.
    pub foresight: Option<[Outlook; 2]>,
}

/// A frame, copied out of shared memory.
pub struct Shot {
    camera: Camera,
    width: u32,
    height: u32,
    rgb: Vec<u8>,
}

impl Shot {
    fn of(frame: &Frame) -> Self {
        Self {
            camera: frame.camera,
            width: frame.width,
            height: frame.height,
            rgb: frame.rgb().to_vec(),
        }
    }

    /// The photo to draw into.
    pub fn photo(&self) -> Photo<'_> {
        Photo {
            camera: &self.camera,
            width: self.width,
            height: self.height,
            rgb: &self.rgb,
        }
    }

    /// The view that the frame shows. It may differ from the requested one, because
    /// MetaDrive has a single view.
    pub fn view(&self) -> View {
        match self.camera.orthographic {
            0 => View::Ego,
            _ => View::TopDown,
        }
    }
}

impl Frames {
    /// Requests the frame of the question's tick from the world and waits for it.
    pub async fn see(&mut self, question: &Question, vlm: &Vlm, clock: fn() -> Instant) -> Scene {
        let header = question.observation.header;
        self.update_connections();
        self.ports.requests.send(&mut request(question, vlm));
        let mut until = clock().after_ns(FRAME_NS);
        let mut scene = Scene {
            shot: None,
            foresight: None,
        };
        let is_same = |other: &Header| (other.episode, other.tick) == question.id().key();
        while clock() < until && (scene.shot.is_none() || scene.foresight.is_none()) {
            self.update_connections();
            let shot = self.ports.frames.visit(|frame| {
                let fits = is_of(&frame.header, &header) && frame.check().is_ok();
                fits.then(|| Shot::of(frame))
            });
            if let Some(Some(shot)) = shot {
                scene.shot = Some(shot);
                until = clock().after_ns(FORESIGHT_NS);
            }
            let foresight = self.ports.foresights.newest(Message::check);
            let foresight = foresight.filter(|foresight| is_same(&foresight.header));
            scene.foresight = scene.foresight.or(foresight.as_ref().map(outlooks));
            tokio::time::sleep(POLL).await;
        }
        scene
    }
}

fn request(question: &Question, vlm: &Vlm) -> FrameRequest {
    let header = question.observation.header;
    FrameRequest {
        header: Header {
            tick: header.tick,
            taken_ns: header.taken_ns,
            episode: header.episode,
            ..Header::default()
        },
        view: Seat::from(vlm.view).code(),
        width: vlm.width_px,
        height: vlm.height_px,
        proposals: [question.expert, question.policy],
        ..FrameRequest::default()
    }
}

/// Whether the frame shows the question's scene: its tick, or a tick soon after it
/// where the world draws the current scene, as MetaDrive does.
fn is_of(frame: &Header, question: &Header) -> bool {
    frame.episode == question.episode
        && frame.tick >= question.tick
        && frame.taken_ns.saturating_sub(question.taken_ns) <= FRAME_NS
}

fn outlooks(foresight: &Foresight) -> [Outlook; 2] {
    let parties = [Party::Expert, Party::Policy];
    std::array::from_fn(|k| Outlook {
        party: parties[k],
        horizon_s: foresight.horizon_s,
        contact_s: foresight.outlooks[k].contact_s,
        out_s: foresight.outlooks[k].out_s,
    })
}
