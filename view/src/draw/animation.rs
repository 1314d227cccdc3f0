//! Writes pictures as an animated PNG with a palette, which browsers and GitHub play.
//!
//! A frame holds only the rectangle that has changed; pixels in it that have not are
//! transparent. One palette for all frames keeps colours from flickering.

use std::collections::HashMap;
use std::io::Write;

use anyhow::Context;
use png::{BitDepth, BlendOp, ColorType, Compression, DisposeOp, Encoder, Filter, Writer};

use super::palette;
use super::raster::rgb;

/// Frames of which the palette is made; their memory is the largest part of a conversion.
const SAMPLES: usize = 24;
/// Colours of a PNG palette.
const COLOURS: usize = 256;
/// The palette's entry for pixels that have not changed.
const SAME: u8 = 0;
/// Colours of the palette that are nearer than this are one, in the cube of bytes.
const APART: i32 = 6;
/// Bits of a colour's parts by which the nearest entry is remembered.
const BITS: u32 = 5;

/// Size and speed of an animation.
#[derive(Clone, Copy, Debug)]
pub struct Format {
    /// Width and height, px.
    pub size_px: [u32; 2],
    /// Number of frames.
    pub frames: u32,
    /// Time of a frame, ms.
    pub frame_ms: u16,
    /// Time of the last frame, ms.
    pub last_ms: u16,
}

/// An animation that is being written.
pub struct Animation<W: Write> {
    format: Format,
    state: State<W>,
    written: u32,
}

enum State<W: Write> {
    /// The palette is not known yet.
    Collecting(W, Vec<Vec<u8>>),
    Writing(Box<Open<W>>),
    /// An error ended it.
    Broken,
}

struct Open<W: Write> {
    writer: Writer<W>,
    palette: Palette,
    before: Vec<u8>,
}

impl<W: Write> Animation<W> {
    /// Begins an animation.
    pub fn new(out: W, format: Format) -> Animation<W> {
        Animation {
            format,
            state: State::Collecting(out, Vec::new()),
            written: 0,
        }
    }

    /// Adds a frame: row by row from the top, red, green and blue.
    ///
    /// # Errors
    /// When the file cannot be written, or the frame has another size.
    pub fn add(&mut self, frame: Vec<u8>) -> anyhow::Result<()> {
        let [width, height] = self.format.size_px.map(|side| side as usize);
        anyhow::ensure!(
            frame.len() == 3 * width * height,
            "a frame has another size than {width} x {height}"
        );
        match &mut self.state {
            State::Collecting(_, frames) => {
                frames.push(frame);
                let least = SAMPLES.min(self.format.frames as usize);
                match frames.len() < least {
                    true => Ok(()),
                    false => self.begin(),
                }
            }
            State::Writing(_) => self.write(&frame),
            State::Broken => anyhow::bail!("the animation could not be written"),
        }
    }

    /// Makes the palette and writes what was collected.
    fn begin(&mut self) -> anyhow::Result<()> {
        let State::Collecting(out, frames) = std::mem::replace(&mut self.state, State::Broken)
        else {
            return Ok(());
        };
        let palette = Palette::of(&frames);
        let [width, height] = self.format.size_px;
        let mut encoder = Encoder::new(out, width, height);
        encoder.set_color(ColorType::Indexed);
        encoder.set_depth(BitDepth::Eight);
        encoder.set_palette(palette.colours.concat());
        encoder.set_trns(vec![0]);
        encoder.set_compression(Compression::High);
        encoder.set_filter(Filter::NoFilter);
        encoder.set_animated(self.format.frames, 0)?;
        let open = Open {
            writer: encoder.write_header()?,
            palette,
            before: Vec::new(),
        };
        self.state = State::Writing(Box::new(open));
        frames.iter().try_for_each(|frame| self.write(frame))
    }

