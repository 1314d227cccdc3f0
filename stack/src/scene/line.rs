//! One scene as one line of JSON.

use serde::{Deserialize, Serialize};
use shm_config::message::{
    BEAMS_MAX, Bend, Checkpoint, Ego, Header, Message, Observation, PlanOutcome, Road,
};

use super::{Origin, Scene};

/// A scene as it is written.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Line {
    seed: u64,
    outcome: String,
    observation: Seen,
    before: Option<Seen>,
}

/// An observation as it is written: the fields of the message of that name.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Seen {
    tick: u64,
    taken_ns: u64,
    #[serde(with = "SeenEgo")]
    ego: Ego,
    #[serde(with = "SeenRoad")]
    road: Road,
    checkpoints: [SeenCheckpoint; 2],
    lidar_max_m: f32,
    #[serde(default = "circle_rad")]
    field_of_view_rad: f64,
    #[serde(default)]
    scanner_heading_rad: f64,
    #[serde(default)]
    scanner_x_body_m: f64,
    #[serde(default)]
    scanner_y_body_m: f64,
    ranges_m: Vec<f32>,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Ego", deny_unknown_fields)]
struct SeenEgo {
    x_world_m: f64,
    y_world_m: f64,
    heading_world_rad: f64,
    speed_mps: f64,
    yaw_rate_radps: f64,
    steer: f64,
    pedal: f64,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Road", deny_unknown_fields)]
struct SeenRoad {
    left_m: f64,
    right_m: f64,
    heading_rad: f64,
    offset_m: f64,
    #[serde(default = "lane_width_m")]
    lane_width_m: f64,
}

/// Of the scenes that do not say it: the experiment's.
fn lane_width_m() -> f64 {
    Road::default().lane_width_m
}

/// The field of view of the scenes that do not say it: the full circle.
fn circle_rad() -> f64 {
    Observation::default().field_of_view_rad
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SeenCheckpoint {
    x_body_m: f64,
    y_body_m: f64,
    bend_radius_m: f64,
    bend_angle_rad: f64,
    bend: String,
}

impl Line {
    /// A scene to be written.
    pub(super) fn new(scene: &Scene) -> Line {
        Line {
            seed: scene.origin.seed,
            outcome: scene.origin.outcome.word().into(),
            observation: Seen::new(&scene.observation),
            before: scene.before.as_deref().map(Seen::new),
        }
    }

    /// A line of a file.
    ///
    /// # Errors
    /// In words, with the field that is wrong.
    pub(super) fn parse(text: &str) -> Result<Scene, String> {
        let line: Line = serde_json::from_str(text).map_err(|error| explain(text, &error))?;
        let named = |name: &'static str| move |error: String| format!("{name}.{error}");
        let outcome = PlanOutcome::ALL
            .iter()
            .copied()
            .find(|outcome| outcome.word() == line.outcome)
            .ok_or_else(|| format!("outcome: \"{}\" is no outcome of a plan", line.outcome))?;
        let before = line.before.as_ref().map(Seen::observation).transpose();
        Ok(Scene {
            origin: Origin {
                seed: line.seed,
                outcome,
            },
            observation: line
                .observation
                .observation()
                .map_err(named("observation"))?,
            before: before.map_err(named("before"))?,
        })
    }
}

/// What a line's error means, with the field before it: the library names only
/// fields that are missing or too many.
fn explain(text: &str, error: &serde_json::Error) -> String {
    let column = error.column().min(text.len());
    let before = text.get(..column).unwrap_or(text);
    let words = error.to_string();
    let words = match words.rfind(" at line ") {
        Some(end) => &words[..end],
        None => &words,
    };
    match field_before(before) {
        Some(field) => format!("{field}: {words} (column {column})"),
        None => format!("{words} (column {column})"),
    }
}

/// The last `"field":` of a text.
fn field_before(text: &str) -> Option<&str> {
    let end = text.rfind("\":")?;
    let begin = text[..end].rfind('"')?;
    Some(&text[begin + 1..end])
}

impl Seen {
    fn new(observation: &Observation) -> Seen {
        Seen {
            tick: observation.header.tick,
            taken_ns: observation.header.taken_ns,
            ego: observation.ego,
            road: observation.road,
            checkpoints: observation.checkpoints.map(|checkpoint| SeenCheckpoint {
                x_body_m: checkpoint.x_body_m,
                y_body_m: checkpoint.y_body_m,
                bend_radius_m: checkpoint.bend_radius_m,
                bend_angle_rad: checkpoint.bend_angle_rad,
                bend: checkpoint.bend().word().into(),
            }),
            lidar_max_m: observation.lidar_max_m,
            field_of_view_rad: observation.field_of_view_rad,
            scanner_heading_rad: observation.scanner_heading_rad,
            scanner_x_body_m: observation.scanner_x_body_m,
            scanner_y_body_m: observation.scanner_y_body_m,
            ranges_m: observation.ranges().to_vec(),
        }
    }

    /// The message, checked as at a process's door.
    fn observation(&self) -> Result<Box<Observation>, String> {
        let count = self.ranges_m.len();
        if !(1..=BEAMS_MAX).contains(&count) {
            return Err(format!("ranges_m: {count} beams, must be 1 to {BEAMS_MAX}"));
        }
        let mut observation = Box::new(Observation {
            header: Header {
                tick: self.tick,
                taken_ns: self.taken_ns,
                ..Header::default()
            },
            ego: self.ego,
            road: self.road,
            lidar_max_m: self.lidar_max_m,
            beam_count: count as u32,
            field_of_view_rad: self.field_of_view_rad,
            scanner_heading_rad: self.scanner_heading_rad,
            scanner_x_body_m: self.scanner_x_body_m,
            scanner_y_body_m: self.scanner_y_body_m,
            ..Observation::default()
        });
        for (to, from) in observation.checkpoints.iter_mut().zip(&self.checkpoints) {
            *to = from.checkpoint()?;
        }
        observation.ranges_m[..count].copy_from_slice(&self.ranges_m);
        observation.check().map_err(|refusal| refusal.to_string())?;
        Ok(observation)
    }
}

impl SeenCheckpoint {
    fn checkpoint(&self) -> Result<Checkpoint, String> {
        let bend = Bend::ALL
            .iter()
            .copied()
            .find(|bend| bend.word() == self.bend)
            .ok_or_else(|| format!("checkpoints.bend: \"{}\" is no bend", self.bend))?;
        Ok(Checkpoint {
            x_body_m: self.x_body_m,
            y_body_m: self.y_body_m,
            bend_radius_m: self.bend_radius_m,
            bend_angle_rad: self.bend_angle_rad,
            bend: bend.code(),
            reserved: 0,
        })
    }
}
