use std::path::PathBuf;

/// Why there is no route.
#[derive(Debug, thiserror::Error)]
pub enum RouteError {
    /// The file cannot be read.
    #[error("{path}: {error}", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system says.
        error: std::io::Error,
    },
    /// A line of a table is no row of it.
    #[error("{path}: {what}", path = path.display())]
    Table {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        what: String,
    },
    /// A scenario or a map does not say what a route needs.
    #[error("{path}: {what}", path = path.display())]
    Scenario {
        /// The file.
        path: PathBuf,
        /// What is missing or wrong.
        what: String,
    },
    /// The rows make no line.
    #[error("row {row}: {what}")]
    Line {
        /// The number of the row, from 0 on.
        row: usize,
        /// What is wrong.
        what: &'static str,
    },
}
