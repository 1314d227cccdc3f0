//! What the program is asked to measure.

/// Prefix of the last argument of the answering process: its address.
pub const ECHO: &str = "echo=";

/// The arguments of the program.
pub struct Words {
    /// Bytes of a message.
    pub bytes: usize,
    /// Whether a participant sleeps until a message comes, or polls.
    pub sleeps: bool,
    /// Time from one round trip to the next, ns; 0: at once.
    pub period_ns: u64,
    /// Round trips that are not counted.
    pub warm: u64,
    /// Round trips that are counted.
    pub count: u64,
    /// Cores of the asking and of the answering process; negative: any.
    pub cores: [i32; 2],
    /// Address of the answering process.
    pub endpoint: Option<String>,
}

impl Words {
    /// Reads the arguments; `None` if they are not those of the usage line.
    pub fn read(all: &[String]) -> Option<Words> {
        let (seven, rest) = all.split_at_checked(7)?;
        let endpoint = match rest {
            [] => None,
            [word] => Some(word.strip_prefix(ECHO)?.to_string()),
            _ => return None,
        };
        Some(Words {
            bytes: seven[0].parse().ok()?,
            sleeps: match seven[1].as_str() {
                "spin" => false,
                "bell" => true,
                _ => return None,
            },
            period_ns: seven[2].parse().ok()?,
            warm: seven[3].parse().ok()?,
            count: seven[4].parse().ok()?,
            cores: [seven[5].parse().ok()?, seven[6].parse().ok()?],
            endpoint,
        })
    }
}
