//! The picture of a question: both rollouts, drawn into the frame of its tick as a
//! [`Showing`] defines.

mod letters;
mod paths;
mod pencil;
mod rollout;

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, RgbImage};
use shm_config::config::{PictureFormat, Rollout, Vlm};
use shm_config::message::{Camera, Frame};
use vehicle::{Action, Vehicle};

use super::Showing;
use crate::query::Question;
pub use paths::LINE;
pub use rollout::roll_out;

/// How the picture of a question is drawn and stored.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Style {
    /// How the paths are integrated.
    pub rollout: Rollout,
    /// How long each proposal is held, s.
    pub horizon_s: f64,
    /// Width and height of the picture, pixels; `None` for the frame's own.
    pub size_px: Option<[u32; 2]>,
    /// PNG or JPEG.
    pub encoding: Encoding,
    /// Draw the car's outline at the end of each path.
    pub footprint: bool,
    /// Show in a corner which letter has which colour.
    pub legend: bool,
}

impl Default for Style {
    fn default() -> Self {
        Self {
            rollout: Rollout::Accurate,
            horizon_s: 3.0,
            size_px: None,
            encoding: Encoding::Png,
            footprint: true,
            legend: true,
        }
    }
}

impl Style {
    /// The configured style. Frames arrive in the configured size, so only the frames
    /// of a world with its own picture size are scaled.
    pub fn of(vlm: &Vlm) -> Self {
        Self {
            rollout: vlm.rollout,
            horizon_s: vlm.horizon_s,
            size_px: Some([vlm.width_px, vlm.height_px]),
            encoding: match vlm.format {
                PictureFormat::Png => Encoding::Png,
                PictureFormat::Jpeg => Encoding::Jpeg,
            },
            ..Self::default()
        }
    }
}

/// JPEG quality, 1 to 100: the file is a fifth of the PNG, and paths keep their colour.
const JPEG_QUALITY: u8 = 85;

/// How a picture is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// PNG: lossless.
    Png,
    /// JPEG: smaller and blurred.
    Jpeg,
}

impl Encoding {
    /// The MIME type.
    pub fn mime(self) -> &'static str {
        match self {
            Self::Png => "image/png",
            Self::Jpeg => "image/jpeg",
        }
    }

    /// The extension of its files, without the dot.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Jpeg => "jpg",
        }
    }
}

/// A picture as it is stored and sent.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// The file's bytes.
    pub bytes: Vec<u8>,
    /// The format of the file.
    pub encoding: Encoding,
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
}

/// Why there is no picture.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PictureError {
    /// A proposal is missing: there is nothing to compare.
    #[error("one of the two proposals is missing: nothing to compare")]
    Absent,
    /// The frame has fewer pixels than its size needs, or none.
    #[error(
        "a frame of {width} x {height} pixels has too few bytes or no pixel: it must have at least 1 x 1"
    )]
    Misfit {
        /// Pixels across.
        width: u32,
        /// Pixels down.
        height: u32,
    },
    /// The size of the picture is out of range.
    #[error("a picture of {width} x {height} pixels: each side must have 64 to 4096 pixels")]
    Size {
        /// Pixels across.
        width: u32,
        /// Pixels down.
        height: u32,
    },
    /// The encoder failed; it writes only to memory.
    #[error("the picture cannot be encoded as {0}")]
    Encoder(&'static str),
}

/// A picture of the scene with the camera that took it.
#[derive(Debug, Clone, Copy)]
pub struct Photo<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Red, green, blue; row by row from the top. The slice may be longer.
    pub rgb: &'a [u8],
}

impl<'a> From<&'a Frame> for Photo<'a> {
    fn from(frame: &'a Frame) -> Self {
        Self {
            camera: &frame.camera,
            width: frame.width,
            height: frame.height,
            rgb: &frame.pixels,
        }
    }
}

