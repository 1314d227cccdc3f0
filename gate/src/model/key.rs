//! The key to a server. It is read from the environment or from a file that only its
//! owner can read, is sent in one header, and appears nowhere else.

use std::fmt;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use bytes::Bytes;
use reqwest::Url;
use reqwest::header::{HeaderValue, InvalidHeaderValue};
use shm_config::config::Vlm;
use shm_config::file::{NotOurs, open_private, user};
use zeroize::Zeroizing;

/// Longest key, bytes; the longest known keys have about 200.
const KEY_BYTES_MAX: usize = 4096;

/// The variable that is read for OpenAI's own server when nothing else is given.
const OPENAI_ENV: &str = "OPENAI_API_KEY";

/// OpenAI's own server.
const OPENAI_HOST: &str = "api.openai.com";

/// A key. It is overwritten when it is dropped, and it cannot be printed.
pub struct Key {
    text: Zeroizing<String>,
    /// The value of the header that carries it, marked as secret.
    header: HeaderValue,
}

impl fmt::Debug for Key {
    fn fmt(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        formatter.write_str("Key(..)")
    }
}

/// Why there is no usable key. The text never contains the key.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The file cannot be read.
    #[error("{path}: cannot read the key: {source}; check vlm.key_file")]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The path is a folder, a pipe or a device.
    #[error("{0}: not a regular file; vlm.key_file must be one")]
    NoFile(PathBuf),
    /// Other users have rights to the file.
    #[error(
        "{path}: other users may read or change this key file (mode {mode:04o}); run: chmod 600 {path}"
    )]
    Open {
        /// The file.
        path: PathBuf,
        /// Its mode.
        mode: u32,
    },
    /// The file belongs to another user.
    #[error("{path}: this key file belongs to user {owner}, not to you ({us}); make your own copy")]
    Owner {
        /// The file.
        path: PathBuf,
        /// The user id of its owner.
        owner: u32,
        /// The user id of this process.
        us: u32,
    },
    /// The key is empty, too long, or not one word.
    #[error(
        "{origin}: no key: a key must be one word of visible ASCII, at most {KEY_BYTES_MAX} bytes"
    )]
    Malformed {
        /// The file or the variable.
        origin: String,
    },
    /// OpenAI answers no request without a key.
    #[error(
        "no key for {OPENAI_HOST}: set the environment variable {env}, or name a file in vlm.key_file"
    )]
    Missing {
        /// The variable.
        env: String,
    },
    /// The key would be sent unencrypted.
    #[error(
        "the key would be sent unencrypted to {host}: make vlm.server begin with https://, or set \
         vlm.key_over_http=true if you trust the network"
    )]
    InTheClear {
        /// The server.
        host: String,
    },
}

impl Key {
    /// The key for a server; `None` if none is given and none is needed.
    /// `variable` reads an environment variable.
    ///
    /// # Errors
    /// What is wrong with the key, and what to do.
    pub fn find(
        vlm: &Vlm,
        server: &Url,
        variable: impl Fn(&str) -> Option<String>,
    ) -> Result<Option<Self>, KeyError> {
        let host = server.host_str().unwrap_or_default();
        let key = match vlm.key_file.is_empty() {
            false => Some(Self::from_file(Path::new(&vlm.key_file))?),
            true => Self::from_environment(vlm, host, variable)?,
        };
        let is_clear = server.scheme() == "http" && !is_loopback(server);
        if key.is_some() && is_clear && !vlm.key_over_http {
            return Err(KeyError::InTheClear { host: host.into() });
        }
        Ok(key)
    }

    fn from_environment(
        vlm: &Vlm,
        host: &str,
        variable: impl Fn(&str) -> Option<String>,
    ) -> Result<Option<Self>, KeyError> {
        // OpenAI's own variable is used for OpenAI alone: its user has not meant it for
        // another server.
        let is_openai = host == OPENAI_HOST;
        let own = (!vlm.key_env.is_empty()).then_some(vlm.key_env.as_str());
        let names = own.into_iter().chain(is_openai.then_some(OPENAI_ENV));
        let found = names
            .filter_map(|name| Some((name, Zeroizing::new(variable(name)?))))
            .find(|(_, text)| !text.is_empty());
        match found {
            Some((name, text)) => Self::checked(&text, name).map(Some),
            None if is_openai => Err(KeyError::Missing {
                env: own.unwrap_or(OPENAI_ENV).into(),
            }),
            None => Ok(None),
        }
    }

