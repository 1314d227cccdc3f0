//! The command line itself: failures and exit codes, parsers of values, output files, text on stdout.

pub mod failure;
pub mod output;
pub mod parsers;
pub mod print;
