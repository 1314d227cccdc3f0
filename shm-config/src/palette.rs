//! The colours of rendered pictures. Every world draws with these colours, so that a
//! reader of pictures can rely on them.

use crate::message::Driver;

/// Red, green and blue, a byte each.
pub type Rgb = [u8; 3];

/// Beside the road.
pub const GROUND: Rgb = [104, 122, 92];
/// Sidewalks, which end an episode.
pub const SIDEWALK: Rgb = [152, 158, 166];
/// The area that may be driven on.
pub const ROAD: Rgb = [60, 62, 68];
/// A line that must not be crossed, or the edge of the road.
pub const LINE_SOLID: Rgb = [222, 224, 226];
/// A line between lanes of one direction.
pub const LINE_BROKEN: Rgb = [186, 190, 196];
/// A solid line between the two directions.
pub const LINE_CENTRE: Rgb = [226, 208, 112];
/// The car itself.
pub const EGO: Rgb = [254, 254, 254];
/// Every other car, broken down or not. Its sides are darker than its top, see
/// [`shaded`].
pub const VEHICLE: Rgb = [200, 148, 104];
/// Its windows.
pub const VEHICLE_GLASS: Rgb = [112, 78, 54];
/// Cones, warning triangles, barriers.
pub const OBJECT: Rgb = [240, 178, 178];
/// Around bodies, and the windows of the car itself.
pub const RIM: Rgb = [26, 28, 32];
/// Above the horizon.
pub const SKY: Rgb = [150, 182, 214];

/// All colours by name.
pub const ALL: [(&str, Rgb); 12] = [
    ("GROUND", GROUND),
    ("SIDEWALK", SIDEWALK),
    ("ROAD", ROAD),
    ("LINE_SOLID", LINE_SOLID),
    ("LINE_BROKEN", LINE_BROKEN),
    ("LINE_CENTRE", LINE_CENTRE),
    ("EGO", EGO),
    ("VEHICLE", VEHICLE),
    ("VEHICLE_GLASS", VEHICLE_GLASS),
    ("OBJECT", OBJECT),
    ("RIM", RIM),
    ("SKY", SKY),
];

/// The colour of a driver in all pictures: paths, bands, text.
pub const fn driver(driver: Driver) -> Rgb {
    match driver {
        Driver::Expert => [55, 214, 122],
        Driver::Policy => [77, 181, 255],
        Driver::Brake => [255, 86, 72],
    }
}

/// A colour as HTML and SVG write it: `#37d67a`.
pub fn hex([red, green, blue]: Rgb) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

/// Hues that no world uses; they are for lines drawn over a picture.
pub const RESERVED: [Rgb; 6] = [
    [230, 25, 25],
    [30, 60, 255],
    [0, 190, 60],
    [255, 140, 0],
    [230, 0, 200],
    [0, 200, 220],
];

/// Least distance between two colours of the palette, and from any of them to a
/// reserved hue, in the cube of bytes. A reader by colour needs this tolerance, because
/// edges are blended and JPEG changes colours.
pub const APART: f64 = 36.0;
/// See [`APART`].
pub const APART_FROM_RESERVED: f64 = 110.0;

/// The distance of two colours in the cube of bytes.
pub fn distance(a: Rgb, b: Rgb) -> f64 {
    let square = |k: usize| (f64::from(a[k]) - f64::from(b[k])).powi(2);
    (square(0) + square(1) + square(2)).sqrt()
}

/// The colour of a side with less light, in [0, 1]: upright sides have at most a fifth
/// less.
pub fn shaded(color: Rgb, light: f64) -> Rgb {
    color.map(|value| (f64::from(value) * light.clamp(0.0, 1.0)).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_can_be_told_apart() {
        for (k, (name, color)) in ALL.iter().enumerate() {
            for (other, second) in &ALL[..k] {
                let apart = distance(*color, *second);
                assert!(apart >= APART, "{name} and {other}: {apart}");
            }
            for reserved in RESERVED {
                let apart = distance(*color, reserved);
                assert!(
                    apart >= APART_FROM_RESERVED,
                    "{name} and {reserved:?}: {apart}"
                );
            }
        }
    }
}