    fn from_file(path: &Path) -> Result<Self, KeyError> {
        let failed = |source: io::Error| {
            let path = path.into();
            match NotOurs::within(&source) {
                Some(&NotOurs::Open { mode, .. }) => KeyError::Open { path, mode },
                Some(&NotOurs::Owner { owner, .. }) => KeyError::Owner {
                    path,
                    owner,
                    us: user(),
                },
                None if source.kind() == io::ErrorKind::InvalidInput => KeyError::NoFile(path),
                None => KeyError::Read { path, source },
            }
        };
        let file = open_private(path).map_err(failed)?;
        // Capacity for the whole key: a buffer that grows leaves copies behind.
        let mut text = Zeroizing::new(String::with_capacity(KEY_BYTES_MAX + 2));
        file.take(KEY_BYTES_MAX as u64 + 2)
            .read_to_string(&mut text)
            .map_err(failed)?;
        Self::checked(&text, &path.display().to_string())
    }

    fn checked(text: &str, origin: &str) -> Result<Self, KeyError> {
        let key = text.trim_end_matches(['\n', '\r']);
        let is_word = !key.is_empty() && key.bytes().all(|byte| byte.is_ascii_graphic());
        let header = bearer(key).ok();
        match header {
            Some(header) if is_word && key.len() <= KEY_BYTES_MAX => Ok(Self {
                text: Zeroizing::new(key.into()),
                header,
            }),
            _ => Err(KeyError::Malformed {
                origin: origin.into(),
            }),
        }
    }

    /// The header's value, marked as secret. Its bytes are overwritten when the key and
    /// the last request that holds them are dropped.
    pub(crate) fn header(&self) -> HeaderValue {
        self.header.clone()
    }

    /// `text` without the key, because servers may repeat what they received.
    pub(crate) fn redact(&self, text: &str) -> String {
        text.replace(self.text.as_str(), "(key)")
    }
}

/// The value of an `Authorization` header with this key.
fn bearer(key: &str) -> Result<HeaderValue, InvalidHeaderValue> {
    let mut text = Zeroizing::new(Vec::with_capacity(7 + key.len()));
    text.extend_from_slice(b"Bearer ");
    text.extend_from_slice(key.as_bytes());
    let mut value = HeaderValue::from_maybe_shared(Bytes::from_owner(text))?;
    value.set_sensitive(true);
    Ok(value)
}

