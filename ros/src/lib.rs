//! ROS 2 over Zenoh, in the wire format of rmw_zenoh; no part of ROS is needed.
//!
//! | module | holds |
//! |---|---|
//! | [`settings`] | the file that `VLAPS_ROS` names |
//! | [`wall`] | the wall clock of ROS stamps beside the monotonic clock of a run |
//! | [`lines`] | one line for each kind of trouble, not one for each message |
//! | [`type_hash`] | RIHS01, the hash of a message type, from its definition |
//! | [`names`] | key expressions, liveliness tokens, attachments |
//! | [`session`] | one connection to the router, and what is told of it |
//! | [`publisher`] | a ROS topic that is published |
//! | [`command`] | the command line of `vlaps-ros` |
//! | [`bridge`] | a run, read from outside, as ROS topics: the program `vlaps-ros` |
//! | [`cdr`], [`inbound`] | messages from ROS, checked |
//! | [`frames`] | poses of frames in each other, from TF |
//! | [`setpoint`] | an action as angle, speed and acceleration |
//! | [`world`] | a ROS robot as the world of a run: the program `vlaps-ros-world` |
//!
//! Message definitions and the standard messages are those of recordings: crate `recorder`.

pub mod bridge;
pub mod cdr;
pub mod command;
pub mod frames;
pub mod inbound;
pub mod lines;
pub mod names;
pub mod publisher;
pub mod session;
pub mod setpoint;
pub mod settings;
pub mod type_hash;
pub mod wall;
pub mod world;
