//! The ports of a process, derived from the service table.

use super::{Subscriber, Wire, WireError};
use crate::message::Message;
use crate::services::{Process, Service};

/// Whether a process reads a service or publishes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Use {
    /// It reads it.
    Reads,
    /// It publishes it.
    Writes,
}

/// The readers of a family of services: one for each process that publishes there.
pub struct Family<M: Message>(pub Vec<(Process, Subscriber<M>)>);

impl<M: Message> Family<M> {
    /// Opens all of them.
    ///
    /// # Errors
    /// As [`Wire::subscriber`].
    pub fn open(wire: &Wire, family: Service<M>) -> Result<Self, WireError> {
        let producers = family.row.producers.iter();
        let readers = producers.map(|process| {
            let reader = wire.subscriber(family.of_process(*process))?;
            Ok((*process, reader))
        });
        readers.collect::<Result<_, _>>().map(Self)
    }

    /// Connects to publishers that came. To be called between ticks.
    pub fn update_connections(&mut self) {
        for (_, reader) in &mut self.0 {
            reader.update_connections();
        }
    }
}

/// Declares the ports that a process, or one thread of it, opens.
///
/// `read` opens a reader with the table's queue, `newest` one that holds the newest
/// message alone, `each` a reader of every process's own service of a family such as
/// `health/*`, `write` a publisher. It does not compile when the service's row does
/// not name the process as a consumer, or as a producer. `with bell` adds the process's
/// doorbell.
///
/// ```
/// use shm_config::message::{Observation, Plan};
/// use shm_config::services::{OBSERVATION, PLAN};
///
/// shm_config::ports! {
///     /// The planner's ports.
///     pub struct Ports of Planner with bell {
///         /// What it answers.
///         observations: read OBSERVATION: Observation,
///         /// Its answers.
///         plans: write PLAN: Plan,
///     }
/// }
/// assert_eq!(Ports::ROWS.len(), 2);
/// ```
///
/// A row that does not name the process is refused:
///
/// ```compile_fail
/// use shm_config::message::Command;
/// use shm_config::services::COMMAND;
///
/// shm_config::ports! {
///     /// The planner sends no command.
///     pub struct Ports of Planner {
///         /// Refused.
///         commands: write COMMAND: Command,
///     }
/// }
/// ```
#[macro_export]
macro_rules! ports {
    (
        $(#[$meta:meta])*
        pub struct $name:ident of $process:ident $(with $bell:ident)? {
            $( $(#[$field_meta:meta])* $field:ident: $kind:ident $service:ident: $message:ty, )+
        }
    ) => {
        $(#[$meta])*
        pub struct $name {
            $(
                /// The doorbell of the process.
                pub $bell: $crate::wire::Doorbell,
            )?
            $( $(#[$field_meta])* pub $field: $crate::ports!(@port $kind $message), )+
        }

        impl $name {
            /// The process that opens them.
            pub const PROCESS: $crate::services::Process =
                $crate::services::Process::$process;

            /// The rows of the service table that they use, and how.
            pub const ROWS: &'static [(&'static str, $crate::wire::Use)] =
                &[$( ($service.row.name, $crate::ports!(@use $kind)), )+];

            /// Opens all of them.
            ///
            /// # Errors
            /// When a layout differs from the running side's, or shared memory refuses.
            pub fn open(wire: &$crate::wire::Wire) -> Result<Self, $crate::wire::WireError> {
                Ok(Self {
                    $( $bell: wire.doorbell(Self::PROCESS)?, )?
                    $( $field: $crate::ports!(@open $kind wire, $service), )+
                })
            }

            /// Connects to new or restarted peers. Call it between ticks.
            pub fn update_connections(&mut self) {
                $( self.$field.update_connections(); )+
            }
        }

        $(
            const _: () = assert!(
                match $crate::ports!(@use $kind) {
                    $crate::wire::Use::Reads => {
                        $service.row.is_consumed_by($crate::services::Process::$process)
                    }
                    $crate::wire::Use::Writes => {
                        $service.row.is_produced_by($crate::services::Process::$process)
                    }
                },
                concat!(
                    "the row of ", stringify!($service), " does not name the ",
                    stringify!($process), " for this use",
                ),
            );
        )+
    };
    (@port read $message:ty) => { $crate::wire::Subscriber<$message> };
    (@port newest $message:ty) => { $crate::wire::Subscriber<$message> };
    (@port each $message:ty) => { $crate::wire::Family<$message> };
    (@port write $message:ty) => { $crate::wire::Publisher<$message> };
    (@use read) => { $crate::wire::Use::Reads };
    (@use newest) => { $crate::wire::Use::Reads };
    (@use each) => { $crate::wire::Use::Reads };
    (@use write) => { $crate::wire::Use::Writes };
    (@open read $wire:ident, $service:ident) => { $wire.subscriber($service)? };
    (@open newest $wire:ident, $service:ident) => { $wire.latest($service)? };
    (@open each $wire:ident, $service:ident) => { $crate::wire::Family::open($wire, $service)? };
    (@open write $wire:ident, $service:ident) => { $wire.publisher($service)? };
}
