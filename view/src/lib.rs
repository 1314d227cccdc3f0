//! The live page of `./vlaps view`; pictures for `./vlaps draw`: maps, episodes, plans
//! and camera frames; and the parts that all charts share.
//!
//! | module | holds |
//! |---|---|
//! | [`draw`] | the commands `draw map`, `episode`, `frame`, `plan` |
//! | [`live`] | the live page: reader, server, and the page itself |
//! | [`chart`] | font, colours, text and legends of charts |
//! | [`sheet`] | writes a chart as SVG and as PNG |
//!
//! ```
//! use sim::{World, WorldConfig};
//!
//! let mut world = World::new(WorldConfig::default())?;
//! world.reset(1000)?;
//! assert!(view::draw::map_svg(&world).contains("<svg"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod chart;
pub mod draw;
pub mod live;
pub mod sheet;
