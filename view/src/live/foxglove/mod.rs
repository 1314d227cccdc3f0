//! A WebSocket server for Foxglove and Lichtblick: the run's newest messages as they come.
//!
//! It speaks the part of the protocols `foxglove.websocket.v1` and `foxglove.sdk.v1` in which
//! both agree: `serverInfo`, `advertise`, `subscribe`, `unsubscribe`, `status`, and message
//! data (<https://github.com/foxglove/ws-protocol>). Clients can change nothing.
//!
//! ```text
//! reader -> Board: the newest message of each topic -> one task for each client
//! ```
//!
//! There is no queue: a client that is slow finds the newest message when it has room again,
//! and those between are skipped and counted.

mod board;
mod client;
mod protocol;
mod server;
mod shown;
mod websocket;

pub use board::Board;
pub use client::take_all;
pub use protocol::SUBPROTOCOLS;
pub use server::FoxgloveServer;
pub use shown::Shown;
