use super::{Header, Message, Part, Refusal, fits, header_accessors, known};

crate::word_list! {
    /// What a [`Timing`] measures.
    pub enum Measure {
        /// From the scheduled instant to the begin of the tick; of a skipped one, to
        /// the begin of the tick after it.
        ReleaseLateness = 0 "release_lateness",
        /// From the event that released the tick to its begin.
        WakeUp = 1 "wake_up",
        /// From begin to end of the tick.
        Execution = 2 "execution",
        /// From the world's release of an observation to the command for it.
        Response = 3 "response",
        /// Age of the observation at the tick.
        ObservationAge = 4 "observation_age",
        /// Age of the plan's observation at the tick.
        PlanAge = 5 "plan_age",
        /// Age of the advice's observation at the tick.
        AdviceAge = 6 "advice_age",
    }
}

crate::message! {
    /// Durations counted in buckets of [`crate::histogram`].
    pub struct Histogram: 11280 bytes {
        /// The largest duration seen, ns, exact.
        pub max_ns: u64,
        /// Durations counted.
        pub count: u64,
        /// Durations by bucket.
        pub buckets: [u32; 2816],
    }
}

/// Late ticks that are kept one by one: as many as fit on a screen.
pub const LATE_TICKS: usize = 20;

const _: () = assert!(LATE_TICKS == 20, "as the message declares");

crate::message! {
    /// A tick that was late.
    #[derive(Default)]
    pub struct LateTick: 40 bytes {
        /// The number of the tick in the run.
        pub tick: u64,
        /// From its deadline to its completion, ns; of a tick that ends skipped ones,
        /// from the deadline of the first of them.
        pub late_ns: u64,
        /// How long its longest part took, ns.
        pub part_ns: u64,
        /// Ticks that were skipped just before it.
        pub skipped: u64,
        /// A [`Part`]: the one that took longest.
        pub part: u32,
        /// Not used; 0.
        pub reserved: u32,
    }
}

crate::message! {
    /// The durations of a process: full-range histograms since it started.
    #[derive(Default)]
    pub struct Timing: 79800 bytes, nested [Header, Histogram, LateTick] {
        /// When.
        pub header: Header,
        /// From the scheduled instant to the begin of the tick; of a skipped one, to
        /// the begin of the tick after it.
        pub release_lateness: Histogram,
        /// From the event that released the tick to its begin: the timer's instant
        /// (world), the publishing of the observation, or the end of the wait for one
        /// (planner, controller). A skipped tick, whose release the process did not
        /// see, counts from its scheduled instant, so that no duration is too short.
        /// Empty in a process that does not know what releases it, and in a world in
        /// lockstep.
        pub wake_up: Histogram,
        /// From begin to end of the tick.
        pub execution: Histogram,
        /// From the world's release of an observation to the command that answers
        /// it, by its tick (controller), else empty.
        pub response: Histogram,
        /// Age of the observation when it was used (planner, controller), from the
        /// instant it was taken.
        pub observation_age: Histogram,
        /// Age of the plan's observation when it was used (controller).
        pub plan_age: Histogram,
        /// Age of the observation that the advice answers (controller).
        pub advice_age: Histogram,
        /// How many of the late ticks are valid.
        pub late_count: u64,
        /// The ticks that were latest, in no order.
        pub late: [LateTick; 20],
    }
}

impl Default for Histogram {
    fn default() -> Self {
        Self {
            max_ns: 0,
            count: 0,
            buckets: [0; 2816],
        }
    }
}

impl Timing {
    /// One histogram.
    pub fn of(&self, measure: Measure) -> &Histogram {
        match measure {
            Measure::ReleaseLateness => &self.release_lateness,
            Measure::WakeUp => &self.wake_up,
            Measure::Execution => &self.execution,
            Measure::Response => &self.response,
            Measure::ObservationAge => &self.observation_age,
            Measure::PlanAge => &self.plan_age,
            Measure::AdviceAge => &self.advice_age,
        }
    }

    /// The same, to count in.
    pub fn of_mut(&mut self, measure: Measure) -> &mut Histogram {
        match measure {
            Measure::ReleaseLateness => &mut self.release_lateness,
            Measure::WakeUp => &mut self.wake_up,
            Measure::Execution => &mut self.execution,
            Measure::Response => &mut self.response,
            Measure::ObservationAge => &mut self.observation_age,
            Measure::PlanAge => &mut self.plan_age,
            Measure::AdviceAge => &mut self.advice_age,
        }
    }

    /// Adds the counts of another, such as of the process before its restart; the
    /// latest of both remain.
    pub fn merge(&mut self, other: &Self) {
        for measure in Measure::ALL {
            self.of_mut(*measure).merge(other.of(*measure));
        }
        for late in other.late_ticks() {
            self.keep_late(*late);
        }
    }

    /// The ticks that were latest, in no order.
    pub fn late_ticks(&self) -> &[LateTick] {
        &self.late[..(self.late_count as usize).min(LATE_TICKS)]
    }

    /// Keeps a late tick if it is one of the [`LATE_TICKS`] latest. Returns the
    /// lateness that the next one has to exceed, ns.
    pub fn keep_late(&mut self, late: LateTick) -> u64 {
        let kept = self.late_ticks().len();
        if kept < LATE_TICKS {
            self.late[kept] = late;
            self.late_count = kept as u64 + 1;
        } else if let Some(least) = self.late.iter_mut().min_by_key(|kept| kept.late_ns)
            && least.late_ns < late.late_ns
        {
            *least = late;
        }
        match self.late_ticks().len() < LATE_TICKS {
            true => 0,
            false => self.late.iter().map(|kept| kept.late_ns).min().unwrap_or(0),
        }
    }
}

impl Message for Timing {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        fits("late_count", self.late_count, LATE_TICKS)?;
        let mut late = self.late_ticks().iter();
        late.try_for_each(|late| known("late.part", late.part, Part::from_code))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn late(late_ns: u64) -> LateTick {
        LateTick {
            late_ns,
            ..LateTick::default()
        }
    }

    fn kept(timing: &Timing) -> Vec<u64> {
        let mut kept: Vec<u64> = timing
            .late_ticks()
            .iter()
            .map(|late| late.late_ns)
            .collect();
        kept.sort_unstable();
        kept
    }

    #[test]
    fn the_latest_ticks_remain_over_lives() {
        let mut first = Box::<Timing>::default();
        // 1 to 30 in an order of neither kind.
        let bars: Vec<u64> = (0..30)
            .map(|k| first.keep_late(late(1 + k * 7 % 30)))
            .collect();
        assert_eq!(kept(&first), (11..=30).collect::<Vec<_>>());
        assert_eq!((bars[18], bars[29]), (0, 11), "{bars:?}");
        let mut second = Box::<Timing>::default();
        for late_ns in [5, 40, 12] {
            second.keep_late(late(late_ns));
        }
        second.merge(&first);
        // 5 and 11 are out, and one of the two 12.
        let both: Vec<u64> = (12..=30).chain([40]).collect();
        assert_eq!(kept(&second), both);
    }

    #[test]
    fn late_ticks_over_capacity_or_of_no_part_are_refused() {
        let mut timing = Box::<Timing>::default();
        assert_eq!(timing.check(), Ok(()));
        timing.late_count = LATE_TICKS as u64 + 1;
        assert!(timing.check().is_err());
        assert_eq!(timing.late_ticks().len(), LATE_TICKS);
        timing.late_count = 1;
        timing.late[0].part = 99;
        assert!(timing.check().is_err());
    }
}
