//! The rules of the stand-in: decides which of two coloured paths is safer from the
//! pixels of a picture.
//!
//! This is not a model. It knows the colours of rendered pictures
//! ([`shm_config::palette`]), the cameras, and the colours of the paths; it has no
//! access to the proposals, the lidar or the simulator. It follows each path's pixels
//! from the car outward, moves a car's rectangle along them, and classifies the pixels
//! under it.
//!
//! It assumes the cameras of [`Camera::of`] for a picture of that size, a car of
//! 4.5 x 1.85 m, and that all bodies stand still.

mod ground;
mod trace;

use image::RgbImage;
use shm_config::config;
use shm_config::message::{Camera, View};

use crate::standin::{PathRater, Rating};
use gate::presentation::{Hue, Reply};
use ground::Ground;
pub use ground::{Kind, Obstacle};

/// Safety margins around the car, m, in the order of their use: the first margin at which
/// only one of the two paths meets an obstacle decides. Negative margins come first,
/// since a path that runs deep into an obstacle is worse than one that touches its edge,
/// and a rollout has errors of that size.
const MARGINS_M: [f64; 7] = [-0.5, -0.25, 0.0, 0.3, 0.6, 1.0, 1.5];
/// From this margin on the car touches nothing, and the decision is uncertain.
const CLEAR: usize = 3;
/// Reduction of the confidence if no path touches anything.
const UNCERTAINTY: f64 = 0.2;
/// Paths with an obstacle count as similar if their shares of safe length differ by less
/// than this.
const SIMILAR_MAX: f64 = 0.06;

/// The rules of this module.
#[derive(Debug, Clone, Copy)]
pub struct PixelRules;

impl PathRater for PixelRules {
    fn rate(&self, picture: &RgbImage, hues: [Hue; 2], view: config::View) -> Rating {
        rate(picture, hues, view.into()).rating
    }
}

/// Rating of the two paths of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PictureRating {
    /// The safer path, with the confidence.
    pub rating: Rating,
    /// What was found on each path, in the order of the prompt.
    pub paths: [PathRating; 2],
}

/// What was found on one path.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PathRating {
    /// Visible length on the ground, m; 0 if the path was not found.
    pub length_m: f64,
    /// The first obstacle on it.
    pub obstacle: Option<Obstacle>,
}

impl PathRating {
    /// Share of the path before the obstacle, [0, 1].
    fn safe_share(&self) -> f64 {
        match self.obstacle {
            Some(obstacle) => obstacle.at_m / self.length_m.max(obstacle.at_m).max(0.1),
            None => 1.0,
        }
    }
}

/// Rates the paths of two hues in a picture.
pub fn rate(image: &RgbImage, hues: [Hue; 2], view: View) -> PictureRating {
    let camera = Camera::of(view, [image.width(), image.height()]);
    let lines = hues.map(|hue| trace::trace(image, hue, &camera));
    let ground = Ground::of(image, view);
    let mut paths = lines.each_ref().map(|line| PathRating {
        length_m: trace::length_m(&line.points_body),
        obstacle: None,
    });
    let mut doubt = 0.0;
    for (step, margin_m) in MARGINS_M.into_iter().enumerate() {
        for (sight, line) in paths.iter_mut().zip(&lines) {
            sight.obstacle = ground.first_obstacle(&line.points_body, &camera, margin_m);
            // A sharp turn leaves the picture before it leaves the road.
            if step == CLEAR && line.leaves_view && sight.obstacle.is_none() {
                sight.obstacle = Some(Obstacle {
                    kind: Kind::Edge,
                    at_m: sight.length_m,
                });
            }
        }
        if paths.iter().any(|path| path.obstacle.is_some()) {
            doubt = if step < CLEAR { 0.0 } else { UNCERTAINTY };
            break;
        }
    }
    let (reply, confidence) = compare(&paths);
    PictureRating {
        rating: Rating {
            reply,
            confidence: (confidence - doubt).max(0.5),
        },
        paths,
    }
}

/// The safer of two paths, with the confidence.
fn compare(paths: &[PathRating; 2]) -> (Reply, f64) {
    let [first, second] = paths.map(|path| path.safe_share());
    match paths.map(|path| path.obstacle.is_some()) {
        [false, false] => (Reply::Similar, 0.8),
        [true, false] => (Reply::Second, 0.98 - 0.1 * first),
        [false, true] => (Reply::First, 0.98 - 0.1 * second),
        [true, true] if (first - second).abs() < SIMILAR_MAX => (Reply::Similar, 0.6),
        [true, true] if first > second => (Reply::First, 0.6 + 0.3 * (first - second)),
        [true, true] => (Reply::Second, 0.6 + 0.3 * (second - first)),
    }
}
