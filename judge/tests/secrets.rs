//! The API key is sent in one header and appears nowhere else.

use std::io::Write;
use std::sync::{Arc, Mutex};

use gate::model::{Asker, Fault};
use judge::standin::{Options, Server, ServerFault};
use shm_config::config::PromptPreset;
use tracing_subscriber::fmt::MakeWriter;

use crate::shared::{PATIENCE_S, ask, prompt, red_ahead, vlm};

const SECRET: &str = "sk-test-9f8e7d-never-to-be-seen";

#[derive(Clone, Default)]
struct Log(Arc<Mutex<Vec<u8>>>);

impl Write for Log {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().expect("whole").write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl<'a> MakeWriter<'a> for Log {
    type Writer = Self;

    fn make_writer(&'a self) -> Self {
        self.clone()
    }
}

#[test]
fn no_log_line_and_no_record_holds_the_key() {
    let log = Log::default();
    let subscriber = tracing_subscriber::fmt()
        .with_max_level(tracing::Level::TRACE)
        .with_writer(log.clone())
        .finish();
    let seen = tracing::subscriber::with_default(subscriber, || {
        // The stand-in repeats the header it was sent.
        let server = Server::start(Options {
            injected: Some(ServerFault::Unauthorized),
            ..Options::default()
        })
        .expect("started");
        let key = |name: &str| (name == "VLAPS_VLM_KEY").then(|| SECRET.to_string());
        let asker = Asker::with_environment(&vlm(server.url()), key).expect("usable");
        let asked = ask(
            &asker,
            &prompt(PromptPreset::Blind),
            &red_ahead(),
            PATIENCE_S,
        );
        assert_eq!(asked.reply, Err(Fault::Unauthorized));
        assert!(
            asked.said.contains("Bearer (key)"),
            "it was sent: {}",
            asked.said
        );
        format!("{asker:?} {asked:?} {:?}", asker.trouble())
    });
    let log = String::from_utf8(log.0.lock().expect("whole").clone()).expect("UTF-8");
    assert!(log.contains("http_401"), "something was logged: {log}");
    for text in [seen, log] {
        assert!(
            !text.contains(SECRET) && !text.contains("sk-test"),
            "{text}"
        );
    }
}

#[test]
fn the_key_does_not_follow_a_redirect() {
    let server = Server::start(Options {
        injected: Some(ServerFault::Redirect),
        ..Options::default()
    })
    .expect("started");
    let key = |_: &str| Some(SECRET.to_string());
    let asker = Asker::with_environment(&vlm(server.url()), key).expect("usable");
    let asked = ask(
        &asker,
        &prompt(PromptPreset::Blind),
        &red_ahead(),
        PATIENCE_S,
    );
    assert_eq!((asked.reply, asked.attempts), (Err(Fault::Redirect), 1));
    assert_eq!(server.requests(), 1, "no request followed the redirect");
}
