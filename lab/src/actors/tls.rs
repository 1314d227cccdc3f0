//! Mutual TLS between a learner and the actors of other machines, with the certificates that
//! `./vlaps link` makes.
//!
//! The authority of a run signs one certificate for the side that listens, and one for each
//! invitation. That of an invitation names its role and its identity, so that an actor needs
//! both a certificate of the authority and the right name in it.

use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;

use anyhow::{Context, bail};
use rustls::client::verify_server_name;
use rustls::crypto::ring::default_provider;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use rustls::server::{ParsedCertificate, WebPkiClientVerifier};
use rustls::version::TLS13;
use rustls::{ClientConfig, RootCertStore, ServerConfig};
use serde::Deserialize;
use shm_config::file::read_private;
use shm_config::run::RunName;
use supervisor::cli::failure::Failure;

/// The name of the side that listens, as the authority writes it.
const LISTENER: &str = "vehicle.vlaps-link";
/// The name of an actor's role.
const ACTOR: &str = "actor.vlaps-link";
/// Ends the name of an identity.
const PEER: &str = "peer.vlaps-link";
/// Longest file of an invitation or of keys, bytes; as the link's.
const BYTES_MAX: u64 = 256 << 10;

/// A certificate with its key, PEM.
#[derive(Clone, Deserialize)]
pub struct CertifiedKey {
    /// The certificate.
    pub certificate: String,
    /// Its key.
    pub key: String,
}

/// What `./vlaps link invite --as actor` writes, as far as an actor needs it.
#[derive(Clone, Deserialize)]
pub struct Invitation {
    /// What it invites to.
    pub role: String,
    /// The identity of the invitation.
    pub peer: String,
    /// Where the learner listens.
    pub address: String,
    /// The authority's certificate, PEM.
    pub authority: String,
    /// The certificate of the invitation.
    pub certificate: CertifiedKey,
}

/// What the side that listens needs.
#[derive(Clone, Deserialize)]
pub struct ListenerKeys {
    /// The file of the run's keys, which says what is revoked.
    pub keys: PathBuf,
    /// The run's identity.
    pub identity: String,
    /// The authority's certificate, PEM.
    pub authority: String,
    /// The certificate of the side that listens.
    pub certificate: CertifiedKey,
}

/// The part of the run's keys that is read again and again.
#[derive(Deserialize)]
struct RunKeysFile {
    identity: String,
    revoked: Vec<String>,
}

impl Invitation {
    /// Reads one.
    ///
    /// # Errors
    /// When it is no invitation of an actor, or others may read it.
    pub fn read(path: &Path) -> anyhow::Result<Invitation> {
        let named = || path.display().to_string();
        let text = read_private(path, BYTES_MAX).with_context(named)?;
        let invitation: Invitation = serde_json::from_str(&text)
            .context("is no invitation that `./vlaps link invite` made")
            .with_context(named)?;
        if invitation.role != "actor" {
            let role = &invitation.role;
            bail!(
                "{}: invites a {role}; ./vlaps link invite --as actor makes one for actors",
                path.display()
            );
        }
        Ok(invitation)
    }
}

impl ListenerKeys {
    /// Those of a run, made by the program of `./vlaps link`.
    ///
    /// # Errors
    /// When that program is missing, or the run has no keys.
    pub fn of_run(run: Option<&RunName>) -> anyhow::Result<ListenerKeys> {
        let own = std::env::current_exe().context("the path of this program")?;
        let program = own.parent().unwrap_or(Path::new(".")).join("vlaps-link");
        let made = Command::new(&program)
            .args(["link", "listener"])
            .args(run.map(|run| format!("--run={run}")))
            .stdin(Stdio::null())
            .output();
        let made = made.map_err(|error| {
            Failure::Usage(format!(
                "--actors-at: {}: {error}; ./vlaps setup link builds it",
                program.display()
            ))
        })?;
        if !made.status.success() {
            let text = String::from_utf8_lossy(&made.stderr);
            let last = text.lines().last().unwrap_or_default().to_string();
            return Err(Failure::Usage(format!("--actors-at: {last}")).into());
        }
        serde_json::from_slice(&made.stdout).context("what vlaps-link printed")
    }

    /// The identities that are revoked; `None` when the keys are gone, unreadable, or others.
    pub fn revoked(&self) -> Option<Vec<String>> {
        let text = read_private(&self.keys, BYTES_MAX).ok()?;
        let file: RunKeysFile = serde_json::from_str(&text).ok()?;
        (file.identity == self.identity).then_some(file.revoked)
    }
}

fn roots(authority: &str) -> anyhow::Result<Arc<RootCertStore>> {
    let mut roots = RootCertStore::empty();
    let certificate = CertificateDer::from_pem_slice(authority.as_bytes());
    roots.add(certificate.context("the authority's certificate")?)?;
    Ok(roots.into())
}

type Parsed = (Vec<CertificateDer<'static>>, PrivateKeyDer<'static>);

fn parsed(own: &CertifiedKey) -> anyhow::Result<Parsed> {
    let certificate = CertificateDer::from_pem_slice(own.certificate.as_bytes());
    let key = PrivateKeyDer::from_pem_slice(own.key.as_bytes());
    Ok((
        vec![certificate.context("the certificate")?],
        key.context("its key")?,
    ))
}

/// TLS of the side that listens: only certificates of the authority are admitted.
///
/// # Errors
/// When a certificate or a key is damaged.
pub fn listening(keys: &ListenerKeys) -> anyhow::Result<Arc<ServerConfig>> {
    let provider = Arc::new(default_provider());
    let verifier =
        WebPkiClientVerifier::builder_with_provider(roots(&keys.authority)?, Arc::clone(&provider));
    let (chain, key) = parsed(&keys.certificate)?;
    let config = ServerConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&TLS13])?
        .with_client_cert_verifier(verifier.build()?)
        .with_single_cert(chain, key)?;
    Ok(config.into())
}

/// TLS of an actor.
///
/// # Errors
/// When a certificate or a key is damaged.
pub fn joining(invitation: &Invitation) -> anyhow::Result<Arc<ClientConfig>> {
    let (chain, key) = parsed(&invitation.certificate)?;
    let config = ClientConfig::builder_with_provider(default_provider().into())
        .with_protocol_versions(&[&TLS13])?
        .with_root_certificates(roots(&invitation.authority)?)
        .with_client_auth_cert(chain, key)?;
    Ok(config.into())
}

/// The name that an actor looks for in the certificate of the side that listens.
pub fn listener_name() -> ServerName<'static> {
    // A constant that is a name.
    ServerName::try_from(LISTENER).expect("a DNS name")
}

fn names(certificate: &CertificateDer<'_>, name: &str) -> bool {
    let named = ServerName::try_from(name.to_string()).map_err(io::Error::other);
    let parsed = ParsedCertificate::try_from(certificate).map_err(io::Error::other);
    match (named, parsed) {
        (Ok(name), Ok(certificate)) => verify_server_name(&certificate, &name).is_ok(),
        _ => false,
    }
}

/// Whether a certificate, which TLS has admitted, is one of an actor.
pub fn is_of_actor(certificate: &CertificateDer<'_>) -> bool {
    names(certificate, ACTOR)
}

/// Whether it is the one of the invitation with this identity.
pub fn is_of_peer(certificate: &CertificateDer<'_>, identity: &str) -> bool {
    let is_identity = identity.len() == 32 && identity.bytes().all(|byte| byte.is_ascii_hexdigit());
    is_identity && names(certificate, &format!("{identity}.{PEER}"))
}
