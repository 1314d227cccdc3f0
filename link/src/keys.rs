//! The keys of a run, and what is given to a peer that is invited.
//!
//! A run has a secret, an identity and a certificate authority of its own. The key of a peer
//! is the secret's HMAC of all that the invitation says: identity, role, peer, end, and the
//! key with which a learner signs. So the vehicle keeps no list of keys, and no word of an
//! invitation can be changed without losing the key.

use std::fs::File;
use std::io;
use std::path::PathBuf;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use ring::rand::{SecureRandom as _, SystemRandom};
use ring::signature::{Ed25519KeyPair, KeyPair as _};
use ring::{digest, hmac};
use serde::{Deserialize, Serialize};
use shm_config::file::{Access, Durable, Entry, Folder, make_folders, read_private};
use shm_config::run::RunName;

use crate::certificate::{Authority, Certified};
use crate::role::Role;

/// The environment variable that names the folder of the keys.
pub const VARIABLE: &str = "VLAPS_LINK_KEYS";
/// Longest file of keys, bytes: a list of 1,000 revoked invitations fits.
const BYTES_MAX: u64 = 256 << 10;
/// What each key is derived under; another protocol makes other keys.
const PEER_KEY: &[u8] = b"vlaps-link peer key 1";

/// An identity of 16 bytes, in hexadecimal digits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct Identity(pub [u8; 16]);

impl Identity {
    /// A new one.
    ///
    /// # Errors
    /// When the system has no random numbers.
    pub fn new() -> io::Result<Self> {
        random().map(Self)
    }
}

impl std::fmt::Display for Identity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl From<Identity> for String {
    fn from(identity: Identity) -> Self {
        identity.to_string()
    }
}

impl TryFrom<String> for Identity {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let digits = text.as_bytes();
        let mut bytes = [0; 16];
        if digits.len() != 32 || !digits.iter().all(u8::is_ascii_hexdigit) {
            return Err("an identity has 32 hexadecimal digits".into());
        }
        for (byte, pair) in bytes.iter_mut().zip(text.as_bytes().chunks(2)) {
            let pair = std::str::from_utf8(pair).unwrap_or_default();
            *byte = u8::from_str_radix(pair, 16).unwrap_or_default();
        }
        Ok(Self(bytes))
    }
}

/// Random bytes of the system.
///
/// # Errors
/// When it has none.
pub fn random<const N: usize>() -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    let filled = SystemRandom::new().fill(&mut bytes);
    filled.map_err(|_| io::Error::other("the system gives no random numbers"))?;
    Ok(bytes)
}

/// What an invitation says, and what its key is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Claim {
    /// The run's identity.
    pub run: Identity,
    /// The peer's.
    pub peer: Identity,
    /// Its role.
    pub role: Role,
    /// Its end, s since 1970.
    pub expires_epoch_s: u64,
    /// The key that checks its signatures; zeros for a role that signs nothing.
    pub signer: [u8; 32],
}

/// The secrets of a run, on the vehicle.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunKeys {
    /// The run's name.
    pub run: String,
    /// The run's identity.
    pub identity: Identity,
    secret: String,
    /// The run's certificate authority.
    pub authority: Authority,
    /// Peers whose invitation has no effect any more.
    pub revoked: Vec<Identity>,
}

/// What a peer needs to join, in one file that its user alone may read.
#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bundle {
    /// The run's name on the vehicle.
    pub run: String,
    /// The run's identity.
    pub identity: Identity,
    /// The peer's role, as a word.
    pub role: String,
    /// The peer's identity.
    pub peer: Identity,
    /// Where the vehicle listens, `HOST:PORT`.
    pub address: String,
    /// The end, s since 1970.
    pub expires_epoch_s: u64,
    key: String,
    /// The learner's key that signs policy files; empty for other roles.
    signing_key: String,
    /// The certificate of the run's authority.
    pub authority: String,
    /// The peer's certificate with its key.
    pub certificate: Certified,
}

fn bytes_of<const N: usize>(what: &str, text: &str) -> io::Result<[u8; N]> {
    let bytes = STANDARD.decode(text).ok();
    let bytes = bytes.and_then(|bytes| bytes.try_into().ok());
    bytes.ok_or_else(|| io::Error::other(format!("{what} is damaged")))
}

/// The folder of all keys: that of [`VARIABLE`], else below the user's configuration.
///
/// # Errors
/// When neither is known.
pub fn folder() -> io::Result<PathBuf> {
    let home = |name: &str| std::env::var_os(name).filter(|path| !path.is_empty());
    if let Some(own) = home(VARIABLE) {
        return Ok(own.into());
    }
    let config = home("XDG_CONFIG_HOME").map(PathBuf::from);
    let config = config.or_else(|| Some(PathBuf::from(home("HOME")?).join(".config")));
    let config = config.ok_or_else(|| {
        io::Error::other(format!(
            "HOME is not set; name a folder for the keys by {VARIABLE}"
        ))
    })?;
    Ok(config.join("vlaps").join("link"))
}

