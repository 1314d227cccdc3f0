//! Connections to a server: trusted certificates, no redirects.

use reqwest::{Certificate, Url, redirect};
use shm_config::config::Vlm;

use super::key::{KeyError, is_loopback};

/// Largest file of certificates, bytes; a whole system's collection has 250 kB.
const CA_BYTES_MAX: u64 = 4 << 20;

/// Why the model cannot be asked: what is wrong, where, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum AskerError {
    /// The address is invalid.
    #[error("vlm.server = {server:?}: {why}; write it as http://127.0.0.1:8080/v1")]
    Server {
        /// The address.
        server: String,
        /// What is wrong with it.
        why: String,
    },
    /// The key cannot be used.
    #[error(transparent)]
    Key(#[from] KeyError),
    /// The certificates of the authorities cannot be used.
    #[error("{path}: {why}; vlm.ca_file must be a file of certificates in PEM")]
    Authorities {
        /// The file.
        path: String,
        /// What is wrong with it.
        why: String,
    },
    /// The HTTPS client cannot be made.
    #[error("cannot set up HTTPS: {0}; is the package ca-certificates installed?")]
    Client(String),
}

/// A client for this address; it opens no connection yet.
///
/// # Errors
/// When the authorities' certificates cannot be used.
pub fn client(vlm: &Vlm, url: &Url) -> Result<reqwest::Client, AskerError> {
    build(url, &authorities(vlm)?).map_err(|error| unusable(vlm, &error))
}

/// The authorities that are trusted beside those of the system.
fn authorities(vlm: &Vlm) -> Result<Vec<Certificate>, AskerError> {
    if vlm.ca_file.is_empty() {
        return Ok(Vec::new());
    }
    let failed = |why: String| AskerError::Authorities {
        path: vlm.ca_file.clone(),
        why,
    };
    let size = std::fs::metadata(&vlm.ca_file).map_err(|error| failed(error.to_string()))?;
    if !size.is_file() || size.len() > CA_BYTES_MAX {
        return Err(failed(format!("no file of at most {CA_BYTES_MAX} bytes")));
    }
    let pem = std::fs::read(&vlm.ca_file).map_err(|error| failed(error.to_string()))?;
    let found = Certificate::from_pem_bundle(&pem).map_err(|error| failed(error.to_string()))?;
    match found.is_empty() {
        true => Err(failed("no certificate in it".into())),
        false => Ok(found),
    }
}

/// The error of a client that cannot be made: with `vlm.ca_file`, one of its
/// certificates is the cause.
fn unusable(vlm: &Vlm, error: &reqwest::Error) -> AskerError {
    match vlm.ca_file.as_str() {
        "" => AskerError::Client(error.to_string()),
        path => AskerError::Authorities {
            path: path.into(),
            why: error.to_string(),
        },
    }
}

fn build(url: &Url, authorities: &[Certificate]) -> Result<reqwest::Client, reqwest::Error> {
    // Another part of this process may have installed a provider already; any will do.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let mut builder = reqwest::Client::builder()
        .http1_only()
        .retry(reqwest::retry::never())
        // The key must not follow a redirect.
        .redirect(redirect::Policy::none())
        .user_agent(concat!("vlaps/", env!("CARGO_PKG_VERSION")));
    if is_loopback(url) {
        builder = builder.no_proxy();
    }
    if !authorities.is_empty() {
        builder = builder.tls_certs_merge(authorities.iter().cloned());
    }
    if url.scheme() == "http" {
        // Without encryption no certificate is checked, so none needs to be installed.
        builder = builder.tls_certs_only([]);
    }
    builder.build()
}
