//! One connection to the Zenoh router, as a client of it: no port is opened, nothing is
//! searched for on the network, and no other machine is contacted than the one that the
//! settings name.

use zenoh::liveliness::LivelinessToken;
use zenoh::{Config, Session, Wait};

use crate::names::{Endpoint, Node};
use crate::settings::Settings;

/// How long one attempt to connect may take, ms.
const ATTEMPT_MS: u64 = 1_000;

/// A session with the node that it is in ROS.
pub struct Link {
    /// The session.
    pub session: Session,
    /// The node.
    pub node: Node,
    _token: LivelinessToken,
}

impl Link {
    /// Connects to the router of the settings, as a node of this name. A session that loses
    /// its router connects again by itself, with all that was declared in it.
    ///
    /// # Errors
    /// One line: the router does not answer, or refuses.
    pub fn open(settings: &Settings, name: &str) -> Result<Self, String> {
        let config = config(&settings.router).map_err(|error| error.to_string())?;
        let session = zenoh::open(config).wait().map_err(|error| first(&error))?;
        let node = Node::new(settings.domain, session.zid(), name);
        let token = session.liveliness().declare_token(node.token()?).wait();
        Ok(Self {
            _token: token.map_err(|error| first(&error))?,
            session,
            node,
        })
    }

    /// Shows an end of a topic to others for as long as the token lives.
    ///
    /// # Errors
    /// When the session is closed.
    pub fn show(&self, endpoint: &Endpoint) -> Result<LivelinessToken, String> {
        let token = self
            .session
            .liveliness()
            .declare_token(endpoint.token.clone());
        token.wait().map_err(|error| first(&error))
    }

    /// Whether the router is there now.
    pub fn is_connected(&self) -> bool {
        self.session.info().routers_zid().wait().next().is_some()
    }
}

fn config(router: &str) -> zenoh::Result<Config> {
    let mut config = Config::default();
    let router = format!(
        "{{\"endpoints\": [{router:?}], \"timeout_ms\": {ATTEMPT_MS}, \"exit_on_failure\": true}}"
    );
    for (key, value) in [
        ("mode", "\"client\""),
        ("connect", router.as_str()),
        ("listen/endpoints", "[]"),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
    ] {
        config.insert_json5(key, value)?;
    }
    Ok(config)
}

/// The first line of an error without the place in the library that it is from.
pub fn first(error: &zenoh::Error) -> String {
    let text = error.to_string();
    let line = text.lines().next().unwrap_or_default();
    line.split(" at /").next().unwrap_or_default().to_string()
}

/// What is told of the connection: each change, once.
#[derive(Debug, Default)]
pub struct Connection {
    /// `None` before the first attempt.
    is_there: Option<bool>,
}

impl Connection {
    /// Takes the present state; a line if it has changed. A router that is there at first is
    /// told, too.
    pub fn note(&mut self, is_there: bool, router: &str) -> Option<String> {
        let before = self.is_there.replace(is_there);
        match (before, is_there) {
            (Some(before), now) if before == now => None,
            (_, true) => Some(format!("connected to the Zenoh router at {router}")),
            (None, false) => Some(format!(
                "no Zenoh router at {router}: start one, such as `ros2 run rmw_zenoh_cpp \
                 rmw_zenohd`; trying again each second"
            )),
            (Some(_), false) => Some(format!(
                "the Zenoh router at {router} is gone; trying again each second"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_router_that_comes_and_goes_is_told_once_each_time() {
        let mut connection = Connection::default();
        let mut told = |is_there| connection.note(is_there, "tcp/127.0.0.1:7447");
        assert!(told(false).is_some_and(|line| line.starts_with("no Zenoh router")));
        assert_eq!(told(false), None);
        assert!(told(true).is_some_and(|line| line.starts_with("connected")));
        assert_eq!(told(true), None);
        assert!(told(false).is_some_and(|line| line.contains("is gone")));
        assert_eq!(told(false), None);
    }

    #[test]
    fn nothing_listens_and_nothing_is_searched_for() {
        let config = config("tcp/127.0.0.1:7447").expect("a configuration");
        let get = |key: &str| config.get_json(key).expect(key);
        assert_eq!(get("mode"), "\"client\"");
        assert_eq!(get("listen/endpoints"), "[]");
        assert_eq!(get("connect/endpoints"), "[\"tcp/127.0.0.1:7447\"]");
        assert_eq!(get("scouting/multicast/enabled"), "false");
        assert_eq!(get("scouting/gossip/enabled"), "false");
    }
}
