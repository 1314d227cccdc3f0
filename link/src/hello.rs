//! The first packet of a peer, and the vehicle's answer.

use crate::keys::{Claim, Identity};
use crate::packet::Reader;
use crate::role::Role;

/// What a peer says of itself. Its packet is made with the key of the claim.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Hello {
    /// Its invitation.
    pub claim: Claim,
    /// The layouts of its messages.
    pub layouts: u64,
    /// A random number of this attempt.
    pub nonce: [u8; 16],
    /// A random number of its process.
    pub instance: u64,
}

/// The vehicle's answer to one hello.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Welcome {
    /// The random number of the hello.
    pub nonce: [u8; 16],
    /// A random number of the vehicle; its first eight bytes number the session.
    pub own_nonce: [u8; 16],
    /// A random number of the vehicle's process.
    pub instance: u64,
}

impl Hello {
    /// As a body.
    pub fn body(&self) -> Vec<u8> {
        let claim = &self.claim;
        let mut body = Vec::new();
        body.extend_from_slice(&claim.run.0);
        body.extend_from_slice(&claim.peer.0);
        body.extend_from_slice(&u64::from(claim.role.code()).to_le_bytes());
        body.extend_from_slice(&claim.expires_epoch_s.to_le_bytes());
        body.extend_from_slice(&claim.signer);
        body.extend_from_slice(&self.layouts.to_le_bytes());
        body.extend_from_slice(&self.nonce);
        body.extend_from_slice(&self.instance.to_le_bytes());
        body
    }

    /// Of a body; `None` when it is none.
    pub fn of(body: &[u8]) -> Option<Self> {
        let mut reader = Reader(body);
        let run = Identity(reader.array()?);
        let peer = Identity(reader.array()?);
        let role = Role::from_code(u32::try_from(reader.u64()?).ok()?)?;
        let claim = Claim {
            run,
            peer,
            role,
            expires_epoch_s: reader.u64()?,
            signer: reader.array()?,
        };
        let hello = Self {
            claim,
            layouts: reader.u64()?,
            nonce: reader.array()?,
            instance: reader.u64()?,
        };
        reader.0.is_empty().then_some(hello)
    }
}

impl Welcome {
    /// As a body.
    pub fn body(&self) -> Vec<u8> {
        let mut body = self.nonce.to_vec();
        body.extend_from_slice(&self.own_nonce);
        body.extend_from_slice(&self.instance.to_le_bytes());
        body
    }

    /// Of a body; `None` when it is none.
    pub fn of(body: &[u8]) -> Option<Self> {
        let mut reader = Reader(body);
        let welcome = Self {
            nonce: reader.array()?,
            own_nonce: reader.array()?,
            instance: reader.u64()?,
        };
        reader.0.is_empty().then_some(welcome)
    }

    /// The number of the session.
    pub fn session(&self) -> u64 {
        Reader(&self.own_nonce).u64().unwrap_or_default()
    }
}
