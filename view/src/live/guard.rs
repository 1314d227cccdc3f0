//! Which requests are answered: those of the user's own browser.
//!
//! A page of the internet can make a browser send requests to this server, and can let
//! its own name lead to this machine (DNS rebinding). Such requests carry that name in
//! `Host` or `Origin`, and are refused.

use std::fs;
use std::net::{IpAddr, SocketAddr};

use axum::http::header::{HOST, ORIGIN};
use axum::http::{HeaderMap, StatusCode};
use shm_config::file::user;
use subtle::ConstantTimeEq as _;

/// Random bytes of a token: 128 bits, as many as a key has that no one guesses.
const TOKEN_BYTES: usize = 16;
/// Longest list of the machine's connections that is read, bytes.
const CONNECTIONS_MAX: u64 = 16 << 20;

/// What a request has to prove.
#[derive(Debug, Clone)]
pub struct Guard {
    /// The first part of every path; `None` when only this machine can connect.
    token: Option<String>,
    /// The name of this machine, under which others reach it.
    name: String,
}

/// Pages that may connect as viewers without a token: Foxglove's web application, and the
/// desktop programs, whose pages are files. A browser tells the origin of a page, and a page
/// cannot change it.
const VIEWERS: [&str; 2] = ["https://app.foxglove.dev", "file://"];

/// Why a request is refused.
pub type Refused = (StatusCode, &'static str);

const FOREIGN_PAGE: Refused = (StatusCode::FORBIDDEN, "a foreign page sent this request\n");

impl Guard {
    /// For a server that listens here: without a token on the loopback alone.
    ///
    /// # Errors
    /// When the system gives no random bytes.
    pub fn new(address: SocketAddr) -> std::io::Result<Self> {
        let token = match address.ip().is_loopback() {
            true => None,
            false => Some(random_token()?),
        };
        let name = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
        let name = name.trim().into();
        Ok(Self { token, name })
    }

    /// The path under which the page lies, with slashes around it.
    pub fn root(&self) -> String {
        match &self.token {
            Some(token) => format!("/{token}/"),
            None => "/".into(),
        }
    }

    /// The rest of a request's path behind the token.
    ///
    /// # Errors
    /// When the token is wrong or missing.
    pub fn rest<'a>(&self, path: &'a str) -> Result<&'a str, Refused> {
        let path = path.strip_prefix('/').unwrap_or(path);
        let Some(token) = &self.token else {
            return Ok(path);
        };
        let (given, rest) = path.split_once('/').unwrap_or((path, ""));
        // The time that it takes says nothing about the token.
        match bool::from(given.as_bytes().ct_eq(token.as_bytes())) {
            true => Ok(rest),
            false => Err((
                StatusCode::FORBIDDEN,
                "the address has no valid token: open the one that ./vlaps view printed\n",
            )),
        }
    }

    /// Checks where a request comes from.
    ///
    /// # Errors
    /// When `Host` or `Origin` is foreign, or another user of this machine sent it.
    pub fn check(
        &self,
        headers: &HeaderMap,
        (from, here): (SocketAddr, SocketAddr),
    ) -> Result<(), Refused> {
        let host = self.host(headers)?;
        for origin in headers.get_all(ORIGIN) {
            let name = origin.to_str().ok();
            let name = name.and_then(|name| name.strip_prefix("http://"));
            if name != Some(host) {
                return Err(FOREIGN_PAGE);
            }
        }
        self.owner(from, here)
    }

    /// Checks where a viewer's request comes from: as [`Guard::check`], but a viewer is a page
    /// of another origin. Behind a token any may be; without one, those that this program
    /// knows, and pages of this machine.
    ///
    /// # Errors
    /// As [`Guard::check`].
    pub fn check_viewer(
        &self,
        headers: &HeaderMap,
        (from, here): (SocketAddr, SocketAddr),
    ) -> Result<(), Refused> {
        self.host(headers)?;
        let mut origins = headers.get_all(ORIGIN).iter();
        let is_known = |origin: &str| {
            let local = origin.strip_prefix("http://");
            let is_local = local.is_some_and(|name| self.token.is_none() && self.is_ours(name));
            self.token.is_some() || VIEWERS.contains(&origin) || is_local
        };
        match origins.all(|origin| origin.to_str().is_ok_and(is_known)) {
            true => self.owner(from, here),
            false => Err(FOREIGN_PAGE),
        }
    }

    /// The `Host` of a request, if it is this server.
    fn host<'a>(&self, headers: &'a HeaderMap) -> Result<&'a str, Refused> {
        let mut hosts = headers.get_all(HOST).iter();
        let host = hosts.next().and_then(|host| host.to_str().ok());
        let host = host.filter(|host| self.is_ours(host) && hosts.next().is_none());
        host.ok_or((
            StatusCode::FORBIDDEN,
            "the Host header names another server\n",
        ))
    }

    /// Refuses other users of this machine.
    fn owner(&self, from: SocketAddr, here: SocketAddr) -> Result<(), Refused> {
        match self.token.is_some() || is_of_this_user(from, here) {
            true => Ok(()),
            false => Err((
                StatusCode::FORBIDDEN,
                "this run belongs to another user of the machine\n",
            )),
        }
    }

    /// Whether a `Host` is this server: an address or the machine's own name, which no
    /// foreign page can have.
    fn is_ours(&self, host: &str) -> bool {
        let name = match host.rsplit_once(':') {
            Some((name, port)) if port.parse::<u16>().is_ok() => name,
            _ => host,
        };
        if name.eq_ignore_ascii_case("localhost") {
            return true;
        }
        let bare = name
            .strip_prefix('[')
            .and_then(|name| name.strip_suffix(']'));
        let Ok(address) = bare.unwrap_or(name).parse::<IpAddr>() else {
            let is_name = !name.is_empty() && name.eq_ignore_ascii_case(&self.name);
            return self.token.is_some() && is_name;
        };
        address.is_loopback() || self.token.is_some()
    }
}

