//! The two paths of a picture: where they lie, and how they are drawn.

use shm_config::message::Camera;
use vehicle::State;

use super::pencil::{Pencil, Place};
use super::{Proposals, Style, roll_out};
use crate::presentation::{Hue, Party, Showing};

/// The rim of coloured lines: it separates them from any background and from each
/// other.
const RIM: [u8; 3] = [16, 18, 22];
/// Letters on dark hues and on the panel of the legend.
const LIGHT: [u8; 3] = [255, 255, 255];
/// Width of a line, as a share of the picture's shorter side.
pub const LINE: f32 = 0.0105;
/// Narrowest line, px: JPEG leaves no colour of a narrower one.
const LINE_MIN_PX: f32 = 3.0;
/// Distance of a line's points where two lines are kept apart, px.
const SPACING_PX: f32 = 2.0;
/// Most points of a line; further ones lie at the rim of the picture, where nothing is
/// seen.
const POINTS_MAX: usize = 4096;

/// Both paths in the order they are shown.
pub struct Paths {
    shown: [Shown; 2],
}

/// One path in pixels.
struct Shown {
    hue: Hue,
    letter: &'static str,
    /// 1 when the path keeps to the left of the other, -1 to the right.
    side: f32,
    /// The part of the path before the camera, from the car outward.
    parts: Vec<Vec<Place>>,
    /// The car's outline at the end of the path; empty unless all of it is before the
    /// camera.
    footprint: Vec<Place>,
}

/// Lengths that depend on the size of the picture, px.
#[derive(Clone, Copy)]
struct Measures {
    line: f32,
    rim: f32,
    label: f32,
}

impl Measures {
    fn of([width, height]: [f32; 2]) -> Self {
        let shorter = width.min(height);
        let line = (LINE * shorter).max(LINE_MIN_PX);
        Self {
            line,
            rim: (0.3 * line).max(1.2),
            label: (0.026 * shorter).max(7.0),
        }
    }
}

impl Paths {
    /// Rolls both proposals out and projects them through the camera, whose pixels are
    /// scaled by `scale` across and down.
    pub fn new(
        (camera, scale): (&Camera, [f64; 2]),
        proposals: &Proposals,
        showing: Showing,
        style: &Style,
    ) -> Self {
        let seen = |points_body: &[[f64; 3]]| -> Vec<Vec<Place>> {
            let parts = camera.project_line(points_body).into_iter();
            let scaled = |[u, v]: [f64; 2]| [(u * scale[0]) as f32, (v * scale[1]) as f32];
            parts
                .map(|part| part.into_iter().map(scaled).collect())
                .collect()
        };
        let shown = [showing.first, showing.first.other()].map(|party| {
            let action = match party {
                Party::Expert => proposals.expert,
                Party::Policy => proposals.policy,
            };
            let rollout = (style.rollout, style.horizon_s);
            let states = roll_out(proposals.vehicle, action, proposals.speed_mps, rollout);
            let ground: Vec<[f64; 3]> = states
                .iter()
                .map(|state| [state.position.x, state.position.y, 0.0])
                .collect();
            Shown {
                hue: showing.hue(party),
                letter: showing.letter(party),
                side: side(proposals, showing, party),
                parts: seen(&ground),
                footprint: footprint(proposals, states.last(), &seen),
            }
        });
        Self { shown }
    }

    /// Draws both paths; labels come first, so that no label hides a path.
    pub fn draw(mut self, pencil: &mut Pencil, style: &Style) {
        let measures = Measures::of(pencil.size_px());
        self.set_apart(measures);
        let [width, height] = pencil.size_px();
        for shown in &self.shown {
            let at = shown.label_place(measures, [width, height]);
            label(pencil, at, (shown.hue, shown.letter), measures);
        }
        let lines = || {
            let both = self.shown.iter();
            both.flat_map(|shown| shown.parts.iter().map(move |part| (shown, part)))
        };
        let outlines = || {
            let both = self
                .shown
                .iter()
                .filter(|shown| !shown.footprint.is_empty());
            both.filter(|_| style.footprint)
        };
        let thin = 0.45 * measures.line;
        for shown in outlines() {
            pencil.outline(&shown.footprint, RIM, thin + 2.0 * measures.rim);
        }
        for (_, part) in lines() {
            pencil.line(part, RIM, measures.line + 2.0 * measures.rim);
        }
        for shown in outlines() {
            pencil.outline(&shown.footprint, shown.hue.rgb(), thin);
        }
        for (shown, part) in lines() {
            pencil.line(part, shown.hue.rgb(), measures.line);
        }
        if style.legend {
            legend(pencil, &self.shown, measures);
        }
    }

