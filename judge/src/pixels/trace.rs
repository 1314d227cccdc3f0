//! Follows a coloured line in a picture from the car outward.

use std::collections::VecDeque;

use image::RgbImage;
use nalgebra::{Matrix3, Vector3};
use shm_config::message::Camera;
use shm_config::palette::distance;
use vehicle::{Point, Vector};

use gate::presentation::Hue;
use gate::presentation::picture::LINE;

/// Maximum distance of a pixel's colour from the hue: a little less than half the distance
/// between two hues; JPEG shifts the colours of thin lines.
const HUE_TOLERANCE: f64 = 52.0;
/// Distance between points of a line on the ground, m.
const SPACING_M: f64 = 0.5;
/// Maximum distance of a line's begin from the car, as a share of the picture's size.
const BEGIN_SHARE: f64 = 0.3;

/// A path that was followed in the picture.
#[derive(Debug, Default)]
pub struct Line {
    /// Points on the ground from the car outward, m, in the body frame; empty if no path
    /// was found.
    pub points_body: Vec<Point>,
    /// Whether it ends at the left or right edge of the picture, so that its rest is unknown.
    pub leaves_view: bool,
}

/// Follows the path of a hue from the car outward.
pub fn trace(image: &RgbImage, hue: Hue, camera: &Camera) -> Line {
    let Some(body_from_pixel) = ground_from_pixel(camera) else {
        return Line::default();
    };
    let layers = layers(image, hue, begin(image, camera));
    let width = f64::from(image.width());
    let rim_px = f64::from(LINE) * width;
    let leaves_view = layers
        .last()
        .is_some_and(|[u, _]| *u < rim_px || *u > width - rim_px);
    let places = layers.into_iter().filter_map(|[u, v]| {
        let at = body_from_pixel * Vector3::new(u, v, 1.0);
        let place = Point::new(at.x / at.z, at.y / at.z);
        // A pixel above the horizon shows no ground.
        (at.z.abs() > 1e-12 && camera.is_ahead([place.x, place.y, 0.0])).then_some(place)
    });
    Line {
        points_body: thin(places),
        leaves_view,
    }
}

/// Length of a line, m.
pub fn length_m(line: &[Point]) -> f64 {
    line.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum()
}

/// The homography from pixels to ground points in the body frame; `None` for a camera
/// whose view is parallel to the ground.
fn ground_from_pixel(camera: &Camera) -> Option<Matrix3<f64>> {
    let at = |row: usize, column: usize| camera.pixel_from_body[row * 4 + column];
    Matrix3::from_fn(|row, column| at(row, if column == 2 { 3 } else { column })).try_inverse()
}

/// The pixel at which a path begins: that of the car, or, if that is not in view, the
/// middle of the lower edge.
fn begin(image: &RgbImage, camera: &Camera) -> [f64; 2] {
    let (width, height) = (f64::from(image.width()), f64::from(image.height()));
    match camera.project([0.0, 0.0, 0.0]) {
        Some([u, v]) if (0.0..width).contains(&u) && (0.0..height).contains(&v) => [u, v],
        Some(_) | None => [width / 2.0, height],
    }
}

/// Pixels well inside a line of the hue, row by row. The outline of the car at the end
/// of a path has its colour, too; its strokes are half as wide and vanish when their
/// edges are removed.
fn mask(image: &RgbImage, hue: Hue) -> Vec<bool> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let all: Vec<bool> = image
        .pixels()
        .map(|pixel| distance(pixel.0, hue.rgb()) < HUE_TOLERANCE)
        .collect();
    let line_px = LINE * width.min(height) as f32;
    let rim = ((line_px - 1.0) / 3.0).max(1.0) as usize;
    let inside = |x: usize, y: usize| {
        let near = |at: usize, end: usize| at.saturating_sub(rim)..=(at + rim).min(end - 1);
        near(y, height).all(|y| near(x, width).all(|x| all[y * width + x]))
    };
    let inner: Vec<bool> = (0..width * height)
        .map(|at| all[at] && inside(at % width, at / width))
        .collect();
    // In small pictures lines consist of edge pixels only.
    if inner.contains(&true) { inner } else { all }
}

/// Centres of the line's cross-sections: pixels of the hue grouped by the number of
/// steps from the pixel nearest to the car.
fn layers(image: &RgbImage, hue: Hue, [begin_u, begin_v]: [f64; 2]) -> Vec<[f64; 2]> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let mask = mask(image, hue);
    let is_hue = |x: usize, y: usize| mask[y * width + x];
    let away = |x: usize, y: usize| (x as f64 + 0.5 - begin_u).hypot(y as f64 + 0.5 - begin_v);
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let nearest = pixels
        .filter(|&(x, y)| is_hue(x, y))
        .min_by(|a, b| away(a.0, a.1).total_cmp(&away(b.0, b.1)));
    let reach = BEGIN_SHARE * width.min(height) as f64;
    let Some((x, y)) = nearest.filter(|&(x, y)| away(x, y) < reach) else {
        return Vec::new();
    };
    let mut sums: Vec<[f64; 3]> = Vec::new();
    let mut met = vec![false; width * height];
    met[y * width + x] = true;
    let mut waiting = VecDeque::from([(x, y, 0)]);
    while let Some((x, y, steps)) = waiting.pop_front() {
        if sums.len() <= steps {
            sums.push([0.0; 3]);
        }
        let sum = &mut sums[steps];
        *sum = [
            sum[0] + x as f64 + 0.5,
            sum[1] + y as f64 + 0.5,
            sum[2] + 1.0,
        ];
        for (dx, dy) in [
            (-1, -1),
            (0, -1),
            (1, -1),
            (-1, 0),
            (1, 0),
            (-1, 1),
            (0, 1),
            (1, 1),
        ] {
            let (Some(x), Some(y)) = (x.checked_add_signed(dx), y.checked_add_signed(dy)) else {
                continue;
            };
            if x < width && y < height && !met[y * width + x] && is_hue(x, y) {
                met[y * width + x] = true;
                waiting.push_back((x, y, steps + 1));
            }
        }
    }
    sums.into_iter().map(|[u, v, n]| [u / n, v / n]).collect()
}

/// Resamples a line with many small steps at equal spacing.
fn thin(places: impl Iterator<Item = Point>) -> Vec<Point> {
    let mut line: Vec<Point> = Vec::new();
    for place in places {
        match line.last() {
            Some(last) if (place - last).norm() < SPACING_M => {}
            Some(_) | None => line.push(place),
        }
    }
    line
}

/// Points every `step_m` along a line, with its length so far and its direction.
pub fn stations(line: &[Point], step_m: f64) -> Vec<(f64, Point, Vector)> {
    let mut stations = Vec::new();
    let mut behind_m = 0.0;
    for (at, pair) in line.windows(2).enumerate() {
        let length_m = (pair[1] - pair[0]).norm();
        // Use the direction of a longer piece: single points are off by up to a pixel.
        let from = line[at.saturating_sub(2)];
        let to = line[(at + 3).min(line.len() - 1)];
        let along = (to - from).try_normalize(1e-9).unwrap_or(Vector::x());
        let count = (length_m / step_m).ceil().max(1.0);
        for k in 0..count as u32 {
            let share = f64::from(k) / count;
            let place = pair[0] + (pair[1] - pair[0]) * share;
            stations.push((behind_m + share * length_m, place, along));
        }
        behind_m += length_m;
    }
    stations
}
