use serde::{Deserialize, Serialize};
use shm_config::message::Preference;
use shm_config::palette::distance;

/// The party that proposed a path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Party {
    /// The hand-made expert.
    Expert,
    /// The learned policy.
    Policy,
}

impl Party {
    /// The other party.
    pub fn other(self) -> Self {
        match self {
            Self::Expert => Self::Policy,
            Self::Policy => Self::Expert,
        }
    }
}

/// The colour of a path: saturated, and unlike every colour of the scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Hue {
    /// The expert's colour in the paper's figures.
    Red,
    /// The policy's colour in the paper's figures.
    Blue,
    /// Used in random showings.
    Green,
    /// Used in random showings.
    Orange,
    /// Used in random showings.
    Magenta,
    /// Used in random showings.
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

    /// The colour as drawn: red, green, blue.
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

    /// The colour's name in the prompt.
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

/// How one picture shows the two proposals: the party of the first path (path A), and
/// the colours. Picture and prompt are both made from this value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Showing {
    /// The party of the first path.
    pub first: Party,
    /// The colours of the first path and the second.
    pub hues: [Hue; 2],
}

/// Least distance of the two colours of a picture in the cube of bytes. Red and orange
/// are nearer to each other: thin paths of them look alike from above.
const HUES_APART: f64 = 140.0;

impl Showing {
    /// The paper's figures: the expert is first and red, the policy blue (Sec. 4.2).
    pub const PAPER: Self = Self {
        first: Party::Expert,
        hues: [Hue::Red, Hue::Blue],
    };

    /// A random first party and two clearly different random colours. `below(n)` is a
    /// random number in [0, n).
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

    /// The same question with places and colours of the paths exchanged. A judge that
    /// decides by place alone reverses its answer.
    pub fn swapped(self) -> Self {
        Self {
            first: self.first.other(),
            ..self
        }
    }

    /// The names of the first and the second path.
    pub const LETTERS: [&'static str; 2] = ["A", "B"];

    /// The name of a party's path.
    pub fn letter(self, party: Party) -> &'static str {
        match party == self.first {
            true => Self::LETTERS[0],
            false => Self::LETTERS[1],
        }
    }

    /// The colour of a party's path.
    pub fn hue(self, party: Party) -> Hue {
        match party == self.first {
            true => self.hues[0],
            false => self.hues[1],
        }
    }
}

/// A model's answer about one picture.
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
    /// The party with the safer path; `None` when they are similar.
    fn preferred(self, showing: Showing) -> Option<Party> {
        match self {
            Self::First => Some(showing.first),
            Self::Second => Some(showing.first.other()),
            Self::Similar => None,
        }
    }
}

/// The answer that one or two replies to the same question give together. Two replies
/// must agree on the party, not on the place. "Similar" lets the policy drive, as the
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
    fn all_pairs_of_different_colours_are_shown_and_no_others() {
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
        // 30 ordered pairs, without red and orange in either order.
        assert_eq!(shown.len(), 2 * 28);
    }
}
