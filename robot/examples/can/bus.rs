//! The socket: that of a CAN interface, or a Unix socket that carries the same frames.

use std::fmt::Display;

use rustix::net::{AddressFamily, SocketAddrUnix, SocketType, connect, socket};
use socketcan::{CanFilter, CanSocket, Socket, SocketOptions};

use super::frames::{MOTION, PLACE, RANGES};

/// Opens the bus that `VLAPS_CAN` names. Neither reading nor writing waits.
///
/// # Errors
/// When it is not named or cannot be opened.
pub fn open() -> Result<CanSocket, String> {
    let name = std::env::var("VLAPS_CAN")
        .map_err(|_| "VLAPS_CAN: name the CAN interface, such as can0".to_owned())?;
    let told = |error: &dyn Display| format!("VLAPS_CAN={name}: {error}");
    let bus = match name.contains('/') {
        true => unix(&name).map_err(|error| told(&error))?,
        false => interface(&name).map_err(|error| told(&error))?,
    };
    bus.set_nonblocking(true).map_err(|error| told(&error))?;
    Ok(bus)
}

/// A CAN interface. The kernel keeps other frames than those of a report away, since a busy
/// bus must not fill the socket, and tells of errors of the bus.
fn interface(name: &str) -> std::io::Result<CanSocket> {
    let bus = CanSocket::open(name)?;
    let ids = [MOTION, PLACE, RANGES];
    bus.set_filters(&ids.map(|id| CanFilter::new(id.into(), 0x7ff)))?;
    bus.set_error_filter_accept_all()?;
    Ok(bus)
}

/// A Unix socket that keeps the ends of frames, as a CAN socket does.
fn unix(path: &str) -> rustix::io::Result<CanSocket> {
    let line = socket(AddressFamily::UNIX, SocketType::SEQPACKET, None)?;
    connect(&line, &SocketAddrUnix::new(path)?)?;
    Ok(CanSocket::from(line))
}
