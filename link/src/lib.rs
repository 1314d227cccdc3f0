//! Judge, learner, view and recorder of a running set on other machines, over Zenoh.
//!
//! A fault of the network makes no tick late and loses nothing uncounted, and no command
//! comes from elsewhere. `docs/machines.md` is the guide, decision 0045 says why it is built
//! like this.
//!
//! | module | holds |
//! |---|---|
//! | [`role`] | the roles, and which rows each hears and sends |
//! | [`keys`], [`certificate`] | the secrets of a run, invitations |
//! | [`packet`], [`hello`] | what travels |
//! | [`cipher`] | the encryption of a session |
//! | [`flow`], [`pieces`] | numbers, acknowledgements and losses of each row; long messages |
//! | [`clock_map`] | the other machine's clock |
//! | [`live`], [`host`], [`peer`] | a session, and both of its ends, without network or clock |
//! | [`refusal`], [`dating`], [`rows`], [`pace`] | the doors |
//! | [`carrier`] | Zenoh |
//! | [`station`], [`stand_in`], [`serve`] | the vehicle's processes |
//! | [`mirror`], [`program`], [`local`], [`held`], [`join`] | the other machine's |
//! | [`arguments`], [`commands`] | the command line, and what each command does |
//! | [`report`] | what both have done |

#[path = "../../supervisor/src/commands/link.rs"]
pub mod arguments;
pub mod carrier;
pub mod certificate;
pub mod cipher;
pub mod clock_map;
pub mod commands;
pub mod dating;
pub mod flow;
pub mod held;
pub mod hello;
pub mod host;
pub mod join;
pub mod keys;
pub mod live;
pub mod local;
pub mod mirror;
pub mod pace;
pub mod packet;
pub mod peer;
pub mod pieces;
pub mod program;
pub mod refusal;
pub mod report;
pub mod role;
pub mod rows;
pub mod serve;
pub mod stand_in;
pub mod station;
