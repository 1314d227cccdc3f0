//! Classifies the pixels of a picture by the palette and moves a car's rectangle along
//! a path over them.

use image::RgbImage;
use shm_config::message::{Camera, View};
use shm_config::palette;
use vehicle::{Footprint, Point, Vector};

use super::trace::stations;

/// Maximum distance of a pixel's colour from that of its class: less than half the
/// distance between two colours of the palette.
const TOLERANCE: f64 = 17.0;
/// Sides of bodies are drawn darker, down to this share of the colour.
const SHADE_MIN: f64 = 0.5;
/// The car that is moved along a path.
const CAR: Footprint = Footprint {
    length_m: 4.5,
    width_m: 1.85,
};
/// Step along the path, and spacing of the tested points under the car, m.
const STEP_M: f64 = 0.25;
/// Number of points under the car that make an obstacle; a single one may be a blended edge.
const BODY_POINTS: usize = 2;
const SIDEWALK_POINTS: usize = 2;
/// The car has left the road with its centre if this share of the known points under it
/// lies beside the road.
const BESIDE_SHARE: f64 = 0.5;
/// Distances from the centre of a drawn path to the points tested beside it, m.
const MIDDLE_M: [f64; 3] = [0.55, 0.7, 0.85];
/// A centre line is tracked within this distance of the path, m.
const LINE_REACH_M: f64 = 1.5;

/// Class of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Class {
    /// A path, a label, or a blend of two colours.
    Unknown,
    Road,
    CentreLine,
    Beside,
    Sidewalk,
    Body,
}

/// Kind of an obstacle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A vehicle or an object.
    Body,
    /// The edge of the road, or the line between the directions.
    Edge,
}

/// The first obstacle on a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Obstacle {
    /// Kind.
    pub kind: Kind,
    /// Distance along the path, m.
    pub at_m: f64,
}

/// The class of each pixel of a picture.
pub struct Ground {
    width: usize,
    height: usize,
    classes: Vec<Class>,
}

impl Ground {
    /// Classifies a picture.
    pub fn of(image: &RgbImage, view: View) -> Self {
        let (width, height) = (image.width() as usize, image.height() as usize);
        let raw: Vec<Class> = image.pixels().map(|pixel| class(pixel.0, view)).collect();
        let mut ground = Self {
            width,
            height,
            classes: raw,
        };
        ground.drop_isolated(view);
        match view {
            View::TopDown => {}
            View::Ego => ground.keep_lowest(),
        }
        ground
    }

    fn at(&self, x: usize, y: usize) -> Class {
        match x < self.width && y < self.height {
            true => self.classes[y * self.width + x],
            false => Class::Unknown,
        }
    }

    /// Removes isolated pixels. Edges of painted lines are blends that may match any class;
    /// bodies are wider than a pixel, and sidewalks and the ground beside them wider than
    /// two.
    fn drop_isolated(&mut self, view: View) {
        // Counted in a neighbourhood of nine. From above, a painted line is a blend two pixels
        // wide; from the car, distant strips are three pixels high.
        let strip = match view {
            View::TopDown => 7,
            View::Ego => 6,
        };
        let mut kept = self.classes.clone();
        for y in 0..self.height {
            for x in 0..self.width {
                let class = self.at(x, y);
                let least = match class {
                    Class::Body => 5,
                    Class::Sidewalk | Class::Beside => strip,
                    Class::Unknown | Class::Road | Class::CentreLine => continue,
                };
                let around = (0..9).filter(|k| {
                    let (nx, ny) = ((x + k % 3).wrapping_sub(1), (y + k / 3).wrapping_sub(1));
                    self.at(nx, ny) == class
                });
                if around.count() < least {
                    kept[y * self.width + x] = Class::Unknown;
                }
            }
        }
        self.classes = kept;
    }

    /// From the car's view a body hides the ground behind it. It obstructs only where it
    /// stands: at its lowest pixel in each column.
    fn keep_lowest(&mut self) {
        for x in 0..self.width {
            let mut below = Class::Unknown;
            for y in (0..self.height).rev() {
                let at = y * self.width + x;
                let class = self.classes[at];
                let stands = matches!(below, Class::Road | Class::Sidewalk | Class::Beside);
                if class == Class::Body && !stands {
                    self.classes[at] = Class::Unknown;
                    // The pixels of the body above hide ground as well.
                    below = Class::Unknown;
                } else {
                    below = class;
                }
            }
        }
    }

    /// The first obstacle on a path, with a safety margin around the car, m.
    pub fn first_obstacle(
        &self,
        line: &[Point],
        camera: &Camera,
        margin_m: f64,
    ) -> Option<Obstacle> {
        let mut side = LineSide::default();
        let own = Place {
            middle: Point::origin(),
            along: Vector::x(),
        };
        stations(line, STEP_M)
            .into_iter()
            .find_map(|(at_m, middle, along)| {
                let place = Place { middle, along };
                let under = self.under(camera, &place, &own, margin_m);
                let crossed = side.crosses(|offset_m| {
                    self.look(camera, place.point(0.0, offset_m)) == Class::CentreLine
                });
                let off_road = under.is_beside() || self.is_middle_beside(camera, &place);
                let kind = if under.bodies >= BODY_POINTS {
                    Kind::Body
                } else if under.sidewalks >= SIDEWALK_POINTS || off_road || crossed {
                    Kind::Edge
                } else {
                    return None;
                };
                Some(Obstacle { kind, at_m })
            })
    }

