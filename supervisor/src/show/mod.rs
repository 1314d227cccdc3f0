//! How a run is shown: the live view, the plain lines, the summary.

pub mod clock;
pub mod layout;
pub mod policy_view;
pub mod process_row;
pub mod screen;
pub mod summary;
pub mod summary_text;
pub mod view;
pub mod view_text;
