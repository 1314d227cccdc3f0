//! Places labels so that they overlap neither each other nor the ego's path.

use vehicle::Point;

use super::canvas::{Canvas, HEAD_PX};

/// Estimated width of a letter over the line height; generous, since fonts differ.
const LETTER: f64 = 0.6;
/// Half the width of the strip along the path that stays free, px.
const STRIP_PX: f64 = 3.0;

/// A rectangle in the picture by two corners, px.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Patch {
    left: f64,
    top: f64,
    right: f64,
    bottom: f64,
}

impl Patch {
    /// Area of the overlap of two rectangles, px^2.
    fn shared_px2(&self, other: &Patch) -> f64 {
        let width = self.right.min(other.right) - self.left.max(other.left);
        let height = self.bottom.min(other.bottom) - self.top.max(other.top);
        width.max(0.0) * height.max(0.0)
    }

    fn area_px2(&self) -> f64 {
        (self.right - self.left) * (self.bottom - self.top)
    }
}

/// The areas that are taken already.
pub struct Labels {
    picture: Patch,
    taken: Vec<Patch>,
}

impl Labels {
    /// Reserves the path and these circles (centre, radius in m).
    pub fn beside(canvas: &Canvas, path_world: &[Point], spots: &[(Point, f64)]) -> Labels {
        let [width, height] = canvas.size_px();
        let square = |point: &Point, half_px: f64| {
            let [x, y] = canvas.at(*point);
            Patch {
                left: x - half_px,
                top: y - half_px,
                right: x + half_px,
                bottom: y + half_px,
            }
        };
        let path = path_world.iter().map(|point| square(point, STRIP_PX));
        let scale = canvas.scale_px_per_m();
        let spots = spots
            .iter()
            .map(|(point, radius_m)| square(point, radius_m * scale));
        Labels {
            picture: Patch {
                left: 0.0,
                top: HEAD_PX,
                right: width,
                bottom: HEAD_PX + height,
            },
            taken: path.chain(spots).collect(),
        }
    }

    /// Reserves a place for a text that is centred on it, and returns the place: the one with
    /// the least overlap, the first of equals. `None` if `places_world` is empty.
    pub fn take(
        &mut self,
        canvas: &Canvas,
        places_world: &[Point],
        (text, size_px): (&str, f64),
    ) -> Option<Point> {
        let half_width = text.chars().count() as f64 * size_px * LETTER / 2.0;
        let patch = |place: &Point| {
            let [x, y] = canvas.at(*place);
            Patch {
                left: x - half_width,
                top: y - size_px * 0.6,
                right: x + half_width,
                bottom: y + size_px * 0.6,
            }
        };
        let covered = |patch: &Patch| -> f64 {
            let others = self.taken.iter().map(|other| other.shared_px2(patch));
            let outside = patch.area_px2() - self.picture.shared_px2(patch);
            others.sum::<f64>() + outside
        };
        let (place, patch, _) = places_world
            .iter()
            .map(|place| (*place, patch(place)))
            .map(|(place, patch)| (place, patch, covered(&patch)))
            .min_by(|a, b| a.2.total_cmp(&b.2))?;
        self.taken.push(patch);
        Some(place)
    }
}
