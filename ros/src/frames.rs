//! Poses of frames in each other, from TF, from above.

use std::collections::BTreeMap;

use vehicle::Pose;

use crate::inbound::{Refused, Transform};

/// Most frames that are known: a humanoid has a hundred.
const FRAMES_MAX: usize = 512;
/// Most frames from one to the root of its tree; a circle ends there, too.
const DEPTH_MAX: usize = 32;

/// Where one frame is in another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Place {
    /// Its pose.
    Known(Pose),
    /// No transforms join the two.
    Unknown,
    /// A transform between the two is not level.
    Tilted,
}

/// The newest transform of each frame to its parent.
#[derive(Debug, Default)]
pub struct Frames {
    /// Of each child its parent and its pose there.
    parents: BTreeMap<String, (String, Option<Pose>)>,
}

impl Frames {
    /// Takes transforms in.
    ///
    /// # Errors
    /// When there are too many frames; those that are known are updated all the same.
    pub fn note(&mut self, transforms: Vec<Transform>) -> Result<(), Refused> {
        let mut noted = Ok(());
        for Transform {
            header,
            child,
            pose,
        } in transforms
        {
            match self.parents.contains_key(&child) || self.parents.len() < FRAMES_MAX {
                true => {
                    self.parents.insert(child, (header.frame, pose));
                }
                false => noted = Err(Refused("there are more than 512 frames")),
            }
        }
        noted
    }

    /// From a frame to the root of its tree, with its own pose in each.
    fn chain<'a>(&'a self, frame: &'a str) -> Vec<(&'a str, Option<Pose>)> {
        let mut chain = vec![(frame, Some(Pose::identity()))];
        let mut at = (frame, Some(Pose::identity()));
        while let Some((parent, pose)) = self.parents.get(at.0) {
            if chain.len() >= DEPTH_MAX {
                break;
            }
            let pose = pose.zip(at.1).map(|(parent_from, own)| parent_from * own);
            at = (parent, pose);
            chain.push(at);
        }
        chain
    }

    /// Where `frame` is in `within`.
    pub fn place(&self, frame: &str, within: &str) -> Place {
        let (own, other) = (self.chain(frame), self.chain(within));
        let common = own.iter().find_map(|(name, from_own)| {
            let (_, from_other) = other.iter().find(|(known, _)| known == name)?;
            Some((*from_own, *from_other))
        });
        match common {
            Some((Some(from_own), Some(from_other))) => {
                Place::Known(from_other.inverse() * from_own)
            }
            Some(_) => Place::Tilted,
            None => Place::Unknown,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use vehicle::{Point, pose};

    use super::*;
    use crate::inbound::Header;

    fn transform(parent: &str, child: &str, pose: Option<Pose>) -> Transform {
        let header = Header {
            stamp_ns: 0,
            frame: parent.into(),
        };
        let child = child.into();
        Transform {
            header,
            child,
            pose,
        }
    }

    #[test]
    fn frames_are_found_over_their_common_parent() {
        let mut frames = Frames::default();
        let noted = frames.note(vec![
            transform("map", "odom", Some(pose(10.0, 0.0, 0.0))),
            transform("odom", "base_link", Some(pose(0.0, 5.0, FRAC_PI_2))),
            transform("base_link", "laser", Some(pose(1.0, 0.0, 0.0))),
            transform("base_link", "camera", None),
        ]);
        assert_eq!(noted, Ok(()));
        let Place::Known(laser) = frames.place("laser", "map") else {
            panic!("the laser is on the map");
        };
        let at = laser * Point::origin();
        assert!((at - Point::new(10.0, 6.0)).norm() < 1e-9, "{at}");
        let Place::Known(map) = frames.place("map", "base_link") else {
            panic!("the map is around the car");
        };
        let at = map * Point::new(10.0, 6.0);
        assert!((at - Point::new(1.0, 0.0)).norm() < 1e-9, "{at}");
        assert_eq!(frames.place("a", "a"), Place::Known(Pose::identity()));
        assert_eq!(frames.place("laser", "earth"), Place::Unknown);
        assert_eq!(frames.place("camera", "odom"), Place::Tilted);
    }

    #[test]
    fn circles_end_and_too_many_frames_are_refused() {
        let mut frames = Frames::default();
        let turn = Some(pose(0.0, 0.0, 0.1));
        let circle = vec![transform("a", "b", turn), transform("b", "a", turn)];
        assert_eq!(frames.note(circle), Ok(()));
        assert_eq!(frames.place("a", "c"), Place::Unknown);
        let many = (0..600).map(|k| transform("root", &format!("f{k}"), turn));
        assert!(frames.note(many.collect()).is_err());
        assert_eq!(frames.parents.len(), FRAMES_MAX);
    }
}
