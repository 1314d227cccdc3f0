//! The certificates of a run: its authority, the vehicle's, and one for each peer.

use std::io;

use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose,
};
use serde::{Deserialize, Serialize};
use time::{Duration, OffsetDateTime};

/// The name in the vehicle's certificate. A peer does not compare names: the authority makes
/// one certificate for a vehicle alone, and a peer's is not one for a listener.
const VEHICLE: &str = "vehicle.vlaps-link";
/// How long authority and vehicle are valid; invitations end earlier.
const AUTHORITY_DAYS: i64 = 3650;
/// Certificates are valid from this long ago on: a peer's clock may be behind.
const BEFORE: Duration = Duration::hours(1);

/// A certificate with its key, PEM.
#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Certified {
    /// The certificate.
    pub certificate: String,
    /// Its key.
    pub key: String,
}

/// The certificate authority of a run.
#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Authority {
    name: String,
    made_epoch_s: i64,
    /// Its certificate, PEM.
    pub certificate: String,
    key: String,
}

fn failed(error: rcgen::Error) -> io::Error {
    io::Error::other(format!("cannot make a certificate: {error}"))
}

impl Authority {
    /// Makes one.
    ///
    /// # Errors
    /// When the system has no random numbers.
    #[allow(clippy::disallowed_methods)] // a certificate has a date
    pub fn make(run: &str) -> io::Result<Self> {
        let key = KeyPair::generate().map_err(failed)?;
        let mut authority = Self {
            name: format!("vlaps-link {run}"),
            made_epoch_s: OffsetDateTime::now_utc().unix_timestamp(),
            certificate: String::new(),
            key: key.serialize_pem(),
        };
        let certificate = authority.params()?.self_signed(&key).map_err(failed)?;
        authority.certificate = certificate.pem();
        Ok(authority)
    }

    fn params(&self) -> io::Result<CertificateParams> {
        let made = OffsetDateTime::from_unix_timestamp(self.made_epoch_s)
            .map_err(|error| io::Error::other(format!("the authority's date: {error}")))?;
        let mut params = CertificateParams::default();
        params
            .distinguished_name
            .push(DnType::CommonName, &*self.name);
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        params.key_usages = vec![
            KeyUsagePurpose::KeyCertSign,
            KeyUsagePurpose::DigitalSignature,
        ];
        params.not_before = made - BEFORE;
        params.not_after = made + Duration::days(AUTHORITY_DAYS);
        Ok(params)
    }

    fn sign(&self, params: &CertificateParams) -> io::Result<Certified> {
        let authority = KeyPair::from_pem(&self.key).map_err(failed)?;
        let issuer = Issuer::new(self.params()?, authority);
        let key = KeyPair::generate().map_err(failed)?;
        let certificate = params.signed_by(&key, &issuer).map_err(failed)?;
        Ok(Certified {
            certificate: certificate.pem(),
            key: key.serialize_pem(),
        })
    }

    /// The vehicle's certificate, made anew at each start.
    ///
    /// # Errors
    /// When the authority is damaged.
    pub fn vehicle(&self) -> io::Result<Certified> {
        let mut params = CertificateParams::new(vec![VEHICLE.into()]).map_err(failed)?;
        params.distinguished_name.push(DnType::CommonName, VEHICLE);
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
        let own = self.params()?;
        (params.not_before, params.not_after) = (own.not_before, own.not_after);
        self.sign(&params)
    }

    /// The certificate of a peer, which ends with its invitation. It names role and identity:
    /// the learner of actors has no more than TLS to tell them apart.
    ///
    /// # Errors
    /// When the authority is damaged, or the end is no date.
    pub fn client(
        &self,
        [role, peer]: &[String; 2],
        expires_epoch_s: u64,
    ) -> io::Result<Certified> {
        let end = i64::try_from(expires_epoch_s).ok();
        let end = end.and_then(|end| OffsetDateTime::from_unix_timestamp(end).ok());
        let end = end.ok_or_else(|| io::Error::other("the invitation ends at no date"))?;
        let names = vec![
            format!("{role}.vlaps-link"),
            format!("{peer}.peer.vlaps-link"),
        ];
        let mut params = CertificateParams::new(names).map_err(failed)?;
        let name = format!("{role} {peer}");
        params.distinguished_name.push(DnType::CommonName, name);
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
        params.not_before = self.params()?.not_before;
        params.not_after = end;
        self.sign(&params)
    }
}
