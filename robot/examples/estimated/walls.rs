//! Walls, and what a scanner sees of them.

use robot::Point;

/// A straight wall from point to point, m.
pub type Wall = [Point; 2];

/// The walls between successive points.
pub fn along(points: &[Point]) -> Vec<Wall> {
    points.windows(2).map(|pair| [pair[0], pair[1]]).collect()
}

/// Distance to the nearest wall in a direction, m; infinite without one.
pub fn range_m(walls: &[Wall], from: Point, direction_rad: f64) -> f64 {
    let way = Point::new(direction_rad.cos(), direction_rad.sin()).coords;
    let met = walls.iter().filter_map(|[begin, end]| {
        let wall = end - begin;
        let across = way.perp(&wall);
        let to = begin - from;
        let along_m = to.perp(&wall) / across;
        let share = to.perp(&way) / across;
        (along_m > 0.0 && (0.0..=1.0).contains(&share)).then_some(along_m)
    });
    met.fold(f64::INFINITY, f64::min)
}
