use super::{Header, Message, Refusal, header_accessors};

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

crate::message! {
    /// How punctual a process is: full-range histograms since it started.
    #[derive(Default)]
    pub struct Timing: 78992 bytes, nested [Header, Histogram] {
        /// When.
        pub header: Header,
        /// From the scheduled instant to the begin of the tick; of a skipped one, to
        /// the begin of the tick after it.
        pub release_lateness: Histogram,
        /// From the event that released the tick to its begin: from the timer's
        /// instant (world), from the publishing of the observation, or from the end
        /// of the wait for one (planner, controller). A skipped tick, of whose
        /// release the process never knew, counts from its scheduled instant, so
        /// that nothing is told too short. Empty in a process that does not know
        /// what releases it, and in a world in lockstep.
        pub wake_up: Histogram,
        /// From begin to end of the tick.
        pub execution: Histogram,
        /// From the world's release of an observation to the command that answers
        /// it, by its tick (controller), else empty.
        pub response: Histogram,
        /// Age of the observation when it was decided or planned on (planner,
        /// controller): since the instant it is of.
        pub observation_age: Histogram,
        /// Age of the plan's observation when it was decided on (controller).
        pub plan_age: Histogram,
        /// Age of the observation that the advice answers (controller).
        pub advice_age: Histogram,
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

    /// Adds the counts of another, such as of the process before its restart.
    pub fn merge(&mut self, other: &Self) {
        for measure in Measure::ALL {
            self.of_mut(*measure).merge(other.of(*measure));
        }
    }
}

impl Message for Timing {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        Ok(())
    }
}
