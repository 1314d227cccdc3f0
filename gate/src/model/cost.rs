//! The cost of a question, before it is asked.

use serde::Serialize;
use shm_config::config::Vlm;

use crate::presentation::Prompt;

/// The highest cost of one request.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// Tokens of the picture.
    pub tokens_picture: u64,
    /// Tokens of the text, estimated at four bytes each.
    pub tokens_words: u64,
    /// The most tokens that the answer may have.
    pub tokens_out_max: u64,
    /// US dollars for all of them.
    pub cost_usd: f64,
}

/// The highest cost of one request about a picture of `size_px` (width, height).
pub fn estimate(vlm: &Vlm, prompt: &Prompt, size_px: [u32; 2]) -> Estimate {
    let tokens_picture = picture_tokens(vlm, size_px);
    let bytes = prompt.system.len() + prompt.user.len();
    // Role markers and the schema count too.
    let tokens_words = bytes.div_ceil(4) as u64 + 100;
    let tokens_out_max = u64::from(vlm.tokens_max);
    Estimate {
        tokens_picture,
        tokens_words,
        tokens_out_max,
        cost_usd: cost_usd(vlm, tokens_picture + tokens_words, tokens_out_max),
    }
}

/// The price of these tokens, US dollars.
pub fn cost_usd(vlm: &Vlm, tokens_in: u64, tokens_out: u64) -> f64 {
    let [price_in, price_out] = vlm.prices_usd();
    (tokens_in as f64 * price_in + tokens_out as f64 * price_out) / 1e6
}

/// How a family of models counts pictures.
#[derive(Clone, Copy)]
enum Rule {
    /// A base number of tokens, and a number for each tile of 512 pixels.
    Tiles { base: u64, tile: u64 },
    /// A number for each patch of 32 pixels; there are at most 1536 patches.
    Patches { factor: f64 },
}

/// OpenAI's table ("Images and vision", calculating costs), by the beginning of the
/// model's name; longer beginnings come first.
const RULES: &[(&str, Rule)] = &[
    ("gpt-4.1-mini", Rule::Patches { factor: 1.62 }),
    ("gpt-4.1-nano", Rule::Patches { factor: 2.46 }),
    ("gpt-5-mini", Rule::Patches { factor: 1.62 }),
    ("gpt-5-nano", Rule::Patches { factor: 2.46 }),
    ("o4-mini", Rule::Patches { factor: 1.72 }),
    (
        "gpt-4o-mini",
        Rule::Tiles {
            base: 2833,
            tile: 5667,
        },
    ),
    (
        "gpt-5",
        Rule::Tiles {
            base: 70,
            tile: 140,
        },
    ),
    (
        "o1",
        Rule::Tiles {
            base: 75,
            tile: 150,
        },
    ),
    (
        "o3",
        Rule::Tiles {
            base: 75,
            tile: 150,
        },
    ),
];

/// The rule of gpt-4o, gpt-4.1 and gpt-4.5, also used for unknown models.
const USUAL: Rule = Rule::Tiles {
    base: 85,
    tile: 170,
};

/// Tokens of a picture of `size_px`.
fn picture_tokens(vlm: &Vlm, size_px: [u32; 2]) -> u64 {
    let name = vlm.model_name();
    let known = RULES.iter().find(|(begin, _)| name.starts_with(begin));
    match known.map_or(USUAL, |(_, rule)| *rule) {
        Rule::Tiles { base, tile } => base + tile * tiles(size_px),
        Rule::Patches { factor } => (patches(size_px) as f64 * factor).ceil() as u64,
    }
}

/// Tiles of 512 pixels. The picture is first shrunk into a square of 2048, then to a
/// shorter side of 768; it is never enlarged.
fn tiles(size_px: [u32; 2]) -> u64 {
    let [width, height] = size_px.map(f64::from);
    let into_square = (2048.0 / width.max(height)).min(1.0);
    let to_short_side = (768.0 / (width.min(height) * into_square)).min(1.0);
    let scale = into_square * to_short_side;
    [width, height]
        .map(|side| (side * scale / 512.0).ceil() as u64)
        .iter()
        .product()
}

/// Patches of 32 pixels. The picture is first shrunk to at most 1536 patches, with a
/// whole number of them along the side that fits worse.
fn patches(size_px: [u32; 2]) -> u64 {
    const PATCHES_MAX: f64 = 1536.0;
    let [width, height] = size_px.map(f64::from);
    let count = |scale: f64| {
        let along = |side: f64| (side * scale / 32.0 - 1e-9).ceil();
        along(width) * along(height)
    };
    if count(1.0) <= PATCHES_MAX {
        return count(1.0) as u64;
    }
    let shrunk = (32.0 * 32.0 * PATCHES_MAX / (width * height)).sqrt();
    let fit = |side: f64| {
        let patches = side * shrunk / 32.0;
        patches.floor() / patches
    };
    count(shrunk * fit(width).min(fit(height))) as u64
}

#[cfg(test)]
mod tests {
    use shm_config::config::PromptPreset;
    use shm_config::config::View;

    use super::*;
    use crate::presentation::Showing;

    fn tokens(model: &str, size_px: [u32; 2]) -> u64 {
        let vlm = Vlm {
            model: model.into(),
            ..Vlm::default()
        };
        picture_tokens(&vlm, size_px)
    }

    #[test]
    fn picture_tokens_equal_the_examples_of_openai() {
        // The examples of its guide.
        assert_eq!(tokens("gpt-4o", [1024, 1024]), 765);
        assert_eq!(tokens("gpt-4o", [2048, 4096]), 1105);
        assert_eq!(tokens("gpt-4o", [512, 512]), 255);
        assert_eq!(tokens("gpt-4o", [513, 512]), 425);
        assert_eq!(tokens("gpt-4o-mini", [128, 64]), 8500);
        assert_eq!(tokens("gpt-4o-mini-2024-07-18", [9, 9]), 8500);
        assert_eq!(tokens("o4-mini", [1024, 1024]), 1762);
        assert_eq!(tokens("gpt-4.1-mini", [1800, 2400]), 2353);
        assert_eq!(patches([1800, 2400]), 1452);
        assert_eq!(patches([1024, 1024]), 1024);
    }

    #[test]
    fn a_question_costs_its_tokens_at_their_prices() {
        let vlm = Vlm {
            model: "gpt-4o".into(),
            price_in_usd: 2.5,
            price_out_usd: 10.0,
            tokens_max: 100,
            ..Vlm::default()
        };
        let prompt = Prompt::new(PromptPreset::Blind, Showing::PAPER, View::Ego, 3.0);
        let estimate = estimate(&vlm, &prompt, [512, 512]);
        assert_eq!(estimate.tokens_picture, 255);
        let tokens_in = (255 + estimate.tokens_words) as f64;
        let expected = (tokens_in * 2.5 + 100.0 * 10.0) / 1e6;
        assert!((estimate.cost_usd - expected).abs() < 1e-12);
    }

    #[test]
    fn another_server_costs_its_configured_price() {
        let local = Vlm {
            price_in_usd: 0.0,
            price_out_usd: 0.0,
            ..Vlm::default()
        };
        assert_eq!(cost_usd(&local, 1_000_000, 1_000_000), 0.0);
        let priced = Vlm {
            price_in_usd: 1.0,
            ..local
        };
        assert_eq!(cost_usd(&priced, 1_000_000, 1_000_000), 1.0);
    }
}
