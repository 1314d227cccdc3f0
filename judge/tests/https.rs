//! HTTPS with a private certificate authority: it is trusted if and only if `vlm.ca_file`
//! names it.

use std::fs;
use std::io;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc;
use std::thread;

use gate::model::{Asker, Fault};
use gate::presentation::Reply;
use judge::standin::{Options, Server};
use rustls::ServerConfig;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use shm_config::config::{PromptPreset, Vlm};
use tempfile::tempdir;
use tokio::net::{TcpListener, TcpStream};
use tokio_rustls::TlsAcceptor;

use crate::shared::{PATIENCE_S, ask, prompt, red_ahead, runtime, vlm};

/// A private authority, and a certificate for 127.0.0.1 that it has signed, with its
/// key; `https/make.sh` makes them.
const AUTHORITY: &str = include_str!("https/authority.pem");
const CERTIFICATE: &str = include_str!("https/server.pem");
const KEY: &str = include_str!("https/server-key.pem");

/// Puts an HTTPS proxy before a server until the test ends.
fn encrypt(server: SocketAddr) -> SocketAddr {
    let _ = rustls::crypto::ring::default_provider().install_default();
    let certificate = CertificateDer::from_pem_slice(CERTIFICATE.as_bytes());
    let key = PrivateKeyDer::from_pem_slice(KEY.as_bytes());
    let config = ServerConfig::builder()
        .with_no_client_auth()
        .with_single_cert(vec![certificate.expect("PEM")], key.expect("PEM"))
        .expect("a certificate with its key");
    let acceptor = TlsAcceptor::from(Arc::new(config));
    let (address, bound) = mpsc::channel();
    thread::spawn(move || {
        runtime().block_on(async move {
            let listener = TcpListener::bind("127.0.0.1:0").await?;
            let _ = address.send(listener.local_addr()?);
            loop {
                let (outside, _) = listener.accept().await?;
                // A client that does not trust the certificate closes the connection here.
                if let Ok(mut outside) = acceptor.accept(outside).await {
                    let mut inside = TcpStream::connect(server).await?;
                    let _ = tokio::io::copy_bidirectional(&mut outside, &mut inside).await;
                }
            }
            #[allow(unreachable_code)]
            io::Result::Ok(())
        })
    });
    bound.recv().expect("bound")
}

fn with_authorities(address: SocketAddr, ca_file: &Path) -> Vlm {
    Vlm {
        ca_file: ca_file.display().to_string(),
        ..vlm(format!("https://{address}/v1"))
    }
}

#[test]
fn a_private_authority_is_trusted_when_it_is_named() {
    let folder = tempdir().expect("a folder");
    let server = Server::start(Options::default()).expect("started");
    let address = encrypt(server.address());
    let ca_file = folder.path().join("authority.pem");
    fs::write(&ca_file, AUTHORITY).expect("written");

    let named = with_authorities(address, &ca_file);
    let asker = Asker::with_environment(&named, |_| None).expect("usable");
    let asked = ask(
        &asker,
        &prompt(PromptPreset::Blind),
        &red_ahead(),
        PATIENCE_S,
    );
    assert_eq!(asked.reply.map(|(reply, _)| reply), Ok(Reply::First));
    assert_eq!(
        asked.served, "vlaps-stand-in",
        "the served model is reported"
    );

    let unnamed = vlm(format!("https://{address}/v1"));
    // Without any authority of the system, no client can be made.
    if let Ok(asker) = Asker::with_environment(&unnamed, |_| None) {
        let asked = ask(
            &asker,
            &prompt(PromptPreset::Blind),
            &red_ahead(),
            PATIENCE_S,
        );
        assert_eq!(asked.reply, Err(Fault::Tls), "its authority is unknown");
    }
    assert_eq!(server.requests(), 1);
}

#[test]
fn unreadable_authorities_are_reported_before_a_request() {
    let folder = tempdir().expect("a folder");
    let address = "127.0.0.1:1".parse().expect("an address");
    let refused = |path: &Path| {
        let asker = Asker::with_environment(&with_authorities(address, path), |_| None);
        asker.expect_err("refused").to_string()
    };
    let path = folder.path().join("none.pem");
    let said = refused(&path);
    assert!(
        said.contains("vlm.ca_file") && said.contains("none.pem"),
        "{said}"
    );
    fs::write(&path, "no certificate").expect("written");
    let said = refused(&path);
    assert!(said.contains("no certificate"), "{said}");
    let broken = "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n";
    fs::write(&path, broken).expect("written");
    let said = refused(&path);
    assert!(said.contains("vlm.ca_file"), "{said}");
    let said = refused(folder.path());
    assert!(said.contains("no file"), "{said}");
}