    /// Moves the lines to their sides where they would cover each other.
    fn set_apart(&mut self, measures: Measures) {
        let apart_px = measures.line + measures.rim;
        let dense = [0, 1].map(|k: usize| -> Vec<Vec<Place>> {
            let parts = self.shown[k].parts.iter();
            parts.map(|part| resample(part)).collect()
        });
        for k in [0, 1] {
            let side = self.shown[k].side;
            let moved = dense[k].iter().map(|part| {
                let points = part.iter().enumerate();
                points
                    .map(|(at, &place)| {
                        let gap_px = (apart_px - distance_px(place, &dense[1 - k])).max(0.0);
                        let [x, y] = left_of(direction(part, at));
                        let shift_px = side * gap_px / 2.0;
                        [place[0] + x * shift_px, place[1] + y * shift_px]
                    })
                    .collect()
            });
            self.shown[k].parts = moved.collect();
        }
    }
}

impl Shown {
    /// The place of the letter: beyond the last visible end of the path, on its side;
    /// at the lower rim if no part of the path is visible.
    fn label_place(&self, measures: Measures, [width, height]: [f32; 2]) -> Place {
        let radius_px = measures.label;
        let (low, high) = (
            radius_px + 2.0,
            [width - radius_px - 2.0, height - radius_px - 2.0],
        );
        let visible = self.parts.iter().rev().find_map(|part| {
            let last = part
                .iter()
                .rposition(|&[x, y]| (0.0..width).contains(&x) && (0.0..height).contains(&y))?;
            Some((part[last], direction(part, last)))
        });
        let aside_px = self.side * (radius_px + 1.5 * measures.line);
        let [x, y] = match visible {
            Some(([x, y], along)) => {
                let left = left_of(along);
                let beyond_px = self.footprint.iter().map(|corner| {
                    self.side * ((corner[0] - x) * left[0] + (corner[1] - y) * left[1])
                });
                let clear_px = beyond_px.fold(0.0, f32::max) + radius_px + measures.line;
                let aside_px = self.side * clear_px.clamp(aside_px.abs(), 5.0 * radius_px);
                let ahead_px = 0.8 * radius_px;
                [
                    x + along[0] * ahead_px + left[0] * aside_px,
                    y + along[1] * ahead_px + left[1] * aside_px,
                ]
            }
            // The left of a path that leads up is the left of the picture.
            None => [width / 2.0 - aside_px, height],
        };
        [
            x.clamp(low, high[0].max(low)),
            y.clamp(low, high[1].max(low)),
        ]
    }
}

/// The side of a party's path: the side to which it turns more than the other. With
/// equal turns the first path is on the left, so that both are visible.
fn side(proposals: &Proposals, showing: Showing, party: Party) -> f32 {
    let more = proposals.expert.steer - proposals.policy.steer;
    let left = if more > 0.0 {
        Party::Expert
    } else if more < 0.0 {
        Party::Policy
    } else {
        showing.first
    };
    if party == left { 1.0 } else { -1.0 }
}

fn footprint(
    proposals: &Proposals,
    last: Option<&State>,
    seen: &impl Fn(&[[f64; 3]]) -> Vec<Vec<Place>>,
) -> Vec<Place> {
    let Some(state) = last else {
        return Vec::new();
    };
    let corners = proposals.vehicle.footprint().corners(&state.pose());
    let mut ring: Vec<[f64; 3]> = corners.iter().map(|at| [at.x, at.y, 0.0]).collect();
    ring.extend(ring.first().copied());
    match seen(&ring).as_slice() {
        [whole] if whole.len() == ring.len() => whole[..4].to_vec(),
        _ => Vec::new(),
    }
}

