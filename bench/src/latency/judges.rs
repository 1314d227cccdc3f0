//! The rows of `--load judges`: behaviours of a judge.

use std::net::{Ipv4Addr, TcpListener};
use std::time::Duration;

use anyhow::Context;
use judge::standin::{Options, Server, ServerFault};

/// How a judge behaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JudgeBehaviour {
    /// There is no judge: the expert drives, without a gate process.
    Absent,
    /// Answers after a delay.
    Answers {
        /// Delay, s.
        after_s: f64,
    },
    /// Accepts the question and never answers.
    Hangs,
    /// No server listens.
    Refuses,
    /// Answers with 10 MB.
    Floods,
    /// Ends half way through the run.
    Dies,
}

impl JudgeBehaviour {
    /// All behaviours but `Absent`.
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

    /// Description in the table.
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

    /// Arguments of `./vlaps up`, with a placeholder for the judge's address.
    pub fn arguments(self) -> Vec<String> {
        match self {
            Self::Absent => words(None),
            _ => words(Some("http://localhost/v1")),
        }
    }

    /// Starts the judge.
    ///
    /// # Errors
    /// If it cannot bind a port.
    pub fn begin(self) -> anyhow::Result<RowJudge> {
        let options = match self {
            Self::Absent => None,
            Self::Answers { after_s } => Some(Options {
                latency: Duration::from_secs_f64(after_s),
                ..Options::default()
            }),
            Self::Hangs => Some(broken(ServerFault::Hang)),
            Self::Floods => Some(broken(ServerFault::HugeLength)),
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

fn broken(injected: ServerFault) -> Options {
    Options {
        injected: Some(injected),
        ..Options::default()
    }
}

/// Arguments of `./vlaps up` for a judge at this address, or without a judge.
fn words(url: Option<&str>) -> Vec<String> {
    let Some(url) = url else {
        return vec!["--gate".into(), "expert".into()];
    };
    let mut words = vec!["--gate".into(), "vlm".into()];
    for text in [
        format!("vlm.server={url}"),
        // Every question is asked, however many there are and however many fail.
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

/// The address of a port that was free a moment ago.
fn unused_address() -> anyhow::Result<String> {
    let address = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?.local_addr()?;
    Ok(format!("http://{address}/v1"))
}

/// A judge that serves one row.
pub struct RowJudge {
    conduct: JudgeBehaviour,
    server: Option<Server>,
    url: Option<String>,
    questions: u64,
}

impl RowJudge {
    /// Arguments of `./vlaps up`.
    pub fn arguments(&self) -> Vec<String> {
        words(self.url.as_deref())
    }

    /// Called at half of the run: a judge of `Dies` ends.
    pub fn half_way(&mut self) {
        if self.conduct == JudgeBehaviour::Dies
            && let Some(server) = self.server.take()
        {
            self.questions = server.requests();
        }
    }

    /// Number of requests so far.
    pub fn questions(&self) -> u64 {
        let now = self.server.as_ref().map_or(0, Server::requests);
        self.questions + now
    }
}
