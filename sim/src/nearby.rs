//! Which boxes of a map lie near a car: while it stays there, no other can meet it.
//!
//! A world is cold when its turn comes in a batch, so each list that a tick does not read
//! is time saved: a car that stays in its cell reads no box at all.

use vehicle::{Point, Vector};

use crate::surface::Bounds;

/// Boxes are listed up to this far beyond what is asked for, m. To list them reads all
/// boxes of the map; a car in traffic drives that in twenty ticks.
const SLACK_M: f64 = 16.0;
/// Most boxes of a list; maps of one road's width have fewer at nearly all places.
const LISTED: usize = 40;
/// Most boxes that hold one point; at a large intersection they are eleven.
const HELD: usize = 14;

/// A list of the boxes near a place, by their index, in ascending order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Nearby {
    /// The list holds all boxes that overlap this one.
    around: Bounds,
    indices: [u16; LISTED],
    count: u8,
}

impl Default for Nearby {
    fn default() -> Nearby {
        Nearby {
            around: Bounds::EMPTY,
            indices: [0; LISTED],
            count: 0,
        }
    }
}

impl Nearby {
    /// At least all boxes that overlap the one asked for, from the list or made anew from
    /// `all`, which must be the same in every call; and the box for which the list is
    /// complete. `None`: too many are near to list them.
    pub fn find<'a>(
        &mut self,
        asked: &Bounds,
        all: impl Iterator<Item = &'a Bounds>,
    ) -> Option<(&[u16], Bounds)> {
        if !self.around.encloses(asked) {
            let slack = Vector::new(SLACK_M, SLACK_M);
            let around = Bounds {
                min_world: asked.min_world - slack,
                max_world: asked.max_world + slack,
            };
            self.list(around, all)?;
        }
        Some((&self.indices[..usize::from(self.count)], self.around))
    }

    fn list<'a>(&mut self, around: Bounds, all: impl Iterator<Item = &'a Bounds>) -> Option<()> {
        *self = Nearby::default();
        let near = (0_u16..)
            .zip(all)
            .filter(|(_, bounds)| bounds.overlaps(&around));
        let mut count = 0;
        for (index, _) in near {
            *self.indices.get_mut(count)? = index;
            count += 1;
        }
        self.count = count as u8;
        self.around = around;
        Some(())
    }
}

/// The box around a point, larger by `margin_m` on each side.
pub(crate) fn around(point_world: Point, margin_m: f64) -> Bounds {
    let margin = Vector::new(margin_m, margin_m);
    Bounds {
        min_world: point_world - margin,
        max_world: point_world + margin,
    }
}

/// The boxes that hold a point, and the cell around it in which these same boxes hold
/// every point. The answer has the bits of [`Bounds::contains`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub(crate) struct Cell {
    same: Bounds,
    indices: [u16; HELD],
    count: u8,
}

const _: () = assert!(size_of::<Cell>() == 64, "a tick reads one line");

impl Default for Cell {
    fn default() -> Cell {
        Cell {
            same: Bounds::EMPTY,
            indices: [0; HELD],
            count: 0,
        }
    }
}

impl Cell {
    /// Boxes that hold the point, by their index, in ascending order; `None` if the point
    /// is in another cell.
    pub fn of(&self, point_world: Point) -> Option<&[u16]> {
        self.same
            .contains(point_world, 0.0)
            .then(|| &self.indices[..usize::from(self.count)])
    }

    /// The cell of a point between boxes that are larger by `margin_m` than those of
    /// `near`, which are all that hold any point of `within`. `None`: more boxes than a
    /// cell can name hold the point.
    pub fn find(
        &mut self,
        point_world: Point,
        margin_m: f64,
        within: Bounds,
        near: impl Iterator<Item = (u16, Bounds)>,
    ) -> Option<&[u16]> {
        *self = Cell::default();
        let (mut same, mut count) = (within, 0);
        for (index, bounds) in near {
            let (low, high) = bounds.grown(margin_m);
            if bounds.contains(point_world, margin_m) {
                *self.indices.get_mut(count)? = index;
                count += 1;
                same.min_world = same.min_world.sup(&low);
                same.max_world = same.max_world.inf(&high);
            } else {
                same.keep_off((point_world, point_world), (low, high));
            }
        }
        self.count = count as u8;
        self.same = same;
        Some(&self.indices[..count])
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn no_box_at_a_place_is_left_out(
            boxes in prop::collection::vec((-60.0..60.0, -60.0..60.0, 0.0..30.0), 0..80),
            places in prop::collection::vec((-60.0..60.0, -60.0..60.0, 0.0..3.0), 1..20),
        ) {
            let boxes: Vec<Bounds> = boxes
                .into_iter()
                .map(|(x, y, half_m)| around(Point::new(x, y), half_m))
                .collect();
            let mut nearby = Nearby::default();
            for (x, y, half_m) in places {
                let asked = around(Point::new(x, y), half_m);
                let Some((found, _)) = nearby.find(&asked, boxes.iter()) else {
                    prop_assert!(boxes.len() > LISTED);
                    continue;
                };
                prop_assert!(found.is_sorted());
                for (index, bounds) in boxes.iter().enumerate() {
                    let listed = found.contains(&(index as u16));
                    prop_assert!(listed || !bounds.overlaps(&asked), "{index}");
                }
            }
        }

        /// Places lie on a grid, so many are exactly on an edge.
        #[test]
        fn a_cell_names_the_boxes_that_hold_a_point(
            boxes in prop::collection::vec((-9..9, -9..9, 0..5), 0..30),
            places in prop::collection::vec((-40..40, -40..40), 1..40),
        ) {
            let boxes: Vec<Bounds> = boxes
                .into_iter()
                .map(|(x, y, half): (i32, i32, i32)| {
                    around(Point::new(x.into(), y.into()), half.into())
                })
                .collect();
            let margin_m = 0.25;
            let within = around(Point::origin(), 8.0);
            let mut cell = Cell::default();
            for (x, y) in places {
                let point = Point::new(f64::from(x) / 4.0, f64::from(y) / 4.0);
                let holding = |bounds: &Bounds| bounds.contains(point, margin_m);
                let expected: Vec<u16> = (0_u16..)
                    .zip(&boxes)
                    .filter_map(|(index, bounds)| holding(bounds).then_some(index))
                    .collect();
                if let Some(found) = cell.of(point) {
                    prop_assert_eq!(found, &expected[..]);
                    continue;
                }
                if !within.contains(point, 0.0) {
                    continue;
                }
                let near = (0..).zip(boxes.iter().copied());
                match cell.find(point, margin_m, within, near) {
                    Some(found) => prop_assert_eq!(found, &expected[..]),
                    None => prop_assert!(expected.len() > HELD),
                }
                prop_assert!(expected.len() > HELD || cell.of(point).is_some());
            }
        }
    }
}
