use serde::{Deserialize, Serialize};
use shm_config::message::Preference;
use shm_config::palette::distance;

/// Whose proposal a path is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Party {
    /// The hand-made expert.
    Expert,
    /// The learned policy.
    Policy,
}

impl Party {
    /// The other one.
    pub fn other(self) -> Self {
        match self {
            Self::Expert => Self::Policy,
            Self::Policy => Self::Expert,
        }
    }
}

/// The colour of a path: saturated, and far from every colour of the scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Hue {
    /// The paper's expert in its figures.
    Red,
    /// The paper's policy in its figures.
    Blue,
    /// Free.
    Green,
    /// Free.
    Orange,
    /// Free.
    Magenta,
    /// Free.
    Cyan,
}

impl Hue {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Red,
        Self::Blue,
        Self::Green,
        Self::Orange,
        Self::Magenta,
        Self::Cyan,
    ];

    /// What is drawn: red, green, blue.
    pub const fn rgb(self) -> [u8; 3] {
        match self {
            Self::Red => [230, 25, 25],
            Self::Blue => [30, 60, 255],
            Self::Green => [0, 190, 60],
            Self::Orange => [255, 140, 0],
            Self::Magenta => [230, 0, 200],
            Self::Cyan => [0, 200, 220],
        }
    }

    /// What the prompt says.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Red => "red",
            Self::Blue => "blue",
            Self::Green => "green",
            Self::Orange => "orange",
            Self::Magenta => "magenta",
            Self::Cyan => "cyan",
        }
    }
}

/// How the two proposals are shown to a judge once: whose path is the first
/// (path A), and in which colours. The one definition that picture and prompt
/// are made from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Showing {
    /// Whose path is the first.
    pub first: Party,
    /// The colours of the first path and the second.
    pub hues: [Hue; 2],
}

/// Least distance of the two colours of a picture in the cube of bytes. Red and
/// orange are nearer: thin paths of them look alike from above.
const HUES_APART: f64 = 140.0;

impl Showing {
    /// The paper's figures: the expert first and red, the policy blue (Sec. 4.2).
    pub const PAPER: Self = Self {
        first: Party::Expert,
        hues: [Hue::Red, Hue::Blue],
    };

    /// Whose path is the first, and two colours that nobody mixes up, at random:
    /// `below(n)` is a random number in [0, n).
    pub fn at_random(mut below: impl FnMut(usize) -> usize) -> Self {
        let first = match below(2) {
            0 => Party::Expert,
            _ => Party::Policy,
        };
        let one = Hue::ALL[below(Hue::ALL.len())];
        let is_other = |hue: &Hue| distance(hue.rgb(), one.rgb()) >= HUES_APART;
        let others = || Hue::ALL.into_iter().filter(is_other);
        let other = others().nth(below(others().count()));
        Self {
            first,
            hues: [one, other.unwrap_or(one)],
        }
    }

    /// The same question with the paths in each other's place and colour: what
    /// a judge says of the places alone turns round.
    pub fn swapped(self) -> Self {
        Self {
            first: self.first.other(),
            ..self
        }
    }

    /// What the first path and the second are called.
    pub const LETTERS: [&'static str; 2] = ["A", "B"];

    /// What somebody's path is called.
    pub fn letter(self, party: Party) -> &'static str {
        match party == self.first {
            true => Self::LETTERS[0],
            false => Self::LETTERS[1],
        }
    }

    /// The colour of somebody's path.
    pub fn hue(self, party: Party) -> Hue {
        match party == self.first {
            true => self.hues[0],
            false => self.hues[1],
        }
    }
}

/// What a model said of one picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reply {
    /// The first path is clearly safer.
    First,
    /// The second path is clearly safer.
    Second,
    /// Neither is clearly safer.
    Similar,
}

impl Reply {
    /// Whose path is safer; `None` when they are similar.
    fn preferred(self, showing: Showing) -> Option<Party> {
        match self {
            Self::First => Some(showing.first),
            Self::Second => Some(showing.first.other()),
            Self::Similar => None,
        }
    }
}

/// What one or two replies to the same question say together: two have to agree
/// on the party, not on the place. "Similar" lets the policy drive, as the
/// paper's 0 does (Sec. 8.5).
pub fn combine(replies: &[(Showing, Reply)]) -> Preference {
    let mut said = replies
        .iter()
        .map(|(showing, reply)| reply.preferred(*showing));
    let Some(first) = said.next() else {
        return Preference::Abstain;
    };
    if said.any(|next| next != first) {
        return Preference::Abstain;
    }
    match first {
        Some(Party::Expert) => Preference::Expert,
        Some(Party::Policy) | None => Preference::Policy,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_two_colours_that_can_be_told_apart_are_shown_and_no_others() {
        let mut shown = Vec::new();
        for first in 0..2 {
            for one in 0..Hue::ALL.len() {
                for other in 0..Hue::ALL.len() {
                    let mut draws = [first, one, other].into_iter();
                    let showing = Showing::at_random(|count| draws.next().unwrap_or(0) % count);
                    let [a, b] = showing.hues;
                    assert!(distance(a.rgb(), b.rgb()) >= HUES_APART, "{showing:?}");
                    if !shown.contains(&(showing.first, a, b)) {
                        shown.push((showing.first, a, b));
                    }
                }
            }
        }
        // Of 30 ordered pairs, all but red and orange, either first.
        assert_eq!(shown.len(), 2 * 28);
    }
}
