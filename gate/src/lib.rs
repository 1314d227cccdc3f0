//! The gate process: when a judge is asked, which judge, and what its answer means.
//!
//! Steps come in. [`query`] defines what a judge is asked, [`judge`] holds the judges,
//! and [`advice`] turns their answers into advice that expires. A vision-language model
//! is shown a [`presentation`] of the question, and [`model`] asks it over HTTP; a
//! [`distilled`] net answers most questions in its place. The
//! [`record`] keeps all questions and answers. Nothing here can delay a tick; the check
//! within the tick is the crate `safety`.
//!
//! ```
//! use gate::advice::Advisor;
//! use gate::judge::Rules;
//! use gate::query::Immediate;
//! use shm_config::Instant;
//! use shm_config::config::{Gate, SafetyLimits};
//! use shm_config::message::{Preference, Step};
//! use vehicle::Vehicle;
//!
//! let rules = Rules::new(Vehicle::default(), SafetyLimits::default());
//! let mut advisor = Advisor::new(&Gate::default(), Box::new(Immediate::new(rules)));
//! // A step without a proposal of the policy asks no question.
//! let advice = advisor.consider(&Step::default(), Instant(1));
//! assert_eq!(advice.preference(), Preference::Abstain);
//! ```

pub mod advice;
pub mod distilled;
pub mod judge;
pub mod model;
pub mod ports;
pub mod presentation;
pub mod query;
pub mod record;
mod run;

pub use run::run;
