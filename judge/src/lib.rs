//! The offline tools behind `./vlaps judge`: what a judge was asked and said in a run,
//! audited ([`audit`]) or asked again of another model ([`replay`]), and a server for
//! tests and offline work that speaks a model's protocol ([`standin`]). It is no model.
//!
//! ```
//! // Two judges that agree on 18 of 20 pairs.
//! let kappa = judge::statistics::kappa(&[[9, 1], [1, 9]]);
//! assert_eq!(kappa, Some(0.8));
//! ```

pub mod audit;
pub mod eyes;
pub mod replay;
pub mod standin;
pub mod statistics;