fn random_token() -> std::io::Result<String> {
    use std::io::Read as _;
    let mut bytes = [0; TOKEN_BYTES];
    fs::File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Whether a connection within this machine is of the calling user or of root, as the
/// kernel's table of connections says. Every user may connect to the loopback, but
/// another user must not read a run.
fn is_of_this_user(from: SocketAddr, here: SocketAddr) -> bool {
    let table = match from {
        SocketAddr::V4(_) => "/proc/self/net/tcp",
        SocketAddr::V6(_) => "/proc/self/net/tcp6",
    };
    let text = shm_config::file::read(std::path::Path::new(table), CONNECTIONS_MAX);
    let owner = owner_in(
        &String::from_utf8_lossy(&text.unwrap_or_default()),
        from,
        here,
    );
    is_admitted(owner)
}

/// Whether a socket with this owner may read; `None` if its owner is unknown.
fn is_admitted(owner: Option<u32>) -> bool {
    owner.is_some_and(|owner| owner == user() || owner == 0)
}

/// The user id of the socket that is bound to `from` and connected to `here`.
fn owner_in(table: &str, from: SocketAddr, here: SocketAddr) -> Option<u32> {
    let (from, here) = (in_table(from), in_table(here));
    table.lines().skip(1).find_map(|line| {
        let mut words = line.split_whitespace().skip(1);
        let is_it = words.next() == Some(from.as_str()) && words.next() == Some(here.as_str());
        // Behind the two addresses: state, queues, timer, retransmits, user id.
        let owner = words.nth(4)?;
        is_it.then(|| owner.parse().ok())?
    })
}

/// An address as the kernel writes it: words of 32 bits in the machine's order.
fn in_table(address: SocketAddr) -> String {
    let octets = match address.ip() {
        IpAddr::V4(ip) => ip.octets().to_vec(),
        IpAddr::V6(ip) => ip.octets().to_vec(),
    };
    let words = octets.chunks_exact(4).map(|word| {
        let word = word.try_into().map_or(0, u32::from_ne_bytes);
        format!("{word:08X}")
    });
    format!("{}:{:04X}", words.collect::<String>(), address.port())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guard(address: &str) -> Guard {
        let address = address.parse().expect("an address");
        let mut guard = Guard::new(address).expect("a guard");
        guard.name = "robot-7".into();
        guard
    }

    fn headers(pairs: &[(&'static str, &str)]) -> HeaderMap {
        let mut headers = HeaderMap::new();
        for (name, value) in pairs {
            headers.append(*name, value.parse().expect("a value"));
        }
        headers
    }

    #[test]
    fn a_name_of_the_internet_is_refused() {
        let open = guard("0.0.0.0:8090");
        let near = guard("127.0.0.1:8090");
        for host in ["localhost", "localhost:9", "127.0.0.1:8090", "[::1]:8090"] {
            assert!(near.is_ours(host) && open.is_ours(host), "{host}");
        }
        for host in ["10.0.0.7:8090", "robot-7:8090", "ROBOT-7"] {
            assert!(!near.is_ours(host) && open.is_ours(host), "{host}");
        }
        for host in [
            "evil.example",
            "evil.example:8090",
            "",
            ":",
            "localhost.evil",
            "127.0.0.1.evil",
        ] {
            assert!(!near.is_ours(host) && !open.is_ours(host), "{host}");
        }
    }

    #[test]
    fn origin_and_host_must_agree() {
        let open = guard("0.0.0.0:8090");
        let anywhere: SocketAddr = "10.0.0.9:4000".parse().expect("an address");
        let check = |pairs: &[(&'static str, &str)]| {
            let told = open.check(&headers(pairs), (anywhere, anywhere));
            told.is_ok()
        };
        assert!(check(&[("host", "10.0.0.7:8090")]));
        assert!(check(&[
            ("host", "10.0.0.7:80"),
            ("origin", "http://10.0.0.7:80")
        ]));
        assert!(!check(&[
            ("host", "10.0.0.7:80"),
            ("origin", "http://evil.example")
        ]));
        assert!(!check(&[("host", "10.0.0.7:80"), ("origin", "null")]));
        assert!(!check(&[("host", "10.0.0.7"), ("host", "evil.example")]));
        assert!(!check(&[]));
    }

    #[test]
    fn a_viewer_is_a_known_page_or_has_the_token() {
        let (open, near) = (guard("0.0.0.0:8765"), guard("127.0.0.1:8765"));
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
        let here = listener.local_addr().expect("an address");
        let client = std::net::TcpStream::connect(here).expect("a connection");
        let ends = (client.local_addr().expect("an address"), here);
        let asked = |guard: &Guard, origin: &str| {
            let headers = headers(&[("host", "127.0.0.1:8765"), ("origin", origin)]);
            guard.check_viewer(&headers, ends).is_ok()
        };
        for origin in [
            "https://app.foxglove.dev",
            "file://",
            "http://localhost:8080",
        ] {
            assert!(asked(&near, origin) && asked(&open, origin), "{origin}");
        }
        for origin in [
            "https://evil.example",
            "http://evil.example",
            "null",
            "https://app.foxglove.dev.evil.example",
        ] {
            assert!(!asked(&near, origin) && asked(&open, origin), "{origin}");
        }
        let foreign = headers(&[("host", "evil.example")]);
        assert!(near.check_viewer(&foreign, ends).is_err());
    }

    #[test]
    fn only_the_whole_token_opens() {
        let open = guard("0.0.0.0:8090");
        let token = open.root();
        assert_eq!(token.len(), 2 * TOKEN_BYTES + 2);
        assert_eq!(open.rest(&format!("{token}stream")), Ok("stream"));
        assert_eq!(open.rest(&token), Ok(""));
        assert!(open.rest("/").is_err() && open.rest("/stream").is_err());
        assert!(open.rest(&token[..token.len() - 2]).is_err());
        assert!(open.rest(&format!("/0{}", &token[1..])).is_err());
        assert_ne!(token, guard("0.0.0.0:8090").root());
        assert_eq!(guard("127.0.0.1:1").rest("/stream"), Ok("stream"));
    }

    #[test]
    fn the_kernels_table_names_the_owner_of_a_connection() {
        let table = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n\
             0: 0100007F:1F9A 00000000:0000 0A 00000000:00000000 00:00000000 00000000     0        0 1 1 0 100 0 0 10 0\n\
             1: 0100007F:C350 0100007F:1F9A 01 00000000:00000000 00:00000000 00000000  1000        0 2 1 0 20 4 30 10 -1\n";
        let at = |port: u16| SocketAddr::from(([127, 0, 0, 1], port));
        assert_eq!(owner_in(table, at(50_000), at(8_090)), Some(1000));
        assert_eq!(owner_in(table, at(50_001), at(8_090)), None);
        assert_eq!(owner_in("", at(1), at(2)), None);
    }

    #[test]
    fn a_connection_of_this_process_is_of_this_user() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
        let here = listener.local_addr().expect("an address");
        let client = std::net::TcpStream::connect(here).expect("a connection");
        let from = client.local_addr().expect("an address");
        assert!(is_of_this_user(from, here));
        drop(client);
        assert!(is_admitted(Some(0)) && is_admitted(Some(user())));
        assert!(!is_admitted(Some(user() + 1)) && !is_admitted(None));
    }
}
