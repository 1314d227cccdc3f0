//! One finding of `doctor`.

use std::fmt;

/// What a finding means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Grade {
    /// As required.
    Ok,
    /// A set runs without it, but less punctually.
    Missing,
    /// A set does not run without it.
    Fatal,
}

/// One property of the machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// Its name.
    pub what: &'static str,
    /// Its grade.
    pub grade: Grade,
    /// What was found.
    pub found: String,
    /// Commands and lines that repair it, unless it is as required.
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
