//! The stand-in's eyes: which of two coloured paths is safer, from the pixels
//! alone.
//!
//! This is no model. It knows the colours of rendered pictures
//! ([`shm_config::palette`]), the cameras they are taken with, and the hues of
//! the paths; it has nothing else: no proposal, no lidar, no simulator. It
//! follows each path's pixels from the car outward, moves a car's rectangle along
//! them, and looks at what lies under it.
//!
//! Assumed: the cameras of [`Camera::of`] for a picture of that size, a car of
//! 4.5 x 1.85 m, and that everything stands still.

mod ground;
mod trace;

use image::RgbImage;
use shm_config::config;
use shm_config::message::{Camera, View};

use crate::standin::{Eyes, Sighting};
use gate::presentation::{Hue, Reply};
use ground::Ground;
pub use ground::{Kind, Trouble};

/// Room around the car that a path is judged with, m, the first one first: where
/// only one of two paths is in trouble with it, that is the worse one. Negative
/// rooms come first, since a path that runs deep into something is worse than one that
/// brushes it, and a rollout is off by as much.
const ROOMS_M: [f64; 7] = [-0.5, -0.25, 0.0, 0.3, 0.6, 1.0, 1.5];
/// From this room on nothing is touched, and what is said is doubtful.
const FREE: usize = 3;
/// How much less sure one is of a path that touches nothing.
const DOUBT: f64 = 0.2;
/// Paths that end in trouble are alike when their shares of safe length differ by
/// less than this.
const ALIKE: f64 = 0.06;

/// The eyes of the stand-in.
#[derive(Debug, Clone, Copy)]
pub struct Sighted;

impl Eyes for Sighted {
    fn look(&self, picture: &RgbImage, hues: [Hue; 2], view: config::View) -> Sighting {
        look(picture, hues, view.into()).sighting
    }
}

/// What was seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Which path is safer, and how sure that is.
    pub sighting: Sighting,
    /// What each path was found to do, the first one's first.
    pub paths: [Sight; 2],
}

/// What was seen of one path.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
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
pub fn look(image: &RgbImage, hues: [Hue; 2], view: View) -> Seen {
    let camera = Camera::of(view, [image.width(), image.height()]);
    let lines = hues.map(|hue| trace::trace(image, hue, &camera));
    let ground = Ground::of(image, view);
    let mut paths = lines.each_ref().map(|line| Sight {
        length_m: trace::length_m(&line.points_body),
        trouble: None,
    });
    let mut doubt = 0.0;
    for (step, room_m) in ROOMS_M.into_iter().enumerate() {
        for (sight, line) in paths.iter_mut().zip(&lines) {
            sight.trouble = ground.first_trouble(&line.points_body, &camera, room_m);
            // A sharp turn leaves the picture before it leaves the road.
            if step == FREE && line.leaves_view && sight.trouble.is_none() {
                sight.trouble = Some(Trouble {
                    kind: Kind::Edge,
                    at_m: sight.length_m,
                });
            }
        }
        if paths.iter().any(|path| path.trouble.is_some()) {
            doubt = if step < FREE { 0.0 } else { DOUBT };
            break;
        }
    }
    let (reply, confidence) = compare(&paths);
    Seen {
        sighting: Sighting {
            reply,
            confidence: (confidence - doubt).max(0.5),
        },
        paths,
    }
}

/// The safer of two paths, and how sure that is.
fn compare(paths: &[Sight; 2]) -> (Reply, f64) {
    let [first, second] = paths.map(|path| path.safe_share());
    match paths.map(|path| path.trouble.is_some()) {
        [false, false] => (Reply::Similar, 0.8),
        [true, false] => (Reply::Second, 0.98 - 0.1 * first),
        [false, true] => (Reply::First, 0.98 - 0.1 * second),
        [true, true] if (first - second).abs() < ALIKE => (Reply::Similar, 0.6),
        [true, true] if first > second => (Reply::First, 0.6 + 0.3 * (first - second)),
        [true, true] => (Reply::Second, 0.6 + 0.3 * (second - first)),
    }
}
