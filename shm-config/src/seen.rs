//! An observation as JSON: in recorded scenes, and in the record of a judge.

use serde::{Deserialize, Serialize};

use crate::message::{BEAMS_MAX, Bend, Checkpoint, Ego, Header, Message, Observation, Road};

/// An observation as it is written: the fields of the message of that name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Seen {
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

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SeenCheckpoint {
    x_body_m: f64,
    y_body_m: f64,
    bend_radius_m: f64,
    bend_angle_rad: f64,
    bend: String,
}

impl Seen {
    /// An observation to be written.
    pub fn new(observation: &Observation) -> Seen {
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
    ///
    /// # Errors
    /// In words, with the field that is wrong.
    pub fn observation(&self) -> Result<Box<Observation>, String> {
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
