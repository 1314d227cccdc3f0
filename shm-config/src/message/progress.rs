use super::{Header, Message, Refusal, header_accessors, known, within};

crate::word_list! {
    /// How an episode ended.
    pub enum Outcome {
        /// It has not ended.
        Driving = 0 "driving",
        /// The goal was reached.
        Arrived = 1 "arrived",
        /// The car left the road, its route, or touched a sidewalk.
        OutOfRoad = 2 "out_of_road",
        /// The time limit was reached.
        MaxStep = 3 "max_step",
        /// The run was stopped.
        Stopped = 4 "stopped",
    }
}

crate::message! {
    /// The progress of the episode, which only the world knows. The robot side never
    /// reads it; it is for the screen and for measuring judges.
    #[derive(Default)]
    pub struct Progress: 120 bytes, nested [Header] {
        /// The world's tick.
        pub header: Header,
        /// Seed of the episode.
        pub seed: u64,
        /// Share of the route driven, [0, 1].
        pub completion: f64,
        /// Length of the route, m.
        pub route_m: f64,
        /// Speed, m/s.
        pub speed_mps: f64,
        /// Ticks of this episode so far.
        pub episode_ticks: u64,
        /// Ticks of this episode in contact with a vehicle.
        pub vehicle_contacts: u64,
        /// Ticks of this episode in contact with an object.
        pub object_contacts: u64,
        /// Ticks of this run on which the world braked without a recent command.
        pub braked: u64,
        /// Maximum age of an applied command, ns.
        pub command_age_max_ns: u64,
        /// Ticks of the grid the world skipped.
        pub skipped: u64,
        /// An [`Outcome`].
        pub outcome: u32,
        /// Not used.
        pub reserved: u32,
    }
}

crate::message! {
    /// One finished episode.
    #[derive(Default)]
    pub struct Episode: 136 bytes, nested [Header] {
        /// The world's last tick of the episode.
        pub header: Header,
        /// Seed of the episode.
        pub seed: u64,
        /// Ticks driven.
        pub ticks: u64,
        /// Share of the route driven, [0, 1].
        pub completion: f64,
        /// Length driven, m.
        pub driven_m: f64,
        /// Ticks in contact with a vehicle.
        pub vehicle_contacts: u64,
        /// Ticks in contact with an object.
        pub object_contacts: u64,
        /// Ticks on which the world braked without a recent command.
        pub braked: u64,
        /// An [`Outcome`].
        pub outcome: u32,
        /// 1 when the last tick was in contact: the paper's crash.
        pub crash_last_step: u32,
        /// SHA-256 over the bits of all applied commands.
        pub command_digest: [u8; 32],
        /// Ticks of the grid skipped in this episode.
        pub skipped: u64,
    }
}

impl Progress {
    /// Ticks in contact with a vehicle or an object.
    pub fn contacts(&self) -> u64 {
        self.vehicle_contacts.saturating_add(self.object_contacts)
    }
}

impl Message for Progress {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        within("completion", self.completion, -10.0..=10.0)?;
        within("route_m", self.route_m, 0.0..=1e6)?;
        within("speed_mps", self.speed_mps, -150.0..=150.0)?;
        known("outcome", self.outcome, Outcome::from_code)
    }
}

impl Message for Episode {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        within("completion", self.completion, -10.0..=10.0)?;
        within("driven_m", self.driven_m, 0.0..=1e9)?;
        known("outcome", self.outcome, Outcome::from_code)
    }
}

impl Episode {
    /// How it ended; an unknown code reads as stopped.
    pub fn outcome(&self) -> Outcome {
        Outcome::from_code(self.outcome).unwrap_or(Outcome::Stopped)
    }

    /// Ticks in contact with a vehicle or an object.
    pub fn contacts(&self) -> u64 {
        self.vehicle_contacts.saturating_add(self.object_contacts)
    }

    /// Arrived without touching anything: the strict metric.
    pub fn is_strict_success(&self) -> bool {
        self.outcome() == Outcome::Arrived && self.contacts() == 0
    }
}