fn made_folder() -> io::Result<Folder> {
    let path = folder()?;
    if let Some(above) = path.parent() {
        make_folders(above)?;
    }
    Folder::make(&path, Entry::Private)
}

impl RunKeys {
    /// Those of a run that has none.
    ///
    /// # Errors
    /// When the system has no random numbers.
    pub fn make(run: &str) -> io::Result<Self> {
        let identity = Identity::new()?;
        Ok(Self {
            run: run.into(),
            identity,
            secret: STANDARD.encode(random::<32>()?),
            authority: Authority::make(&identity.to_string())?,
            revoked: Vec::new(),
        })
    }

    /// The file of those of a run.
    ///
    /// # Errors
    /// As [`folder`].
    pub fn file(run: &RunName) -> io::Result<PathBuf> {
        Ok(folder()?.join(file_name(run)))
    }

    /// Reads those of a run; `None` when it has none.
    ///
    /// # Errors
    /// When the file is not the user's own, or damaged.
    pub fn read(run: &RunName) -> io::Result<Option<Self>> {
        let path = Self::file(run)?;
        let named =
            |error: io::Error| io::Error::new(error.kind(), format!("{}: {error}", path.display()));
        let text = match read_private(&path, BYTES_MAX) {
            Ok(text) => text,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(named(error)),
        };
        let keys: Self = serde_json::from_str(&text)
            .map_err(|error| named(io::Error::other(error.to_string())))?;
        bytes_of::<32>("the secret", &keys.secret).map_err(named)?;
        Ok(Some(keys))
    }

    /// Writes them, readable by the user alone.
    ///
    /// # Errors
    /// When the folder is not the user's own or cannot be written.
    pub fn write(&self, run: &RunName) -> io::Result<()> {
        let text = serde_json::to_string_pretty(self).map_err(io::Error::other)?;
        made_folder()?.replace(&file_name(run), text.as_bytes(), Durable::Yes)
    }

    /// Waits until no other command changes those of a run, and keeps others from it as long
    /// as the file is open: a change reads and writes the whole file.
    ///
    /// # Errors
    /// As [`RunKeys::write`].
    pub fn hold(run: &RunName) -> io::Result<File> {
        let file = made_folder()?.open_file(&format!("{run}.lock"), Access::Change)?;
        file.lock()?;
        Ok(file)
    }

    /// The key of a peer with this claim.
    pub fn peer_key(&self, claim: &Claim) -> hmac::Key {
        // Checked where they are read.
        let secret = bytes_of::<32>("the secret", &self.secret).unwrap_or_default();
        let bytes = derived(&secret, claim);
        hmac::Key::new(hmac::HMAC_SHA256, &bytes)
    }

    /// Invites a peer.
    ///
    /// # Errors
    /// When the system has no random numbers.
    pub fn invite(&self, role: Role, address: &str, expires_epoch_s: u64) -> io::Result<Bundle> {
        let peer = Identity::new()?;
        let (signing_key, signer) = match role {
            Role::Learner => {
                let seed = random::<32>()?;
                let pair = Ed25519KeyPair::from_seed_unchecked(&seed)
                    .map_err(|_| io::Error::other("cannot make a key that signs"))?;
                let public = pair.public_key().as_ref().try_into().unwrap_or_default();
                (STANDARD.encode(seed), public)
            }
            Role::Judge | Role::View | Role::Recorder | Role::Actor => (String::new(), [0; 32]),
        };
        let claim = Claim {
            run: self.identity,
            peer,
            role,
            expires_epoch_s,
            signer,
        };
        let secret = bytes_of::<32>("the secret", &self.secret)?;
        let names = [role.to_string(), peer.to_string()];
        Ok(Bundle {
            run: self.run.clone(),
            identity: self.identity,
            role: role.word().into(),
            peer,
            address: address.into(),
            expires_epoch_s,
            key: STANDARD.encode(derived(&secret, &claim)),
            signing_key,
            authority: self.authority.certificate.clone(),
            certificate: self.authority.client(&names, expires_epoch_s)?,
        })
    }
}

fn derived(secret: &[u8; 32], claim: &Claim) -> [u8; 32] {
    let key = hmac::Key::new(hmac::HMAC_SHA256, secret);
    let mut context = hmac::Context::with_key(&key);
    context.update(PEER_KEY);
    context.update(&claim.run.0);
    context.update(&claim.peer.0);
    context.update(&claim.role.code().to_le_bytes());
    context.update(&claim.expires_epoch_s.to_le_bytes());
    context.update(&claim.signer);
    context.sign().as_ref().try_into().unwrap_or_default()
}

impl Bundle {
    /// Reads one.
    ///
    /// # Errors
    /// When it is no bundle, or others may read it.
    pub fn read(path: &std::path::Path) -> io::Result<Self> {
        let named =
            |error: io::Error| io::Error::new(error.kind(), format!("{}: {error}", path.display()));
        let text = read_private(path, BYTES_MAX).map_err(named)?;
        let bundle: Self = serde_json::from_str(&text).map_err(|error| {
            named(io::Error::other(format!(
                "is no invitation that `./vlaps link invite` made: {error}"
            )))
        })?;
        bundle.check().map_err(named)?;
        Ok(bundle)
    }

