//! What a judge can do to a run: each row of `--load judges`.

use std::net::{Ipv4Addr, TcpListener};
use std::time::Duration;

use anyhow::Context;
use judge::standin::{Mishap, Options, Server};

/// How a judge behaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Conduct {
    /// There is none: the expert drives, no gate process.
    Absent,
    /// Answers after so long.
    Answers {
        /// Seconds.
        after_s: f64,
    },
    /// Takes the question and never answers.
    Hangs,
    /// No server listens.
    Refuses,
    /// Answers with 10 MB.
    Floods,
    /// Dies half way through the run.
    Dies,
}

impl Conduct {
    /// All but the first.
    pub const BAD: [Self; 8] = [
        Self::Answers { after_s: 0.1 },
        Self::Answers { after_s: 1.0 },
        Self::Answers { after_s: 10.0 },
        Self::Answers { after_s: 30.0 },
        Self::Hangs,
        Self::Refuses,
        Self::Floods,
        Self::Dies,
    ];

    /// For the table.
    pub fn words(self) -> &'static str {
        match self {
            Self::Absent => "no judge",
            Self::Answers { after_s } if after_s < 1.0 => "judge answers in 0.1 s",
            Self::Answers { after_s } if after_s < 10.0 => "judge answers in 1 s",
            Self::Answers { after_s } if after_s < 30.0 => "judge answers in 10 s",
            Self::Answers { .. } => "judge answers in 30 s",
            Self::Hangs => "judge hangs",
            Self::Refuses => "judge refuses connections",
            Self::Floods => "judge answers 10 MB",
            Self::Dies => "judge dies half way",
        }
    }

    /// What a run beside it is started with; its address is not known yet.
    pub fn arguments(self) -> Vec<String> {
        match self {
            Self::Absent => words(None),
            _ => words(Some("http://localhost/v1")),
        }
    }

    /// The judge, ready to be asked.
    ///
    /// # Errors
    /// When no port can be had.
    pub fn begin(self) -> anyhow::Result<RowJudge> {
        let options = match self {
            Self::Absent => None,
            Self::Answers { after_s } => Some(Options {
                latency: Duration::from_secs_f64(after_s),
                ..Options::default()
            }),
            Self::Hangs => Some(broken(Mishap::Hang)),
            Self::Floods => Some(broken(Mishap::HugeLength)),
            Self::Refuses => None,
            Self::Dies => Some(Options::default()),
        };
        let server = options.map(Server::start).transpose();
        let server = server.context("the stand-in server")?;
        let url = match (&server, self) {
            (Some(server), _) => Some(server.url()),
            (None, Self::Refuses) => Some(unused_address()?),
            (None, _) => None,
        };
        Ok(RowJudge {
            conduct: self,
            server,
            url,
            questions: 0,
        })
    }
}

fn broken(mishap: Mishap) -> Options {
    Options {
        mishap: Some(mishap),
        ..Options::default()
    }
}

/// The words of a run with a judge at this address, or without one.
fn words(url: Option<&str>) -> Vec<String> {
    let Some(url) = url else {
        return vec!["--gate".into(), "expert".into()];
    };
    let mut words = vec!["--gate".into(), "vlm".into()];
    for text in [
        format!("vlm.server={url}"),
        // Every question is asked, however many there are and fail.
        "vlm.deadline_s=60".into(),
        "vlm.attempt_s=50".into(),
        "vlm.per_minute_max=10000".into(),
        "vlm.breaker_failures=1000".into(),
        "vlm.budget_usd=1000".into(),
        "gate.in_flight=8".into(),
        "vlm.in_flight_max=16".into(),
    ] {
        words.extend(["--set".into(), text]);
    }
    words
}

/// An address without a server: it was free a moment ago.
fn unused_address() -> anyhow::Result<String> {
    let address = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?.local_addr()?;
    Ok(format!("http://{address}/v1"))
}

/// A judge beside a run.
pub struct RowJudge {
    conduct: Conduct,
    server: Option<Server>,
    url: Option<String>,
    questions: u64,
}

impl RowJudge {
    /// What the run is started with.
    pub fn arguments(&self) -> Vec<String> {
        words(self.url.as_deref())
    }

    /// Half of the run is over: a judge that dies ends now.
    pub fn half_way(&mut self) {
        if self.conduct == Conduct::Dies
            && let Some(server) = self.server.take()
        {
            self.questions = server.requests();
        }
    }

    /// Requests that it had.
    pub fn questions(&self) -> u64 {
        let now = self.server.as_ref().map_or(0, Server::requests);
        self.questions + now
    }
}
