//! Messages as they travel: the bytes that are used, and back, through the door that each
//! message has.

use std::sync::Arc;

use ring::signature::{ED25519, Ed25519KeyPair, UnparsedPublicKey};
use shm_config::Message;
use shm_config::message::{Frame, WEIGHTS_BYTES_MAX, Weights};

use crate::keys::{Identity, sha256};
use crate::packet::Reader;
use crate::pieces::{PIECE_BYTES, PIECES_MAX};
use crate::refusal::Reason;

/// What a learner signs begins with this, so that its signature is of nothing else.
const SIGNED: &[u8] = b"vlaps-link policy 1";
/// Bytes of a signature.
const SIGNATURE: usize = 64;
/// Bytes of a policy before its file: version, sum, signature.
const POLICY_HEAD: usize = 8 + 32 + SIGNATURE;
const _: () = {
    // The longest messages have no more pieces than are taken.
    let policy = POLICY_HEAD + WEIGHTS_BYTES_MAX;
    assert!(policy.div_ceil(PIECE_BYTES) <= PIECES_MAX as usize);
    assert!(size_of::<Frame>().div_ceil(PIECE_BYTES) <= PIECES_MAX as usize);
};

/// The bytes of a message that are used.
pub fn bytes_of<M: Message>(message: &M) -> Arc<[u8]> {
    message.as_bytes()[..message.used_bytes()].into()
}

/// The message of bytes; those that are not there are zeros.
///
/// # Errors
/// When there are more than a message has, or the message's own check refuses it.
pub fn message_of<M: Message>(bytes: &[u8]) -> Result<M, Reason> {
    if bytes.len() > size_of::<M>() {
        return Err(Reason::Content);
    }
    let mut whole = vec![0; size_of::<M>()];
    whole[..bytes.len()].copy_from_slice(bytes);
    let message = M::from_bytes(&whole).ok_or(Reason::Content)?;
    match message.check() {
        Ok(()) => Ok(message),
        Err(_) => Err(Reason::Content),
    }
}

/// A policy file as it travels: what the learner's key has signed, and the file. The eight
/// megabytes of the message around it stay on the machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SignedPolicy<'a> {
    /// The version.
    pub version: u64,
    /// SHA-256 of the file.
    pub sha256: [u8; 32],
    /// The file.
    pub file: &'a [u8],
}

fn signed_text(run: Identity, version: u64, sha256: &[u8; 32]) -> Vec<u8> {
    let mut text = SIGNED.to_vec();
    text.extend_from_slice(&run.0);
    text.extend_from_slice(&version.to_le_bytes());
    text.extend_from_slice(sha256);
    text
}

/// Signs a policy for a run.
pub fn signed_bytes(weights: &Weights, run: Identity, signer: &Ed25519KeyPair) -> Arc<[u8]> {
    let text = signed_text(run, weights.version, &weights.sha256);
    let mut bytes = weights.version.to_le_bytes().to_vec();
    bytes.extend_from_slice(&weights.sha256);
    bytes.extend_from_slice(signer.sign(&text).as_ref());
    bytes.extend_from_slice(weights.file());
    bytes.into()
}

impl<'a> SignedPolicy<'a> {
    /// The policy of bytes.
    ///
    /// # Errors
    /// When they are cut or too long, the file is not that of its sum, or the key has not
    /// signed it for this run.
    pub fn of(bytes: &'a [u8], run: Identity, signer: &[u8; 32]) -> Result<Self, Reason> {
        let mut reader = Reader(bytes);
        let version = reader.u64().ok_or(Reason::Content)?;
        let sum = reader.array().ok_or(Reason::Content)?;
        let signature = reader.take(SIGNATURE).ok_or(Reason::Content)?;
        let file = reader.0;
        if file.is_empty() || file.len() > WEIGHTS_BYTES_MAX || sha256(file) != sum {
            return Err(Reason::Content);
        }
        let key = UnparsedPublicKey::new(&ED25519, signer);
        let text = signed_text(run, version, &sum);
        key.verify(&text, signature).map_err(|_| Reason::Unsigned)?;
        Ok(Self {
            version,
            sha256: sum,
            file,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ring::signature::KeyPair as _;
    use shm_config::message::{Advice, Step};

    #[test]
    fn a_message_travels_as_it_is_and_a_wrong_one_is_refused() {
        let mut step = Step::default();
        step.header.tick = 7;
        step.advice.header.episode = 3;
        let bytes = bytes_of(&step);
        assert!(
            bytes.len() < size_of::<Step>(),
            "beams that are not there do not travel"
        );
        assert_eq!(message_of::<Step>(&bytes), Ok(step));
        step.expert.steer = f64::NAN;
        assert_eq!(
            message_of::<Step>(&bytes_of(&step)).err(),
            Some(Reason::Content)
        );
        let advice = Advice {
            preference: 9,
            ..Advice::default()
        };
        assert_eq!(
            message_of::<Advice>(&bytes_of(&advice)).err(),
            Some(Reason::Content)
        );
        let long = vec![0; size_of::<Advice>() + 1];
        assert_eq!(message_of::<Advice>(&long).err(), Some(Reason::Content));
    }

    /// On a thread with room for the message of eight megabytes.
    fn policy_bytes(run: Identity, signer: &Ed25519KeyPair, file: &'static [u8]) -> Arc<[u8]> {
        let seed_text = signed_text(run, 4, &sha256(file));
        let mut bytes = 4_u64.to_le_bytes().to_vec();
        bytes.extend_from_slice(&sha256(file));
        bytes.extend_from_slice(signer.sign(&seed_text).as_ref());
        bytes.extend_from_slice(file);
        bytes.into()
    }

    #[test]
    fn a_policy_counts_only_when_this_learner_signed_it_for_this_run() {
        let signer = Ed25519KeyPair::from_seed_unchecked(&[1; 32]).expect("a key");
        let other = Ed25519KeyPair::from_seed_unchecked(&[2; 32]).expect("a key");
        let public = |pair: &Ed25519KeyPair| -> [u8; 32] {
            pair.public_key().as_ref().try_into().expect("32 bytes")
        };
        let run = Identity([5; 16]);
        let bytes = policy_bytes(run, &signer, b"a policy");
        let policy = SignedPolicy::of(&bytes, run, &public(&signer)).expect("a policy");
        assert_eq!((policy.version, policy.file), (4, &b"a policy"[..]));
        let refused = |bytes: &[u8], run, key: &Ed25519KeyPair| {
            SignedPolicy::of(bytes, run, &public(key)).err()
        };
        assert_eq!(refused(&bytes, run, &other), Some(Reason::Unsigned));
        assert_eq!(
            refused(&bytes, Identity([6; 16]), &signer),
            Some(Reason::Unsigned)
        );
        for place in 0..bytes.len() {
            let mut changed = bytes.to_vec();
            changed[place] ^= 1;
            assert!(
                refused(&changed, run, &signer).is_some(),
                "byte {place} changed"
            );
        }
        for cut in 0..bytes.len() {
            assert!(
                refused(&bytes[..cut], run, &signer).is_some(),
                "cut to {cut} bytes"
            );
        }
    }
}