    fn check(&self) -> io::Result<()> {
        bytes_of::<32>("its key", &self.key)?;
        if self.role()? == Role::Learner {
            self.signer()?;
        }
        Ok(())
    }

    /// Writes it, readable by the user alone. A file of that name is not replaced.
    ///
    /// # Errors
    /// When it exists or cannot be written.
    pub fn write(&self, path: &std::path::Path) -> io::Result<()> {
        use std::io::Write as _;
        use std::os::unix::fs::OpenOptionsExt as _;
        let text = serde_json::to_string_pretty(self).map_err(io::Error::other)?;
        let mut file = std::fs::OpenOptions::new()
            .write(true)
            .create_new(true)
            .mode(0o600)
            .open(path)?;
        file.write_all(text.as_bytes())?;
        file.sync_all()
    }

    /// The role.
    ///
    /// # Errors
    /// When there is no such role.
    pub fn role(&self) -> io::Result<Role> {
        Role::from_word(&self.role)
            .ok_or_else(|| io::Error::other(format!("there is no role {:?}", self.role)))
    }

    /// The peer's key.
    pub fn key(&self) -> hmac::Key {
        let bytes = bytes_of::<32>("its key", &self.key).unwrap_or_default();
        hmac::Key::new(hmac::HMAC_SHA256, &bytes)
    }

    /// The key that signs policy files.
    ///
    /// # Errors
    /// When the bundle has none.
    pub fn signer(&self) -> io::Result<Ed25519KeyPair> {
        let seed = bytes_of::<32>("its signing key", &self.signing_key)?;
        Ed25519KeyPair::from_seed_unchecked(&seed)
            .map_err(|_| io::Error::other("its signing key is damaged"))
    }

    /// What it claims.
    ///
    /// # Errors
    /// When it is damaged.
    pub fn claim(&self) -> io::Result<Claim> {
        let role = self.role()?;
        let signer = match role {
            Role::Learner => self.signer()?.public_key().as_ref().try_into(),
            Role::Judge | Role::View | Role::Recorder | Role::Actor => Ok([0; 32]),
        };
        Ok(Claim {
            run: self.identity,
            peer: self.peer,
            role,
            expires_epoch_s: self.expires_epoch_s,
            signer: signer.unwrap_or_default(),
        })
    }
}

/// SHA-256.
pub fn sha256(bytes: &[u8]) -> [u8; 32] {
    let digest = digest::digest(&digest::SHA256, bytes);
    digest.as_ref().try_into().unwrap_or_default()
}

fn file_name(run: &RunName) -> String {
    format!("{run}.json")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bundle(keys: &RunKeys, role: Role) -> Bundle {
        keys.invite(role, "127.0.0.1:7450", 4_000_000_000)
            .expect("an invitation")
    }

    fn is_of(keys: &RunKeys, claim: &Claim, bundle: &Bundle) -> bool {
        let tag = hmac::sign(&bundle.key(), b"x");
        hmac::verify(&keys.peer_key(claim), b"x", tag.as_ref()).is_ok()
    }

    #[test]
    fn no_word_of_an_invitation_can_be_changed() {
        let keys = RunKeys::make("drive").expect("keys");
        let bundle = bundle(&keys, Role::Judge);
        let claim = bundle.claim().expect("a claim");
        assert!(is_of(&keys, &claim, &bundle));
        let other = RunKeys::make("drive").expect("keys");
        assert!(!is_of(&other, &claim, &bundle));
        for changed in [
            Claim {
                role: Role::Learner,
                ..claim
            },
            Claim {
                expires_epoch_s: claim.expires_epoch_s + 1,
                ..claim
            },
            Claim {
                peer: Identity([0; 16]),
                ..claim
            },
            Claim {
                run: other.identity,
                ..claim
            },
            Claim {
                signer: [1; 32],
                ..claim
            },
        ] {
            assert!(!is_of(&keys, &changed, &bundle), "{changed:?}");
        }
    }

    #[test]
    fn a_bundle_that_others_may_read_or_that_is_cut_is_refused() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.bundle");
        let keys = RunKeys::make("drive").expect("keys");
        bundle(&keys, Role::Learner).write(&path).expect("written");
        let mode = std::fs::metadata(&path)
            .expect("a file")
            .permissions()
            .mode();
        assert_eq!(mode & 0o777, 0o600);
        let read = Bundle::read(&path).expect("read");
        assert_eq!(read.role().expect("a role"), Role::Learner);
        assert!(
            bundle(&keys, Role::Judge).write(&path).is_err(),
            "it is not replaced"
        );
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o644)).expect("a mode");
        let error = Bundle::read(&path).err().expect("refused").to_string();
        assert!(error.contains("chmod go-rwx"), "{error}");
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).expect("a mode");
        let text = std::fs::read(&path).expect("read");
        std::fs::write(&path, &text[..text.len() / 2]).expect("written");
        let error = Bundle::read(&path).err().expect("refused").to_string();
        assert!(error.contains("no invitation"), "{error}");
    }
}
