//! What the tests over HTTP share.
#![allow(dead_code, reason = "each test uses a part of it")]

use std::io::Cursor;
use std::time::Duration;

use gate::model::{Asked, Asker};
use gate::presentation::picture::Encoding;
use gate::presentation::picture::Picture;
use gate::presentation::{Hue, Party, Prompt, Showing};
use image::{ImageFormat, Rgb, RgbImage};
use shm_config::config::{PromptPreset, View, Vlm};

/// A limit that no test reaches, so that a busy machine fails no test.
pub const PATIENCE_S: f64 = 60.0;

/// The first path is red, the second blue.
pub const SHOWING: Showing = Showing {
    first: Party::Policy,
    hues: [Hue::Red, Hue::Blue],
};

/// The configuration for this server, with short waits between attempts.
pub fn vlm(server: String) -> Vlm {
    Vlm {
        server,
        attempts_max: 2,
        backoff_s: 0.001,
        backoff_max_s: 0.002,
        deadline_s: PATIENCE_S,
        attempt_s: PATIENCE_S,
        per_minute_max: 1000,
        budget_usd: 100.0,
        breaker_failures: 1000,
        ..Vlm::default()
    }
}

/// An asker without a key.
pub fn asker(vlm: &Vlm) -> Asker {
    Asker::with_environment(vlm, |_| None).expect("usable")
}

/// A red path straight ahead and a blue one that leaves to the right, or with the
/// colours exchanged.
pub fn picture(ahead: Hue, format: ImageFormat) -> Picture {
    let aside = if ahead == Hue::Red {
        Hue::Blue
    } else {
        Hue::Red
    };
    let mut image = RgbImage::from_pixel(120, 100, Rgb([90, 92, 95]));
    for row in 10..100_u32 {
        let right = 60 + (100 - row) / 2;
        for (hue, middle) in [(ahead, 60), (aside, right)] {
            for column in middle - 2..middle + 2 {
                image.put_pixel(column, row, Rgb(hue.rgb()));
            }
        }
    }
    let mut bytes = Vec::new();
    image
        .write_to(&mut Cursor::new(&mut bytes), format)
        .expect("encoded");
    Picture {
        bytes,
        encoding: match format {
            ImageFormat::Png => Encoding::Png,
            _ => Encoding::Jpeg,
        },
        width: 120,
        height: 100,
    }
}

/// The picture with the red path ahead.
pub fn red_ahead() -> Picture {
    picture(Hue::Red, ImageFormat::Png)
}

/// The prompt of a preset for [`SHOWING`], or for the paper's colours.
pub fn prompt(preset: PromptPreset) -> Prompt {
    let showing = gate::presentation::fixed_showing(preset).unwrap_or(SHOWING);
    Prompt::new(preset, showing, View::Ego, 3.0)
}

/// Asks one question and waits for its result.
pub fn ask(asker: &Asker, prompt: &Prompt, picture: &Picture, deadline_s: f64) -> Asked {
    let deadline = Duration::from_secs_f64(deadline_s);
    runtime().block_on(asker.ask(prompt, picture, deadline))
}

/// A runtime with one thread.
pub fn runtime() -> tokio::runtime::Runtime {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    builder.enable_all().build().expect("a runtime")
}