    fn write(&mut self, frame: &[u8]) -> anyhow::Result<()> {
        let State::Writing(open) = &mut self.state else {
            return Ok(());
        };
        let now = open.palette.indexed(frame);
        let size = self.format.size_px.map(|side| side as usize);
        self.written += 1;
        let is_last = self.written == self.format.frames;
        let ms = if is_last {
            self.format.last_ms
        } else {
            self.format.frame_ms
        };
        let writer = &mut open.writer;
        writer.set_frame_delay(ms, 1000)?;
        writer.set_dispose_op(DisposeOp::None)?;
        if open.before.is_empty() {
            writer.write_image_data(&now)?;
            open.before = now;
            return Ok(());
        }
        let [left, top, width, height] = changed(&open.before, &now, size);
        let mut part = Vec::with_capacity(width * height);
        for row in top..top + height {
            let at = row * size[0] + left;
            let pair = now[at..at + width].iter().zip(&open.before[at..at + width]);
            part.extend(pair.map(|(now, before)| if now == before { SAME } else { *now }));
        }
        writer.set_blend_op(BlendOp::Over)?;
        writer.reset_frame_position()?;
        writer.set_frame_dimension(width as u32, height as u32)?;
        writer.set_frame_position(left as u32, top as u32)?;
        writer.write_image_data(&part)?;
        open.before = now;
        Ok(())
    }

    /// Completes the file.
    ///
    /// # Errors
    /// When it cannot be written, or frames are missing.
    pub fn finish(mut self) -> anyhow::Result<()> {
        if let State::Collecting(..) = self.state {
            self.begin()?;
        }
        let (written, wanted) = (self.written, self.format.frames);
        anyhow::ensure!(written == wanted, "{written} of {wanted} frames were drawn");
        match self.state {
            State::Writing(open) => open.writer.finish().context("the file's end"),
            State::Collecting(..) | State::Broken => anyhow::bail!("nothing was drawn"),
        }
    }
}

/// Left, top, width and height of the rectangle that differs; one pixel when none does.
fn changed(before: &[u8], now: &[u8], [width, height]: [usize; 2]) -> [usize; 4] {
    let rows = || before.chunks_exact(width).zip(now.chunks_exact(width));
    let differs = |(before, now): (&[u8], &[u8])| before != now;
    let Some(top) = rows().position(differs) else {
        return [0, 0, 1, 1];
    };
    let bottom = rows().rposition(differs).unwrap_or(height - 1);
    let (mut left, mut right) = (width - 1, 0);
    for (before, now) in rows() {
        let pairs = || before.iter().zip(now);
        if let Some(first) = pairs().position(|(before, now)| before != now) {
            left = left.min(first);
            right = right.max(
                pairs()
                    .rposition(|(before, now)| before != now)
                    .unwrap_or(first),
            );
        }
    }
    [left, top, right + 1 - left, bottom + 1 - top]
}

/// The colours of all frames.
struct Palette {
    colours: Vec<[u8; 3]>,
    nearest: HashMap<u32, u8>,
}

fn distance([a, b, c]: [u8; 3], [x, y, z]: [u8; 3]) -> i32 {
    let part = |p: u8, q: u8| (i32::from(p) - i32::from(q)).pow(2);
    part(a, x) + part(b, y) + part(c, z)
}

fn key(colour: [u8; 3]) -> u32 {
    let parts = colour.map(|part| u32::from(part) >> (8 - BITS));
    (parts[0] << (2 * BITS)) | (parts[1] << BITS) | parts[2]
}

impl Palette {
    /// The colours that are drawn with, and the most frequent blends of them.
    fn of(frames: &[Vec<u8>]) -> Palette {
        let mut found: HashMap<u32, (u64, [u64; 3])> = HashMap::new();
        for pixel in frames.iter().flat_map(|frame| frame.chunks_exact(3)) {
            let colour = [pixel[0], pixel[1], pixel[2]];
            let (count, sum) = found.entry(key(colour)).or_default();
            *count += 1;
            (0..3).for_each(|part| sum[part] += u64::from(colour[part]));
        }
        let mut blends: Vec<(u64, [u8; 3])> = found
            .into_values()
            .map(|(count, sum)| (count, sum.map(|part| (part / count.max(1)) as u8)))
            .collect();
        // A map has no order; the same frames have to give the same bytes.
        blends.sort_unstable_by(|a, b| b.cmp(a));
        // The first entry stands for pixels that have not changed.
        let mut colours = vec![[0, 0, 0]];
        let drawn = palette::drawn().into_iter().map(|color| rgb(&color));
        for colour in drawn.chain(blends.into_iter().map(|(_, colour)| colour)) {
            let is_new = |known: &[u8; 3]| distance(*known, colour) > APART * APART;
            if colours.len() < COLOURS && colours[1..].iter().all(is_new) {
                colours.push(colour);
            }
        }
        Palette {
            colours,
            nearest: HashMap::new(),
        }
    }