/// Whether the server is on this machine.
pub(crate) fn is_loopback(server: &Url) -> bool {
    let host = server.host_str().unwrap_or_default();
    let host = host.trim_start_matches('[').trim_end_matches(']');
    let address = host.parse::<std::net::IpAddr>();
    host == "localhost" || address.is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    const SECRET: &str = "sk-test-4711-do-not-print";

    fn find(vlm: &Vlm, server: &str, set: &[(&str, &str)]) -> Result<Option<Key>, KeyError> {
        let variable = |name: &str| {
            let pair = set.iter().find(|(key, _)| *key == name)?;
            Some(pair.1.to_string())
        };
        Key::find(vlm, &server.parse().expect("an address"), variable)
    }

    fn at(server: &str, set: &[(&str, &str)]) -> Result<Option<Key>, KeyError> {
        find(&Vlm::default(), server, set)
    }

    fn file(folder: &Path, text: &str, mode: u32) -> Vlm {
        let path = folder.join(format!("key-{mode:o}-{}", text.len()));
        std::fs::write(&path, text).expect("written");
        let rights = std::fs::Permissions::from_mode(mode);
        std::fs::set_permissions(&path, rights).expect("set");
        Vlm {
            key_file: path.display().to_string(),
            ..Vlm::default()
        }
    }

    #[test]
    fn openais_variable_is_used_for_openai_alone() {
        let set = [("OPENAI_API_KEY", SECRET)];
        let openai = at("https://api.openai.com/v1", &set).expect("a key");
        assert_eq!(openai.expect("a key").text.as_str(), SECRET);
        for other in [
            "http://127.0.0.1:8080/v1",
            "https://api.openai.com.example/v1",
        ] {
            assert!(at(other, &set).expect("fine").is_none(), "{other}");
        }
        let error = at("https://api.openai.com/v1", &[]).expect_err("missing");
        assert!(error.to_string().contains("VLAPS_VLM_KEY"), "{error}");
    }

    #[test]
    fn a_key_is_sent_unencrypted_only_if_allowed() {
        let set = [("VLAPS_VLM_KEY", SECRET)];
        for server in [
            "http://127.0.0.1:1/v1",
            "http://[::1]:1",
            "http://localhost",
            "https://x",
        ] {
            assert!(at(server, &set).expect(server).is_some(), "{server}");
        }
        for server in [
            "http://10.0.0.7:8000/v1",
            "http://gpu/v1",
            "http://localhost.example",
        ] {
            let error = at(server, &set).expect_err(server).to_string();
            assert!(error.contains("vlm.key_over_http"), "{error}");
            assert!(at(server, &[]).expect("none, none sent").is_none());
        }
        let allowed = Vlm {
            key_over_http: true,
            ..Vlm::default()
        };
        assert!(
            find(&allowed, "http://gpu/v1", &set)
                .expect("allowed")
                .is_some()
        );
    }

    #[test]
    fn a_key_file_must_have_no_rights_for_others() {
        let folder = tempfile::tempdir().expect("a folder");
        let server = "https://x/v1";
        for mode in [0o600, 0o400] {
            let vlm = file(folder.path(), &format!("{SECRET}\n"), mode);
            let key = find(&vlm, server, &[]).expect("readable").expect("a key");
            assert_eq!(key.text.as_str(), SECRET, "without the end of the line");
        }
        for mode in [0o644, 0o640, 0o604, 0o620, 0o601] {
            let vlm = file(folder.path(), SECRET, mode);
            let error = find(&vlm, server, &[]).expect_err("open").to_string();
            assert!(error.contains("chmod 600"), "{error}");
            assert!(!error.contains(SECRET));
        }
    }

    #[test]
    fn an_invalid_key_is_refused_and_not_shown() {
        let folder = tempfile::tempdir().expect("a folder");
        let long = "k".repeat(KEY_BYTES_MAX + 1);
        for text in ["", "\n", "two words", "line\nline", "clé", long.as_str()] {
            let vlm = file(folder.path(), text, 0o600);
            let error = find(&vlm, "https://x/v1", &[])
                .expect_err("refused")
                .to_string();
            assert!(error.contains("no key"), "{error}");
            assert!(text.trim().is_empty() || !error.contains(text), "{error}");
        }
        let missing = Vlm {
            key_file: folder.path().join("none").display().to_string(),
            ..Vlm::default()
        };
        let error = find(&missing, "https://x/v1", &[]).expect_err("no file");
        assert!(matches!(error, KeyError::Read { .. }), "{error}");
        let folder_as_file = Vlm {
            key_file: folder.path().display().to_string(),
            ..Vlm::default()
        };
        let error = find(&folder_as_file, "https://x/v1", &[]).expect_err("a folder");
        assert!(matches!(error, KeyError::NoFile(_)), "{error}");
    }

    #[test]
    fn neither_debug_output_nor_an_echo_shows_the_key() {
        let key = Key::checked(SECRET, "test").expect("a key");
        assert!(!format!("{key:?}").contains("sk-"));
        assert!(!format!("{:?}", key.header()).contains("sk-"));
        let echoed = key.redact(&format!("invalid key: Bearer {SECRET}!"));
        assert_eq!(echoed, "invalid key: Bearer (key)!");
    }
}