/// A disc of the path's colour with its letter.
fn label(pencil: &mut Pencil, at: Place, (hue, letter): (Hue, &str), measures: Measures) {
    pencil.disc(at, measures.label + measures.rim, RIM);
    pencil.disc(at, measures.label, hue.rgb());
    let size_px = 1.7 * measures.label;
    // A letter of this font is 0.517 of its size wide.
    let left = at[0] - 0.257 * size_px;
    let base = at[1] + super::letters::capital_px(size_px) / 2.0;
    pencil.word(letter, [left, base], (size_px, ink(hue)));
}

/// Shows in the left upper corner which letter has which colour.
fn legend(pencil: &mut Pencil, shown: &[Shown; 2], measures: Measures) {
    let size_px = (1.2 * measures.label).max(11.0);
    let (pad, row, swatch) = (0.5 * size_px, 1.45 * size_px, 1.8 * size_px);
    let longest = shown.iter().map(|shown| shown.hue.word().len()).max();
    let letters = longest.unwrap_or_default() + 3;
    let width = 2.5 * pad + swatch + 0.53 * size_px * letters as f32;
    let corner = [0.6 * size_px, 0.6 * size_px];
    pencil.panel(corner, [width, 2.0 * row + 0.6 * pad], RIM, 0.85);
    for (k, shown) in shown.iter().enumerate() {
        let x = corner[0] + pad;
        let y = corner[1] + 0.3 * pad + row * (k as f32 + 0.5);
        let line = [[x + 2.0, y], [x + swatch - 2.0, y]];
        pencil.line(&line, shown.hue.rgb(), measures.line);
        let words = format!("{}: {}", shown.letter, shown.hue.word());
        let base = y + super::letters::capital_px(size_px) / 2.0;
        pencil.word(&words, [x + swatch + 0.5 * pad, base], (size_px, LIGHT));
    }
}

/// Dark letters on light hues, light ones on dark hues.
fn ink(hue: Hue) -> [u8; 3] {
    let [red, green, blue] = hue.rgb().map(f32::from);
    let luma = 0.299 * red + 0.587 * green + 0.114 * blue;
    if luma > 120.0 { RIM } else { LIGHT }
}

/// The same line with points at most `SPACING_PX` apart. A line without length becomes
/// one point.
fn resample(part: &[Place]) -> Vec<Place> {
    let mut dense: Vec<Place> = part.first().copied().into_iter().collect();
    for pair in part.windows(2) {
        let [[x0, y0], [x1, y1]] = [pair[0], pair[1]];
        let length_px = (x1 - x0).hypot(y1 - y0);
        // Parts far outside the picture get no further points.
        let count = (length_px / SPACING_PX).ceil().min(512.0);
        if dense.len() + count as usize > POINTS_MAX {
            break;
        }
        for k in 1..=count as u32 {
            let share = k as f32 / count;
            dense.push([x0 + (x1 - x0) * share, y0 + (y1 - y0) * share]);
        }
    }
    dense
}

/// Distance from a place to the nearest point of a line, px.
fn distance_px([x, y]: Place, parts: &[Vec<Place>]) -> f32 {
    let places = parts.iter().flatten();
    places
        .map(|place| (place[0] - x).hypot(place[1] - y))
        .fold(f32::INFINITY, f32::min)
}

/// Unit vector along a line at one of its points; up for a line without length.
fn direction(part: &[Place], at: usize) -> Place {
    let before = part[at.saturating_sub(2)];
    let after = part[(at + 2).min(part.len() - 1)];
    let (dx, dy) = (after[0] - before[0], after[1] - before[1]);
    let length = dx.hypot(dy);
    match length > 1e-3 {
        true => [dx / length, dy / length],
        false => [0.0, -1.0],
    }
}

/// The vector to the left of a direction; the picture's y axis points down.
fn left_of([x, y]: Place) -> Place {
    [y, -x]
}
