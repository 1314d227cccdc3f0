//! Records for the tests.
#![allow(dead_code, reason = "each test uses a part of it")]

use gate::presentation::picture::{Encoding, Picture, encode};
use gate::presentation::{Hue, Party, Reply, Showing};
use gate::query::Occasion;
use gate::record::{Asking, Outlook, Proposed, Record, VERSION};
use shm_config::message::Preference;

/// Colours unlike any other.
pub const SHOWING: Showing = Showing {
    first: Party::Expert,
    hues: [Hue::Red, Hue::Cyan],
};

/// A picture of a few bytes.
pub fn picture(shade: u8) -> Picture {
    let image = image::RgbImage::from_pixel(64, 64, image::Rgb([shade, 80, 90]));
    encode(&image, Encoding::Png).expect("a picture")
}

/// One asking with this reply.
pub fn asking(showing: Showing, reply: Reply, confidence: f64) -> Asking {
    Asking {
        showing,
        picture: String::new(),
        system: "You compare two paths.".into(),
        user: "Which path is safer?".into(),
        said: "{\"response\": \"A\"}".into(),
        served: "model-of-the-day".into(),
        reply: Some(reply),
        confidence: Some(confidence),
        fault: None,
        attempts: 1,
        latency_s: 0.25,
        tokens_in: 300,
        tokens_out: 20,
        cost_usd: 0.001,
    }
}

/// A question with these askings, where the path of `safer` truly was safer.
pub fn record(askings: Vec<Asking>, preference: Option<Preference>, safer: Party) -> Record {
    let proposed = Proposed {
        steer: 0.1,
        pedal: -0.25,
        clearance_m: 3.5,
        safe_s: 3.0,
        vetoed: false,
    };
    let outlook = |party: Party| Outlook {
        party,
        horizon_s: 3.0,
        contact_s: if party == safer { 3.0 } else { 1.2 },
        out_s: 3.0,
    };
    Record {
        version: VERSION,
        question: 0,
        tick: 42,
        episode: 0,
        taken_ns: 4_200_000_000,
        occasion: Occasion::Period,
        judge: "vlm".into(),
        preset: "blind".into(),
        model: "a-model".into(),
        speed_mps: 8.0,
        observation: None,
        expert: Some(proposed),
        policy: Some(proposed),
        latency_s: askings.iter().map(|asking| asking.latency_s).sum(),
        cost_usd: askings.iter().map(|asking| asking.cost_usd).sum(),
        askings,
        preference,
        fault: String::new(),
        heard_tick: 50,
        heard_ns: 5_000_000_000,
        net: None,
        foresight: Some([outlook(Party::Expert), outlook(Party::Policy)]),
        aftermath: None,
    }
}
