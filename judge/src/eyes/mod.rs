//! The stand-in's eyes: which of two coloured paths is safer, from the pixels
//! alone.
//!
//! This is no model. It knows the colours of rendered pictures
//! ([`shm_config::palette`]), the cameras they are taken with, and the hues of
//! the paths; nothing else is told to it: no proposal, no lidar, no simulator. It
//! follows each path's pixels from the car outward, moves a car's rectangle along
//! them, and looks at what lies under it.
//!
//! Assumed: the cameras of [`Camera::top_down`] and [`Camera::ego`] for a picture
//! of that size, a car of 4.5 x 1.85 m, and that everything stands still.

mod ground;
mod trace;

use image::RgbImage;
use shm_config::message::{Camera, View};

use crate::{Hue, Reply};
use ground::{Ground, Trouble};

/// Room that a path is first judged with around the car, m, then with the next:
/// where only one of two paths is that close to something, it is the worse one.
const ROOMS_M: [f64; 3] = [0.0, 0.3, 0.6];
/// Paths that end in trouble are alike when their shares of safe length differ by
/// less than this.
const ALIKE: f64 = 0.08;

/// What was seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// Which path is safer.
    pub reply: Reply,
    /// How sure that is, 0 to 1.
    pub confidence: f64,
    /// What each path was found to do, the first one's first.
    pub paths: [Sight; 2],
}

/// What was seen of one path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sight {
    /// Its visible length on the ground, m; 0 when none was found.
    pub length_m: f64,
    /// What comes first on it, if anything.
    pub trouble: Option<Trouble>,
}

impl Sight {
    /// Share of the path before its trouble, [0, 1].
    fn safe_share(&self) -> f64 {
        match self.trouble {
            Some(trouble) => trouble.at_m / self.length_m.max(trouble.at_m).max(0.1),
            None => 1.0,
        }
    }
}

/// Looks at a picture with a path in each of two hues.
pub fn look(image: &RgbImage, hues: [Hue; 2], view: View) -> Sighting {
    let size_px = [image.width(), image.height()];
    let camera = Camera::of(view, size_px);
    let lines = hues.map(|hue| trace::trace(image, hue, &camera));
    let ground = Ground::of(image, view);
    let mut seen = [Sight {
        length_m: 0.0,
        trouble: None,
    }; 2];
    for (step, room_m) in ROOMS_M.into_iter().enumerate() {
        for (sight, line) in seen.iter_mut().zip(&lines) {
            sight.length_m = trace::length_m(line);
            sight.trouble = ground.first_trouble(line, &camera, room_m);
        }
        let [first, second] = seen.map(|sight| sight.trouble.is_some());
        if first != second || first {
            let doubt = 0.15 * step as f64;
            return compare(seen, doubt);
        }
    }
    compare(seen, 0.0)
}

/// The safer of two paths; `doubt` is taken off the confidence.
fn compare(paths: [Sight; 2], doubt: f64) -> Sighting {
    let [first, second] = paths.map(|path| path.safe_share());
    let in_trouble = paths.map(|path| path.trouble.is_some());
    let (reply, confidence) = match in_trouble {
        [false, false] => (Reply::Similar, 0.8),
        [true, false] => (Reply::Second, 0.95 - 0.15 * first),
        [false, true] => (Reply::First, 0.95 - 0.15 * second),
        [true, true] if (first - second).abs() < ALIKE => (Reply::Similar, 0.6),
        [true, true] if first > second => (Reply::First, 0.6 + 0.3 * (first - second)),
        [true, true] => (Reply::Second, 0.6 + 0.3 * (second - first)),
    };
    Sighting {
        reply,
        confidence: (confidence - doubt).max(0.5),
        paths,
    }
}
