use image::RgbImage;
use shm_config::config::View;

use gate::presentation::{Hue, Reply};

/// Rating of the two paths of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rating {
    /// The safer path; first and second as the prompt names them.
    pub reply: Reply,
    /// Confidence, 0 to 1.
    pub confidence: f64,
}

/// Compares two coloured paths in a picture by its pixels.
pub trait PathRater: Send + Sync {
    /// Compares the paths of the two colours.
    fn rate(&self, picture: &RgbImage, hues: [Hue; 2], view: View) -> Rating;
}

impl<F> PathRater for F
where
    F: Fn(&RgbImage, [Hue; 2], View) -> Rating + Send + Sync,
{
    fn rate(&self, picture: &RgbImage, hues: [Hue; 2], view: View) -> Rating {
        self(picture, hues, view)
    }
}

/// A minimal rule for tests, without knowledge of roads: it prefers the path whose far
/// end, its topmost pixel, is nearer to the middle of the picture's width.
#[derive(Debug, Clone, Copy)]
pub struct MiddleRule;

/// Maximum distance of a colour channel from the drawn colour: JPEG and smooth edges shift
/// it, and no two hues are this close.
const CHANNEL_APART_MAX: u8 = 60;

/// Paths are similar if the distances of their ends from the middle differ by less than
/// this share of the width.
const SIMILAR_MAX: f64 = 0.03;

impl PathRater for MiddleRule {
    fn rate(&self, picture: &RgbImage, hues: [Hue; 2], _: View) -> Rating {
        let [first, second] = hues.map(|hue| off_middle(picture, hue));
        let (reply, confidence) = match (first, second) {
            (Some(first), Some(second)) if (first - second).abs() < SIMILAR_MAX => {
                (Reply::Similar, 0.5)
            }
            (Some(first), Some(second)) => {
                let reply = match first < second {
                    true => Reply::First,
                    false => Reply::Second,
                };
                (reply, (0.5 + (first - second).abs()).min(1.0))
            }
            // A missing path cannot be compared.
            _ => (Reply::Similar, 0.0),
        };
        Rating { reply, confidence }
    }
}

/// Distance of a colour's topmost pixels from the middle, as a share of the width; `None`
/// without such pixels.
fn off_middle(picture: &RgbImage, hue: Hue) -> Option<f64> {
    let width = f64::from(picture.width());
    let is_near = |pixel: &image::Rgb<u8>| {
        let channels = pixel.0.iter().zip(hue.rgb());
        channels
            .map(|(channel, drawn)| channel.abs_diff(drawn))
            .all(|apart| apart <= CHANNEL_APART_MAX)
    };
    picture.rows().find_map(|row| {
        let columns = (0_u32..).zip(row).filter(|(_, pixel)| is_near(pixel));
        let (sum, count) = columns.fold((0.0, 0_u32), |(sum, count), (column, _)| {
            (sum + f64::from(column) + 0.5, count + 1)
        });
        (count > 0).then(|| (sum / f64::from(count) / width - 0.5).abs())
    })
}