    /// Whether the car's centre is beside the road: the drawn path hides the pixels under it,
    /// but there is no road on either side of it.
    fn is_middle_beside(&self, camera: &Camera, place: &Place) -> bool {
        [1.0, -1.0].into_iter().all(|side| {
            let seen = MIDDLE_M.map(|left_m| self.look(camera, place.point(0.0, side * left_m)));
            let known = seen.iter().filter(|class| **class != Class::Unknown);
            seen.contains(&Class::Beside) && known.into_iter().all(|class| *class == Class::Beside)
        })
    }

    fn look(&self, camera: &Camera, at: Point) -> Class {
        match camera.project([at.x, at.y, 0.0]) {
            Some([u, v]) if u >= 0.0 && v >= 0.0 => self.at(u as usize, v as usize),
            Some(_) | None => Class::Unknown,
        }
    }

    /// Counts the classes under the car at a place. What the car stands on at the begin is
    /// left out, since neither proposal can change it.
    fn under(&self, camera: &Camera, place: &Place, own: &Place, margin_m: f64) -> Under {
        let half_x_m = CAR.length_m / 2.0 + margin_m;
        let half_y_m = CAR.width_m / 2.0 + margin_m;
        let across = (2.0 * half_y_m / STEP_M).ceil();
        let along = (2.0 * half_x_m / STEP_M).ceil();
        let mut under = Under::default();
        for i in 0..=along as u32 {
            for k in 0..=across as u32 {
                let x_m = half_x_m * (2.0 * f64::from(i) / along - 1.0);
                let y_m = half_y_m * (2.0 * f64::from(k) / across - 1.0);
                let point = place.point(x_m, y_m);
                if own.covers(point) {
                    continue;
                }
                match self.look(camera, point) {
                    Class::Unknown => {}
                    Class::Body => under.bodies += 1,
                    Class::Sidewalk => under.sidewalks += 1,
                    Class::Beside => under.beside += 1,
                    Class::Road | Class::CentreLine => under.road += 1,
                }
            }
        }
        under
    }
}

/// Number of points of each class under the car.
#[derive(Default)]
struct Under {
    bodies: usize,
    sidewalks: usize,
    beside: usize,
    road: usize,
}

impl Under {
    fn is_beside(&self) -> bool {
        let known = (self.beside + self.sidewalks + self.road) as f64;
        self.beside >= 4 && self.beside as f64 >= BESIDE_SHARE * known
    }
}

/// The car's pose on a path.
struct Place {
    middle: Point,
    along: Vector,
}

impl Place {
    /// A point `ahead_m` ahead and `left_m` to the left of the car's centre.
    fn point(&self, ahead_m: f64, left_m: f64) -> Point {
        let left = Vector::new(-self.along.y, self.along.x);
        self.middle + self.along * ahead_m + left * left_m
    }

    fn covers(&self, point: Point) -> bool {
        let away = point - self.middle;
        let left_m = away.y * self.along.x - away.x * self.along.y;
        away.dot(&self.along).abs() < CAR.length_m / 2.0 + 0.3
            && left_m.abs() < CAR.width_m / 2.0 + 0.3
    }
}

/// The side of the path on which the line between the directions lies.
#[derive(Default)]
struct LineSide {
    left: Option<bool>,
}

impl LineSide {
    /// Whether the path's centre has crossed the line.
    fn crosses(&mut self, is_line: impl Fn(f64) -> bool) -> bool {
        let count = (LINE_REACH_M / 0.1) as i32;
        let mut offsets = (-count..=count).map(|k| f64::from(k) * 0.1);
        // The drawn path hides the pixels under it.
        let Some(offset_m) = offsets.find(|&offset_m| is_line(offset_m)) else {
            return false;
        };
        let is_left = offset_m > 0.0;
        let crossed = self.left.is_some_and(|left| left != is_left);
        self.left = Some(is_left);
        crossed
    }
}

fn class(pixel: [u8; 3], view: View) -> Class {
    let near = |color: palette::Rgb| palette::distance(pixel, color) < TOLERANCE;
    let flat = [
        (palette::ROAD, Class::Road),
        (palette::LINE_SOLID, Class::Road),
        (palette::LINE_BROKEN, Class::Road),
        (palette::EGO, Class::Road),
        (palette::GROUND, Class::Beside),
        (palette::SIDEWALK, Class::Sidewalk),
        (palette::VEHICLE, Class::Body),
        (palette::VEHICLE_GLASS, Class::Body),
        (palette::OBJECT, Class::Body),
    ];
    if let Some((_, class)) = flat.into_iter().find(|(color, _)| near(*color)) {
        return class;
    }
    if is_yellow(pixel) {
        return Class::CentreLine;
    }
    let is_shaded = view == View::Ego
        && [palette::VEHICLE, palette::VEHICLE_GLASS, palette::OBJECT]
            .into_iter()
            .any(|color| is_shade(pixel, color));
    match is_shaded {
        true => Class::Body,
        false => Class::Unknown,
    }
}

/// Whether a pixel belongs to the line between the directions, possibly blended with the
/// road: the line is about a pixel wide.
fn is_yellow([red, green, blue]: [u8; 3]) -> bool {
    let [red, green, blue] = [red, green, blue].map(i32::from);
    (red - green).abs() <= 26 && red - blue >= 26 && green - blue >= 20 && red >= 85
}

/// Whether a pixel is a darker shade of a colour.
fn is_shade(pixel: [u8; 3], color: palette::Rgb) -> bool {
    let dot = |a: [u8; 3], b: [u8; 3]| -> f64 {
        a.iter()
            .zip(b)
            .map(|(a, b)| f64::from(*a) * f64::from(b))
            .sum()
    };
    let light = dot(pixel, color) / dot(color, color);
    (SHADE_MIN..1.0).contains(&light)
        && palette::distance(pixel, palette::shaded(color, light)) < TOLERANCE / 2.0
}
