use image::RgbImage;
use shm_config::config::View;

use gate::presentation::{Hue, Reply};

/// What eyes made of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// Which of the two paths is safer, in the order the prompt names them.
    pub reply: Reply,
    /// How sure they are, 0 to 1.
    pub confidence: f64,
}

/// Compares two coloured paths in a picture, by its pixels alone.
pub trait Eyes: Send + Sync {
    /// Compares the paths of the two colours.
    fn look(&self, picture: &RgbImage, hues: [Hue; 2], view: View) -> Sighting;
}

impl<F> Eyes for F
where
    F: Fn(&RgbImage, [Hue; 2], View) -> Sighting + Send + Sync,
{
    fn look(&self, picture: &RgbImage, hues: [Hue; 2], view: View) -> Sighting {
        self(picture, hues, view)
    }
}

/// Eyes that know nothing of roads: they prefer the path whose far end, the
/// topmost of its pixels, is nearer to the middle of the picture's width. Enough
/// to test everything around them.
#[derive(Debug, Clone, Copy)]
pub struct Middle;

/// How far a channel may be from the colour that was drawn: JPEG and smooth
/// edges move it, and no two hues are this close.
const CHANNEL_APART_MAX: u8 = 60;

/// Ends this much of the width apart, as seen from the middle, are alike.
const ALIKE: f64 = 0.03;

impl Eyes for Middle {
    fn look(&self, picture: &RgbImage, hues: [Hue; 2], _: View) -> Sighting {
        let [first, second] = hues.map(|hue| off_middle(picture, hue));
        let (reply, confidence) = match (first, second) {
            (Some(first), Some(second)) if (first - second).abs() < ALIKE => (Reply::Similar, 0.5),
            (Some(first), Some(second)) => {
                let reply = match first < second {
                    true => Reply::First,
                    false => Reply::Second,
                };
                (reply, (0.5 + (first - second).abs()).min(1.0))
            }
            // A path that is not there cannot be compared.
            _ => (Reply::Similar, 0.0),
        };
        Sighting { reply, confidence }
    }
}

/// How far the topmost pixels of a colour are from the middle, as a share of the
/// width; `None` where there are none.
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
