//! Parses command lines with the parsers of the built programs.
//!
//! `./vlaps WORDS --help` reads WORDS in order before it shows its help, and runs
//! nothing: an unknown word or a wrong value before `--help` is an error. So every
//! program parses its own words here, whichever crate has its parser.

use std::path::Path;
use std::process::{Command, Output};

/// Ends a command within a line of shell.
const ENDS: &[&str] = &["|", "||", "&", "&&", ">", ">>", "2>", ";", "#", "·"];

/// The commands of `./vlaps` in a text, each as its words.
pub fn commands_in(text: &str) -> Vec<Vec<String>> {
    let mut parts = text.split("./vlaps");
    parts.next();
    // `./vlaps-zenoh` and `./vlaps.toml` are other things; two spaces begin a remark.
    let begins = parts.filter(|part| part.is_empty() || part.starts_with(' '));
    begins
        .map(|part| part.trim_start().split("  ").next().unwrap_or_default())
        .map(words)
        .filter(|words| !words.is_empty())
        .collect()
}

/// The words of one command, up to what ends it.
fn words(text: &str) -> Vec<String> {
    let mut words = Vec::new();
    for word in text.split_whitespace() {
        if ENDS.contains(&word) || word == "..." {
            break;
        }
        let bare = word.trim_end_matches(&[';', ')', ','][..]);
        words.push(bare.trim_matches(&['\'', '"'][..]).to_string());
        if bare.len() < word.len() {
            break;
        }
    }
    words
}

/// A word that stands for another one, such as `FILE` or `N`.
pub fn is_placeholder(word: &str) -> bool {
    let mut chars = word.chars();
    chars.next().is_some_and(|c| c.is_ascii_uppercase())
        && chars.all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || "_-/".contains(c))
}

/// Runs the supervisor with these words and `--help`.
fn ask(programs: &Path, words: &[String]) -> Output {
    let mut command = Command::new(programs.join("vlaps-supervisor"));
    // Wide enough that no example is wrapped.
    command.args(words).arg("--help").env("COLUMNS", "1000");
    command.output().expect("the supervisor")
}

/// Whether the programs accept these words after `./vlaps`.
///
/// # Errors
/// The first line of the parser's error.
pub fn parse(programs: &Path, words: &[String]) -> Result<(), String> {
    let mut words = words.to_vec();
    // Each round replaces one placeholder by a value that its parser may accept.
    for _ in 0..2 * words.len() + 1 {
        let output = ask(programs, &words);
        if output.status.success() {
            return Ok(());
        }
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        let first = error.lines().next().unwrap_or_default().to_string();
        let quoted = first.split('\'').nth(1).unwrap_or_default();
        if !is_placeholder(quoted) {
            return Err(first);
        }
        if first.contains("subcommand") {
            return Ok(());
        }
        let choices = error.split("[possible values: ").nth(1);
        let choice = choices.and_then(|all| all.split([',', ']']).next());
        for word in words.iter_mut().filter(|word| *word == quoted) {
            *word = choice.unwrap_or("1").to_string();
        }
    }
    Err("no value fits its placeholders".into())
}

/// Every command with its help text, from `./vlaps` down.
pub fn help(programs: &Path) -> Vec<(Vec<String>, String)> {
    let mut found = Vec::new();
    let mut open = vec![Vec::new()];
    while let Some(words) = open.pop() {
        let text = String::from_utf8_lossy(&ask(programs, &words).stdout).into_owned();
        let listed = text.split("Commands:\n").nth(1).unwrap_or_default();
        for line in listed.lines().take_while(|line| !line.is_empty()) {
            let is_name = line.starts_with("  ") && !line.starts_with("   ");
            let name = line.split_whitespace().next().filter(|_| is_name);
            if let Some(name) = name.filter(|name| *name != "help") {
                let further = words.iter().cloned().chain([name.to_string()]);
                open.push(further.collect());
            }
        }
        found.push((words, text));
    }
    found
}

/// The long options that a help text lists.
pub fn options(help: &str) -> impl Iterator<Item = String> {
    let lines = help.lines().map(str::trim_start);
    let listed = lines.filter(|line| line.starts_with('-'));
    let words = listed.flat_map(str::split_whitespace);
    words
        .filter(|word| word.starts_with("--"))
        .map(|word| word.trim_end_matches("...").to_string())
}
