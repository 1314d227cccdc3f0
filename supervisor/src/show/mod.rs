//! show

pub mod process_row;
pub mod screen;
pub mod summary;
pub mod summary_text;
pub mod view;
