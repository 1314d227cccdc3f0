//! Parses a request. It uses only what any OpenAI-compatible server receives: the words
//! and the picture.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::{ImageFormat, ImageReader, Limits, RgbImage};
use serde_json::Value;
use shm_config::config::{PromptPreset, View};

use gate::presentation::Hue;
use gate::presentation::{PAPER_FORM, view_words};

/// Maximum side length of a picture, pixels.
const SIDE_MAX: u32 = 8192;

/// A parsed request.
pub struct Question {
    /// The requested form of answer.
    pub preset: PromptPreset,
    /// Camera of the picture.
    pub view: View,
    /// The colours of the first and the second path.
    pub hues: [Hue; 2],
    /// The picture.
    pub picture: RgbImage,
    /// Length of the words, bytes.
    pub words: usize,
}

impl Question {
    /// Parses a request.
    ///
    /// # Errors
    /// A description of what is invalid.
    pub fn read(body: &[u8]) -> Result<Self, String> {
        let body: Value = serde_json::from_slice(body).map_err(|error| error.to_string())?;
        let text = words(&body);
        let mut named = Vec::new();
        for word in text.split(|c: char| !c.is_alphanumeric()) {
            let hue = Hue::ALL.into_iter().find(|hue| hue.word() == word);
            named.extend(hue.filter(|hue| !named.contains(hue)));
        }
        let [first, second] = named[..] else {
            return Err(format!(
                "the words name {} colours of paths instead of two",
                named.len()
            ));
        };
        let url = parts(&body)
            .find_map(|part| part.get("image_url")?.get("url")?.as_str())
            .ok_or("no image_url in the messages")?;
        let is_top_down = text.contains(view_words(View::TopDown));
        Ok(Self {
            preset: preset(&body),
            view: match is_top_down {
                true => View::TopDown,
                false => View::Ego,
            },
            hues: [first, second],
            picture: decode(url)?,
            words: text.len(),
        })
    }
}

/// The form of answer that a request asks for.
pub fn preset(body: &Value) -> PromptPreset {
    match words(body).contains(PAPER_FORM) {
        true => PromptPreset::Paper,
        false => PromptPreset::Blind,
    }
}

fn messages(body: &Value) -> impl Iterator<Item = &Value> {
    let messages = body.get("messages").and_then(Value::as_array);
    messages.into_iter().flatten()
}

fn parts(body: &Value) -> impl Iterator<Item = &Value> {
    messages(body)
        .filter_map(|message| message.get("content")?.as_array())
        .flatten()
}

/// The words of all messages, in order.
fn words(body: &Value) -> String {
    let whole = messages(body).filter_map(|message| message.get("content")?.as_str());
    let in_parts = parts(body).filter_map(|part| part.get("text")?.as_str());
    whole.chain(in_parts).collect::<Vec<_>>().join("\n")
}

fn decode(url: &str) -> Result<RgbImage, String> {
    let (format, data) = [("png", ImageFormat::Png), ("jpeg", ImageFormat::Jpeg)]
        .into_iter()
        .find_map(|(name, format)| {
            let data = url.strip_prefix(&format!("data:image/{name};base64,"))?;
            Some((format, data))
        })
        .ok_or("image_url must be a base64 data: address of a PNG or JPEG")?;
    let bytes = STANDARD.decode(data).map_err(|error| error.to_string())?;
    let mut reader = ImageReader::with_format(std::io::Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_image_width = Some(SIDE_MAX);
    limits.max_image_height = Some(SIDE_MAX);
    reader.limits(limits);
    let picture = reader.decode().map_err(|error| error.to_string())?;
    Ok(picture.into_rgb8())
}
