//! The encryption of one session: a peer of another invitation can neither read nor forge what
//! its two ends send, although TLS admits its certificate.
//!
//! Both keys come from the peer's own key and from the random numbers of both sides, so each
//! session and each direction has its own. The nonce is direction and counter. A counter is
//! used once, because a peer takes one answer to each of its random numbers, and the vehicle
//! makes a random number for each offer.

use ring::aead::{Aad, CHACHA20_POLY1305, LessSafeKey, Nonce, UnboundKey};
use ring::hmac;

/// Bytes that encryption adds.
pub const TAG_BYTES: usize = 16;
/// What each key is derived under; another protocol makes other keys.
const SESSION_KEY: &[u8] = b"vlaps-link session 2 ";

/// The key of one direction of a session.
pub struct Cipher {
    key: LessSafeKey,
    direction: [u8; 4],
}

/// The keys of one session: one for each direction, so that nothing sent can be sent back.
pub struct SessionKeys {
    /// From the peer to the vehicle.
    pub up: Cipher,
    /// From the vehicle to the peer.
    pub down: Cipher,
}

impl SessionKeys {
    /// Of a peer's key and the random numbers of both sides.
    pub fn of(peer: &hmac::Key, nonces: [[u8; 16]; 2]) -> Self {
        let cipher = |direction: [u8; 4]| {
            let mut context = hmac::Context::with_key(peer);
            context.update(SESSION_KEY);
            context.update(&direction);
            context.update(&nonces[0]);
            context.update(&nonces[1]);
            let bytes = context.sign();
            let key = UnboundKey::new(&CHACHA20_POLY1305, bytes.as_ref());
            let key = LessSafeKey::new(key.expect("SHA-256 has the 32 bytes of a key"));
            Cipher { key, direction }
        };
        Self {
            up: cipher(*b"up  "),
            down: cipher(*b"down"),
        }
    }
}

impl Cipher {
    fn nonce(&self, counter: u64) -> Nonce {
        let mut bytes = [0; 12];
        bytes[..4].copy_from_slice(&self.direction);
        bytes[4..].copy_from_slice(&counter.to_le_bytes());
        Nonce::assume_unique_for_key(bytes)
    }

    /// Encrypts the bytes from `head` on in place and adds the tag, which protects the first
    /// `head` bytes, too. A counter may be used once.
    pub fn seal(&self, counter: u64, bytes: &mut Vec<u8>, head: usize) {
        let (clear, body) = bytes.split_at_mut(head);
        let tag =
            self.key
                .seal_in_place_separate_tag(self.nonce(counter), Aad::from(&*clear), body);
        let tag = tag.expect("a packet is shorter than the 256 GB of a key");
        bytes.extend_from_slice(tag.as_ref());
    }

    /// The clear text of encrypted bytes behind this head; `None` when they were changed, or
    /// made with another key or counter.
    pub fn open(&self, counter: u64, head: &[u8], sealed: &[u8]) -> Option<Vec<u8>> {
        let mut bytes = sealed.to_vec();
        let opened = self
            .key
            .open_in_place(self.nonce(counter), Aad::from(head), &mut bytes);
        let length = opened.ok()?.len();
        bytes.truncate(length);
        Some(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys(peer: &[u8], nonces: [[u8; 16]; 2]) -> SessionKeys {
        SessionKeys::of(&hmac::Key::new(hmac::HMAC_SHA256, peer), nonces)
    }

    #[test]
    fn only_the_same_session_direction_counter_and_head_open_it() {
        let [a, b] = [[1; 16], [2; 16]];
        let own = keys(b"a peer", [a, b]);
        let mut bytes = b"head secret".to_vec();
        own.up.seal(7, &mut bytes, 5);
        assert_eq!(&bytes[..5], b"head ");
        assert!(!bytes.windows(6).any(|part| part == b"secret"));
        let (head, sealed) = bytes.split_at(5);
        assert_eq!(own.up.open(7, head, sealed), Some(b"secret".to_vec()));
        assert_eq!(own.up.open(8, head, sealed), None);
        assert_eq!(own.up.open(7, b"HEAD ", sealed), None);
        assert_eq!(own.down.open(7, head, sealed), None);
        for other in [
            keys(b"another", [a, b]),
            keys(b"a peer", [b, a]),
            keys(b"a peer", [a, a]),
        ] {
            assert_eq!(other.up.open(7, head, sealed), None);
        }
    }
}
