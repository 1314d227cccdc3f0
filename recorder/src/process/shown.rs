//! The standard topics of a recording, made beside the messages that they show.

use shm_config::config::Config;
use shm_config::layout::Layout as _;
use shm_config::message::{Frame, Health, PixelFormat, Step};
use shm_config::services::{FRAME, Process, STEP, health};

use super::ring::Label;
use crate::Channel;
use crate::standard::{Standard, Topic};
use crate::write::Stamp;

/// Makes the standard topics.
pub(super) struct Shown {
    standard: Standard,
    /// The number of the first one's channel; the others follow.
    first: usize,
    sequences: [u64; Topic::ALL.len()],
    step: Box<Step>,
}

impl Shown {
    /// Adds the topics' channels if the configuration wants them.
    pub(super) fn wanted(
        config: &Config,
        epoch_offset_ns: u64,
        channels: &mut Vec<Channel>,
    ) -> Option<Self> {
        let rate_hz = config.record.standard_hz;
        if rate_hz <= 0.0 {
            return None;
        }
        let first = channels.len();
        channels.extend(Topic::ALL.map(Topic::channel));
        Some(Self {
            standard: Standard::new(config, epoch_offset_ns, rate_hz),
            first,
            sequences: [0; Topic::ALL.len()],
            step: Box::default(),
        })
    }

    /// Gives what follows from a message of a service, if it is due.
    pub(super) fn take(
        &mut self,
        (service, label): (&str, Label),
        memory: &[u8],
        put: &mut dyn FnMut(Label, &[u8]),
    ) {
        let (first, sequences) = (self.first, &mut self.sequences);
        let mut numbered = |topic: Topic, cdr: &[u8]| {
            let number = topic as usize;
            sequences[number] += 1;
            let stamp = Stamp {
                sequence: sequences[number],
                ..label.stamp
            };
            let channel = first + number;
            put(Label { channel, stamp }, cdr);
        };
        if service == STEP.name {
            // Most steps are not due, and copying one costs more than its look.
            if self.standard.is_due(label.stamp.taken_ns) && self.step.copy_from(memory) {
                self.standard.step(&self.step, &mut numbered);
            }
        } else if service == FRAME.name {
            let taken_ns = label.stamp.taken_ns;
            if let Some(picture) = picture(memory) {
                self.standard.frame(taken_ns, picture, &mut numbered);
            }
        } else if service.starts_with("health/")
            && let Some(message) = Health::from_bytes(memory)
        {
            let process = Process::ALL.iter().find(|of| health(**of).name == service);
            if let Some(process) = process {
                self.standard.note(*process, &message);
            }
        }
    }
}

/// Width, height and pixels of a frame in memory; `None` when it holds no whole picture.
/// Field by field: a frame of two megabytes is not copied.
fn picture(memory: &[u8]) -> Option<(u32, u32, &[u8])> {
    let field = |name: &str| {
        let field = Frame::FIELDS.iter().find(|field| field.name == name)?;
        memory.get(field.offset..field.offset + field.size)
    };
    let number = |name: &str| Some(u32::from_le_bytes(field(name)?.try_into().ok()?));
    let (width, height) = (number("width")?, number("height")?);
    let PixelFormat::Rgb8 = PixelFormat::from_code(number("format")?)?;
    let bytes = usize::try_from(Frame::bytes([width, height])).ok()?;
    let pixels = field("pixels")?.get(..bytes)?;
    Some((width, height, pixels))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The memory of a frame that claims this width and height.
    fn claiming(sides: [u32; 2]) -> Vec<u8> {
        let mut memory = vec![0; size_of::<Frame>()];
        for (name, side) in ["width", "height"].into_iter().zip(sides) {
            let field = Frame::FIELDS.iter().find(|field| field.name == name);
            let at = field.expect("a field").offset;
            memory[at..at + 4].copy_from_slice(&side.to_le_bytes());
        }
        memory
    }

    #[test]
    fn a_frame_that_claims_more_pixels_than_it_has_gives_no_picture() {
        let memory = claiming([960, 720]);
        let whole = picture(&memory).map(|(width, height, rgb)| (width, height, rgb.len()));
        assert_eq!(whole, Some((960, 720, 960 * 720 * 3)));
        for sides in [[960, 721], [u32::MAX, 720], [720, u32::MAX], [u32::MAX; 2]] {
            assert_eq!(picture(&claiming(sides)), None, "{sides:?}");
        }
        assert_eq!(picture(&memory[..100]), None);
    }
}
