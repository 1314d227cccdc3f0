//! A server of one's own behind HTTPS: its authority is trusted when
//! `vlm.ca_file` says so, and not otherwise.

#[path = "../../gate/tests/shared/mod.rs"]
mod shared;

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
use rcgen::{BasicConstraints, CertificateParams, IsCa, Issuer, KeyPair};
use rustls::ServerConfig;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer};
use shared::{PATIENCE_S, ask, prompt, red_ahead, runtime, vlm};
use shm_config::config::{PromptPreset, Vlm};
use tempfile::tempdir;
use tokio::net::{TcpListener, TcpStream};
use tokio_rustls::TlsAcceptor;

/// A firm's authority, and a server's certificate that it has signed.
struct Firm {
    authority_pem: String,
    certificate: CertificateDer<'static>,
    key: PrivateKeyDer<'static>,
}

fn firm() -> Result<Firm, rcgen::Error> {
    let mut authority = CertificateParams::new(Vec::new())?;
    authority.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    let authority_key = KeyPair::generate()?;
    let authority_pem = authority.self_signed(&authority_key)?.pem();
    let issuer = Issuer::new(authority, authority_key);
    let key = KeyPair::generate()?;
    let leaf = CertificateParams::new(vec!["127.0.0.1".into()])?.signed_by(&key, &issuer)?;
    Ok(Firm {
        authority_pem,
        certificate: leaf.der().clone(),
        key: PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(key.serialize_der())),
    })
}

/// Puts HTTPS before a server, until the test ends.
fn encrypt(server: SocketAddr, firm: &Firm) -> SocketAddr {
    let _ = rustls::crypto::ring::default_provider().install_default();
    let config = ServerConfig::builder()
        .with_no_client_auth()
        .with_single_cert(vec![firm.certificate.clone()], firm.key.clone_key())
        .expect("a certificate with its key");
    let acceptor = TlsAcceptor::from(Arc::new(config));
    let (address, bound) = mpsc::channel();
    thread::spawn(move || {
        runtime().block_on(async move {
            let listener = TcpListener::bind("127.0.0.1:0").await?;
            let _ = address.send(listener.local_addr()?);
            loop {
                let (outside, _) = listener.accept().await?;
                // Who does not trust the certificate hangs up here.
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
fn an_authority_of_ones_own_is_trusted_when_it_is_named() {
    let folder = tempdir().expect("a folder");
    let server = Server::start(Options::default()).expect("started");
    let firm = firm().expect("certificates");
    let address = encrypt(server.address(), &firm);
    let ca_file = folder.path().join("firm.pem");
    fs::write(&ca_file, &firm.authority_pem).expect("written");

    let named = with_authorities(address, &ca_file);
    let asker = Asker::with_environment(&named, |_| None).expect("usable");
    let asked = ask(
        &asker,
        &prompt(PromptPreset::Blind),
        &red_ahead(),
        PATIENCE_S,
    );
    assert_eq!(asked.reply.map(|(reply, _)| reply), Ok(Reply::First));
    assert_eq!(asked.served, "vlaps-stand-in", "who answered is told");

    let unnamed = vlm(format!("https://{address}/v1"));
    // Where the system itself trusts nobody, no client can be made at all.
    if let Ok(asker) = Asker::with_environment(&unnamed, |_| None) {
        let asked = ask(
            &asker,
            &prompt(PromptPreset::Blind),
            &red_ahead(),
            PATIENCE_S,
        );
        assert_eq!(asked.reply, Err(Fault::Tls), "nobody vouches for it");
    }
    assert_eq!(server.requests(), 1);
}

#[test]
fn authorities_that_cannot_be_read_are_told_before_anything_is_asked() {
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
