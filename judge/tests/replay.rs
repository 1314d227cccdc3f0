//! The stand-in is asked the questions of a record again over HTTP.

use shm_config::message::Preference;
use std::sync::Arc;

use gate::model::Asker;
use gate::presentation::picture::{Photo, Picture, Proposals, Style, picture};
use gate::presentation::{Party, Prompt, Reply, Showing};
use gate::record::Record;
use gate::record::store::{Store, read};
use judge::pixels::PixelRules;
use judge::replay::{Comparison, Replay, Step};
use judge::standin::{Options, Server};
use shm_config::config::{PromptPreset, View, Vlm};
use shm_config::message::Camera;
use shm_config::palette;
use vehicle::{Action, Vehicle};

use crate::records::{SHOWING, asking, record};

const SIZE: [u32; 2] = [480, 480];

/// A road of 12 m with ground on both sides; the expert's path goes straight on, the
/// policy's to the right.
fn shown(showing: Showing) -> Picture {
    let [width, height] = SIZE;
    let row = (0..width).flat_map(|x| match (192..288).contains(&x) {
        true => palette::ROAD,
        false => palette::GROUND,
    });
    let rgb = row.collect::<Vec<u8>>().repeat(height as usize);
    let photo = Photo {
        camera: &Camera::top_down(SIZE),
        width,
        height,
        rgb: &rgb,
    };
    let action = |steer| Action { steer, pedal: 0.0 };
    let proposals = Proposals {
        vehicle: &Vehicle::default(),
        speed_mps: 8.0,
        expert: action(0.0),
        policy: action(-0.3),
    };
    picture(photo, &proposals, showing, &Style::default()).expect("a picture")
}

/// A question with the wrong answer both times.
fn mistaken(tick: u64) -> Record {
    let showings = [SHOWING, SHOWING.swapped()];
    let replies = [Reply::Second, Reply::First];
    let askings = showings.iter().zip(replies).map(|(showing, reply)| {
        let prompt = Prompt::new(PromptPreset::Blind, *showing, View::TopDown, 3.0);
        let mut asking = asking(*showing, reply, 0.7);
        (asking.system, asking.user) = (prompt.system, prompt.user);
        asking
    });
    Record {
        tick,
        ..record(askings.collect(), Some(Preference::Policy), Party::Expert)
    }
}

#[test]
fn another_judge_is_asked_the_same_questions_once_and_a_replay_continues() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut store = Store::open(folder.path(), 1 << 24).expect("opens");
    let pictures = [SHOWING, SHOWING.swapped()].map(shown);
    for tick in 0..3 {
        store.begin(mistaken(tick), &pictures);
    }
    store.finish();
    let records = read(folder.path()).expect("reads");
    std::fs::remove_file(folder.path().join(&records.questions[1].askings[0].picture))
        .expect("removed");
    let server = Server::start(Options {
        rater: Arc::new(PixelRules),
        ..Options::default()
    })
    .expect("started");
    let vlm = Vlm {
        server: server.url(),
        model: "another".into(),
        key_env: String::new(),
        ..Vlm::default()
    };
    let out = folder.path().join("again");
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .expect("a runtime");
    let steps = || -> Vec<Step> {
        let asker = Asker::new(&vlm).expect("an asker");
        let mut replay = Replay::new(&vlm, asker, &out).expect("opens");
        let questions = records.questions.iter();
        questions
            .map(|record| runtime.block_on(replay.ask(&records, record)))
            .collect()
    };
    assert_eq!(steps(), [Step::Asked, Step::Gone, Step::Asked]);
    assert_eq!(server.requests(), 4);
    assert_eq!(steps(), [Step::Before, Step::Gone, Step::Before]);
    assert_eq!(server.requests(), 4, "nothing is asked twice");
    let again = read(&out).expect("reads");
    for record in &again.questions {
        assert_eq!(record.preference, Some(Preference::Expert), "{record:?}");
        assert_eq!(record.model, "another");
        assert!(out.join(&record.askings[1].picture).is_file());
    }
    let counts = Comparison::of(&records, &again).counts;
    assert_eq!(counts[1], [2, 0, 0, 0], "policy before, expert now");
}
