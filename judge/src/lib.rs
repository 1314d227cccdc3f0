//! The offline tools behind `./vlaps judge`. They audit the questions and answers of a
//! judge in a run ([`audit`]), ask another model the same questions ([`replay`]), train a
//! small net that answers in its place ([`distil`]), and serve a stand-in that speaks a model's protocol for tests and offline work
//! ([`standin`]). The stand-in is not a model.
//!
//! ```
//! // Two judges that agree on 18 of 20 pairs.
//! let kappa = judge::statistics::kappa(&[[9, 1], [1, 9]]);
//! assert_eq!(kappa, Some(0.8));
//! ```

pub mod audit;
pub mod distil;
pub mod pixels;
pub mod replay;
pub mod standin;
pub mod statistics;