/// Both proposals of a question, and the state from which they are rolled out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Proposals<'a> {
    /// The car.
    pub vehicle: &'a Vehicle,
    /// Its speed, m/s.
    pub speed_mps: f64,
    /// What the expert proposed.
    pub expert: Action,
    /// What the policy proposed.
    pub policy: Action,
}

impl<'a> Proposals<'a> {
    /// The proposals of a question.
    ///
    /// # Errors
    /// [`PictureError::Absent`] when one of them is missing.
    pub fn of(question: &Question, vehicle: &'a Vehicle) -> Result<Self, PictureError> {
        let both = (question.expert.action(), question.policy.action());
        let (Some(expert), Some(policy)) = both else {
            return Err(PictureError::Absent);
        };
        Ok(Self {
            vehicle,
            speed_mps: question.observation.ego.speed_mps,
            expert,
            policy,
        })
    }
}

/// The picture of both proposals in a photo, as `showing` defines. The same input gives
/// the same bytes.
///
/// # Errors
/// When the photo has too few pixels or the size is out of range.
pub fn picture(
    photo: Photo,
    proposals: &Proposals,
    showing: Showing,
    style: &Style,
) -> Result<Picture, PictureError> {
    encode(&draw(photo, proposals, showing, style)?, style.encoding)
}

/// As [`picture`], not yet encoded.
///
/// # Errors
/// As [`picture`].
pub fn draw(
    photo: Photo,
    proposals: &Proposals,
    showing: Showing,
    style: &Style,
) -> Result<RgbImage, PictureError> {
    let scene = scene(photo, style)?;
    let scale = [
        f64::from(scene.width()) / f64::from(photo.width),
        f64::from(scene.height()) / f64::from(photo.height),
    ];
    let (width, height) = scene.dimensions();
    let misfit = PictureError::Size { width, height };
    let mut pencil = pencil::Pencil::on(&scene).ok_or(misfit)?;
    let paths = paths::Paths::new((photo.camera, scale), proposals, showing, style);
    paths.draw(&mut pencil, style);
    Ok(pencil.finish())
}

/// The photo as an image of the configured size.
fn scene(photo: Photo, style: &Style) -> Result<RgbImage, PictureError> {
    let (width, height) = (photo.width, photo.height);
    let misfit = PictureError::Misfit { width, height };
    let bytes = u128::from(width) * u128::from(height) * 3;
    if bytes == 0 || bytes > photo.rgb.len() as u128 {
        return Err(misfit);
    }
    let pixels = photo.rgb[..bytes as usize].to_vec();
    let image = RgbImage::from_raw(width, height, pixels).ok_or(misfit)?;
    match style.size_px {
        None => Ok(image),
        Some(size_px) if size_px == [width, height] => Ok(image),
        Some([width, height]) => {
            let sides = 64..=4096;
            if !sides.contains(&width) || !sides.contains(&height) {
                return Err(PictureError::Size { width, height });
            }
            // The paths are drawn after scaling, and stay sharp.
            let filter = image::imageops::FilterType::Triangle;
            Ok(image::imageops::resize(&image, width, height, filter))
        }
    }
}

/// Encodes an image.
///
/// # Errors
/// When the encoder fails, as it does for an image without pixels.
pub fn encode(image: &RgbImage, encoding: Encoding) -> Result<Picture, PictureError> {
    let (width, height) = image.dimensions();
    let mut bytes = Vec::new();
    let color = ExtendedColorType::Rgb8;
    let written = match encoding {
        Encoding::Png => {
            PngEncoder::new_with_quality(&mut bytes, CompressionType::Default, FilterType::Adaptive)
                .write_image(image, width, height, color)
        }
        Encoding::Jpeg => JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY)
            .write_image(image, width, height, color),
    };
    match written {
        Ok(()) => Ok(Picture {
            bytes,
            encoding,
            width,
            height,
        }),
        Err(_) => Err(PictureError::Encoder(encoding.mime())),
    }
}