    /// The entry of each pixel.
    fn indexed(&mut self, frame: &[u8]) -> Vec<u8> {
        let (mut last, mut index) = ([0, 0, 0], None);
        let pixels = frame.chunks_exact(3);
        let each = pixels.map(|pixel| {
            let colour = [pixel[0], pixel[1], pixel[2]];
            match index {
                Some(index) if colour == last => index,
                _ => {
                    last = colour;
                    *index.insert(self.entry(colour))
                }
            }
        });
        each.collect()
    }

    fn entry(&mut self, colour: [u8; 3]) -> u8 {
        let colours = &self.colours;
        *self.nearest.entry(key(colour)).or_insert_with(|| {
            let all = colours.iter().enumerate().skip(1);
            let near = all.min_by_key(|(_, known)| distance(**known, colour));
            near.map_or(1, |(index, _)| index as u8)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [u32; 2] = [16, 9];

    fn frame(at: usize) -> Vec<u8> {
        let mut frame = [0x56, 0x5c, 0x66].repeat(16 * 9);
        for x in at..at + 3 {
            let first = 3 * (4 * 16 + x);
            frame[first..first + 3].copy_from_slice(&[0x37, 0xd6, 0x7a]);
        }
        frame
    }

    /// The frames of a file, each as a viewer shows it.
    fn shown(file: &[u8]) -> (Vec<Vec<u8>>, u32) {
        let mut reader = png::Decoder::new(std::io::Cursor::new(file))
            .read_info()
            .expect("a PNG");
        let frames = reader
            .info()
            .animation_control
            .expect("animated")
            .num_frames;
        let colours = reader
            .info()
            .palette
            .clone()
            .expect("a palette")
            .into_owned();
        let mut canvas = vec![0; 16 * 9 * 3];
        let mut all = Vec::new();
        for _ in 0..frames {
            let mut buffer = vec![0; reader.output_buffer_size().expect("a size")];
            reader.next_frame(&mut buffer).expect("a frame");
            let control = *reader.info().frame_control().expect("a frame");
            let width = control.width as usize;
            for (at, entry) in buffer
                .iter()
                .take(width * control.height as usize)
                .enumerate()
            {
                let x = control.x_offset as usize + at % width;
                let y = control.y_offset as usize + at / width;
                if *entry != SAME {
                    let (to, of) = (3 * (16 * y + x), 3 * usize::from(*entry));
                    canvas[to..to + 3].copy_from_slice(&colours[of..of + 3]);
                }
            }
            all.push(canvas.clone());
        }
        (all, frames)
    }

    #[test]
    fn what_is_written_is_shown() {
        let drawn: Vec<Vec<u8>> = (0..40).map(|at| frame(at % 13)).collect();
        let mut file = Vec::new();
        let format = Format {
            size_px: SIZE,
            frames: 40,
            frame_ms: 100,
            last_ms: 2000,
        };
        let mut animation = Animation::new(&mut file, format);
        for frame in &drawn {
            animation.add(frame.clone()).expect("written");
        }
        animation.finish().expect("written");
        let (frames, count) = shown(&file);
        assert_eq!(count, 40);
        for (number, (shown, drawn)) in frames.iter().zip(&drawn).enumerate() {
            assert_eq!(shown, drawn, "frame {number}");
        }
    }

    #[test]
    fn frames_of_another_size_and_missing_ones_are_refused() {
        let format = Format {
            size_px: SIZE,
            frames: 2,
            frame_ms: 100,
            last_ms: 100,
        };
        let mut animation = Animation::new(Vec::new(), format);
        assert!(animation.add(vec![0; 3]).is_err());
        animation.add(frame(1)).expect("written");
        let error = animation.finish().expect_err("one is missing").to_string();
        assert!(error.contains("1 of 2 frames"), "{error}");
    }
}
