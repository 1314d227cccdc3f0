//! libvlaps: processes of a run in C, C++ and Python, on the same wire and through the
//! same checks as those in Rust.
//!
//! | module | holds |
//! |---|---|
//! | `border` | the functions of the C interface, and all `unsafe` |
//! | `session` | the membership of the process, and its ports by number |
//! | `port`, `door` | ports by the name of a service; the check of each message |
//! | `world`, `account` | the loop of a world: grid, age limit, brake, episodes |
//! | `planner` | the loop of a planner: turns, deadlines |
//! | [`description`], [`header`] | messages and lists for other languages; the C header |
//! | `failure` | codes and texts |
//!
//! `capi/include/vlaps.h` is generated, `capi/include/vlaps.hpp` is C++ on it,
//! `python/vlaps/process.py` the same in Python; docs/foreign.md explains them.

mod account;
mod border;
pub mod description;
mod door;
pub mod failure;
pub mod header;
mod planner;
mod port;
mod session;
mod world;
