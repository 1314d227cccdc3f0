//! One finding of `doctor`.

use std::fmt;

/// What a finding means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Grade {
    /// As it should be.
    Ok,
    /// It runs without, less punctually.
    Missing,
    /// It does not run without.
    Fatal,
}

/// One thing looked at.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// What.
    pub what: &'static str,
    /// How it is.
    pub grade: Grade,
    /// What was found.
    pub found: String,
    /// Commands and lines that change it, when it is not as it should be.
    pub remedy: Vec<String>,
}

impl Finding {
    pub(super) fn new(
        what: &'static str,
        is_ok: bool,
        found: String,
        remedy: &[impl ToString],
    ) -> Self {
        let remedy = remedy.iter().map(ToString::to_string);
        Self {
            what,
            grade: if is_ok { Grade::Ok } else { Grade::Missing },
            found,
            remedy: remedy.filter(|_| !is_ok).collect(),
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let grade = match self.grade {
            Grade::Ok => "OK",
            Grade::Missing | Grade::Fatal => "MISSING",
        };
        write!(f, "{grade:<8} {:<20} {}", self.what, self.found)?;
        for line in &self.remedy {
            write!(f, "\n             {line}")?;
        }
        Ok(())
    }
}
