//! Pictures: maps, episodes, plans and camera frames for `./vlaps draw`, and the
//! parts that all charts share.
//!
//! | module | holds |
//! |---|---|
//! | [`draw`] | the commands `draw map`, `episode`, `frame`, `plan` |
//! | [`chart`] | font, colours, words and legends of charts |
//! | [`sheet`] | a chart as SVG and as PNG |
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
pub mod sheet;
