//! Tests that everything the Markdown files and the help texts name exists: paths,
//! links with their anchors, commands, options, configuration keys, identifiers,
//! packages.

#[path = "docs/commands.rs"]
mod commands;
#[path = "docs/markdown.rs"]
mod markdown;

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use shm_config::config::Config;

use commands::{commands_in, is_placeholder};
use markdown::Code;

/// Endings that make a name a file's, not a configuration key's.
const FILE_ENDINGS: &[&str] = &[
    "rs", "md", "toml", "py", "svg", "png", "csv", "json", "onnx", "bin", "log", "html", "h", "c",
    "cpp", "hpp", "gz", "mcap", "txt", "rules", "service", "conf", "jsonl",
];
/// Files whose words count as names of the sources.
const SOURCE_ENDINGS: &[&str] = &["rs", "py", "toml", "c", "h", "cpp", "hpp", "rules", "conf"];
/// Folders that a run or a build writes.
const WRITTEN: &[&str] = &["runs", "target", "campaign", "soak"];

/// What may be named.
struct Facts {
    root: PathBuf,
    programs: PathBuf,
    /// Every word of the sources, with and without dots and hyphens.
    names: BTreeSet<String>,
    /// `section.key` of the configuration.
    keys: BTreeSet<String>,
    sections: BTreeSet<String>,
    options: BTreeSet<String>,
    /// The commands of `./vlaps`.
    commands: BTreeSet<String>,
    packages: BTreeSet<String>,
    help: Vec<(Vec<String>, String)>,
}

fn files(root: &Path, wanted: &dyn Fn(&Path) -> bool) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder").flatten() {
            let path = entry.path();
            let name = entry.file_name().to_string_lossy().into_owned();
            // Hidden folders are caches of other tools.
            let is_ours =
                !name.starts_with('.') && !["target", "runs", "corpus"].contains(&name.as_str());
            if path.is_dir() && is_ours {
                folders.push(path);
            } else if path.is_file() && wanted(&path) {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

fn ending(path: &Path) -> &str {
    let ending = path.extension().and_then(|ending| ending.to_str());
    ending.unwrap_or_default()
}

impl Facts {
    /// Read once for all tests.
    fn get() -> &'static Self {
        static FACTS: OnceLock<Facts> = OnceLock::new();
        FACTS.get_or_init(Self::gather)
    }

    fn gather() -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let root = root.canonicalize().expect("the root");
        let programs = vlaps_tests::programs().to_path_buf();
        let help = commands::help(&programs);
        assert!(help.len() > 20, "the help texts were read");
        let config = toml::Table::try_from(Config::default()).expect("a configuration");
        let keys = config.iter().flat_map(|(section, table)| {
            let table = table.as_table().expect("a section");
            table.keys().map(move |key| format!("{section}.{key}"))
        });
        let manifests = files(&root, &|path| path.ends_with("Cargo.toml"));
        let packages = manifests.iter().filter_map(|path| {
            let table: toml::Table = fs::read_to_string(path).ok()?.parse().ok()?;
            Some(table.get("package")?.get("name")?.as_str()?.to_string())
        });
        Self {
            names: names(&root),
            keys: keys.collect(),
            sections: config.keys().cloned().collect(),
            options: help
                .iter()
                .flat_map(|(_, text)| commands::options(text))
                .collect(),
            commands: help
                .iter()
                .filter_map(|(words, _)| words.first().cloned())
                .collect(),
            packages: packages.collect(),
            help,
            programs,
            root,
        }
    }

    /// Whether a path exists, from the root or beside the page.
    fn exists(&self, path: &str, folder: &Path) -> bool {
        self.root.join(path).exists() || folder.join(path).exists()
    }

    /// What is wrong with a page, a line each.
    fn problems(&self, name: &str, text: &str) -> Vec<String> {
        let page = markdown::read(text);
        let path = self.root.join(name);
        let folder = path.parent().expect("a folder");
        let links = page.links.iter().filter_map(|(line, target)| {
            let what = self.link(target, folder, &page.anchors)?;
            Some((*line, what))
        });
        let code = page.code.iter().filter_map(|code| {
            let what = self.code(code, folder)?;
            Some((code.line, what))
        });
        links
            .chain(code)
            .map(|(line, what)| format!("{name}:{line}: {what}"))
            .collect()
    }

    fn link(&self, target: &str, folder: &Path, own: &[String]) -> Option<String> {
        if target.starts_with("https://") {
            return None;
        }
        let (path, wanted) = target.split_once('#').unwrap_or((target, ""));
        let file = folder.join(path);
        if !path.is_empty() && !file.exists() {
            return Some(format!("the link's file {path} is missing"));
        }
        if wanted.is_empty() {
            return None;
        }
        let other = match path.is_empty() {
            true => own.to_vec(),
            false => markdown::read(&fs::read_to_string(file).unwrap_or_default()).anchors,
        };
        let is_there = other.iter().any(|anchor| anchor == wanted);
        (!is_there).then(|| format!("the link's heading #{wanted} is missing in {target}"))
    }

    fn code(&self, code: &Code, folder: &Path) -> Option<String> {
        let text = code.text.as_str();
        let wrong = commands_in(text)
            .iter()
            .find_map(|words| self.command(words));
        if wrong.is_some() || text.contains("./vlaps ") {
            return wrong;
        }
        if text.contains("cargo ") {
            return self.cargo(text);
        }
        if code.is_fenced {
            let mut tokens = text.split_whitespace();
            return tokens.find_map(|token| self.path(token, folder, true));
        }
        let mut words = text.split_whitespace();
        let first = words.next().unwrap_or_default();
        let is_short = self.commands.contains(first) && words.next().is_some();
        if is_short {
            return self.command(
                &text
                    .split_whitespace()
                    .map(String::from)
                    .collect::<Vec<_>>(),
            );
        }
        if let Some(given) = text.strip_prefix("--set ") {
            return self.key(given);
        }
        if first.starts_with("--") {
            let option = first.split('=').next().unwrap_or(first);
            return (!self.options.contains(option)).then(|| format!("no option {option}"));
        }
        if text.contains(' ') {
            return None;
        }
        self.key(text)
            .or_else(|| self.path(text, folder, false))
            .or_else(|| self.name(text))
    }

    fn command(&self, words: &[String]) -> Option<String> {
        let line = words.join(" ");
        let given = words.windows(2).filter(|pair| pair[0] == "--set");
        given
            .map(|pair| &pair[1])
            .find_map(|set| self.key(set))
            .or_else(|| {
                let parsed = commands::parse(&self.programs, words);
                parsed.err().map(|error| format!("./vlaps {line}: {error}"))
            })
    }

    /// A key of the configuration, alone, with a value, or with a `*`.
    fn key(&self, text: &str) -> Option<String> {
        let key = text.split('=').next().unwrap_or(text);
        let (section, name) = key.split_once('.')?;
        let is_key = self.sections.contains(section)
            && name
                .chars()
                .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || "_*".contains(c))
            && !FILE_ENDINGS.contains(&name);
        let (start, end) = key.split_once('*').unwrap_or((key, ""));
        let is_known = match key.contains('*') {
            true => self
                .keys
                .iter()
                .any(|known| known.starts_with(start) && known.ends_with(end)),
            false => self.keys.contains(key),
        };
        (is_key && !is_known).then(|| format!("no configuration key {key}"))
    }

    /// A path of the tree, or the name of a file that the sources write.
    fn path(&self, token: &str, folder: &Path, is_fenced: bool) -> Option<String> {
        let path = token.trim_matches(&['(', ')', ',', '"', '\''][..]);
        let is_path = path
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || "._-/".contains(c));
        let segments: Vec<&str> = path.split('/').collect();
        let first = segments[0];
        let has_ending = FILE_ENDINGS.contains(&ending(Path::new(path)));
        let stem = segments.last().and_then(|last| last.split('.').next());
        let is_sample = segments.iter().any(|part| is_placeholder(part))
            || (stem.is_some_and(is_placeholder) && !path.ends_with(".md"))
            || first.is_empty()
            || WRITTEN.contains(&first);
        if !is_path || is_sample || self.exists(path, folder) {
            return None;
        }
        let is_long = segments.len() > 1;
        let is_claim = match is_fenced {
            true => is_long && (self.root.join(first).exists() || path.ends_with('/')),
            false => has_ending || (is_long && path.ends_with('/')),
        };
        let is_written = !is_long && self.names.contains(path);
        (is_claim && !is_written).then(|| format!("no file or folder {path}"))
    }

    /// A name of the sources: `snake_case`, or with `::`.
    fn name(&self, text: &str) -> Option<String> {
        let is_name = text
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || "_:()".contains(c));
        let is_claim = text.contains("::") || (text.contains('_') && !is_placeholder(text));
        let bare = text.trim_end_matches("()");
        let mut parts = bare.split("::").filter(|part| !part.is_empty());
        let missing = parts.find(|part| !self.names.contains(*part));
        missing
            .filter(|_| is_name && is_claim)
            .map(|part| format!("no source has the name {part}"))
    }

    /// The test programs of a package whose manifest lists them all.
    fn programs(&self, package: &str) -> Option<Vec<String>> {
        let path = self.root.join(package).join("Cargo.toml");
        let manifest: toml::Table = fs::read_to_string(path).ok()?.parse().ok()?;
        if manifest["package"].get("autotests")? != &toml::Value::Boolean(false) {
            return None;
        }
        let programs = manifest["test"].as_array()?.iter();
        let names = programs.filter_map(|program| program["name"].as_str());
        Some(names.map(String::from).collect())
    }

    /// Packages and test targets of a call of cargo.
    fn cargo(&self, text: &str) -> Option<String> {
        let words: Vec<&str> = text.split_whitespace().collect();
        let after = |option: &str| {
            let mut words = words.iter().skip_while(|word| **word != option);
            words.nth(1).copied()
        };
        if let (Some(package), Some(test)) = (after("-p"), after("--test"))
            && let Some(programs) = self.programs(package)
            && !programs.contains(&test.to_string())
        {
            return Some(format!("{package} has no test program {test}"));
        }
        words.windows(2).find_map(|pair| {
            let [option, value] = pair else { return None };
            let is_there = match *option {
                "-p" => self.packages.contains(*value),
                "--test" | "--example" => {
                    let folder = option.trim_start_matches('-').to_string();
                    let folder = if folder == "test" {
                        "tests"
                    } else {
                        "examples"
                    };
                    let found = files(&self.root, &|path| {
                        path.file_stem().is_some_and(|stem| stem == *value)
                            && path.parent().is_some_and(|parent| parent.ends_with(folder))
                    });
                    !found.is_empty()
                }
                _ => true,
            };
            let is_sample = is_placeholder(value);
            (!is_there && !is_sample).then(|| format!("cargo knows no {option} {value}"))
        })
    }
}

/// The words of all sources but this test's.
fn names(root: &Path) -> BTreeSet<String> {
    let own = root.join("tests/tests");
    let sources = files(root, &|path| {
        let is_own = path.starts_with(own.join("docs")) || path.ends_with("tests/docs.rs");
        !is_own && (SOURCE_ENDINGS.contains(&ending(path)) || path.ends_with("vlaps"))
    });
    let mut names = BTreeSet::new();
    for path in sources {
        let text = fs::read_to_string(&path).expect("a source");
        let name = path
            .file_name()
            .map(|name| name.to_string_lossy().into_owned());
        names.extend(name);
        let is_part = |c: char| c.is_ascii_alphanumeric() || c == '_';
        names.extend(text.split(|c| !is_part(c)).map(String::from));
        names.extend(
            text.split(|c| !(is_part(c) || ".-".contains(c)))
                .map(String::from),
        );
    }
    names
}

#[test]
fn every_reference_in_the_pages_exists() {
    let facts = Facts::get();
    let pages = files(&facts.root, &|path| ending(path) == "md");
    assert!(pages.len() > 10, "the pages were found");
    let problems: Vec<String> = pages
        .iter()
        .flat_map(|path| {
            let name = path.strip_prefix(&facts.root).expect("inside");
            let text = fs::read_to_string(path).expect("a page");
            facts.problems(&name.to_string_lossy(), &text)
        })
        .collect();
    assert!(problems.is_empty(), "\n{}\n", problems.join("\n"));
}

#[test]
fn every_reference_in_the_help_exists() {
    let facts = Facts::get();
    let mut problems = Vec::new();
    for (words, text) in &facts.help {
        for line in text.lines().map(str::trim) {
            let quoted = line.split('`').skip(1).step_by(2);
            let example = line
                .split("./vlaps")
                .next()
                .is_some_and(|before| before.split_whitespace().all(|word| word.contains('=')));
            let whole = example
                .then_some(line)
                .filter(|line| line.contains("./vlaps "));
            let commands = quoted.chain(whole).flat_map(commands_in);
            let wrong = commands.filter_map(|command| facts.command(&command));
            let tokens = line.split([' ', ',', ';', '(', ')', '`']);
            let bare = tokens.map(|token| token.trim_end_matches(['.', ':']));
            let keys = bare.filter_map(|token| facts.key(token));
            problems.extend(
                wrong
                    .chain(keys)
                    .map(|what| format!("./vlaps {} --help: {what}", words.join(" "))),
            );
        }
    }
    assert!(problems.is_empty(), "\n{}\n", problems.join("\n"));
}

#[test]
fn the_checks_find_what_is_wrong() {
    let facts = Facts::get();
    for right in [
        "[map](ARCHITECTURE.md), [tick](ARCHITECTURE.md#one-tick)",
        "`./vlaps up --lockstep --episodes 5 --seed 3 --json a.json`",
        "`eval --episodes N`, `--lockstep`, `vlaps.toml`, `gate.period_s=5`",
        "`vehicle/src/lib.rs`, `Observation::features`, `late_ticks`",
        "`cargo test -p vehicle`",
        "`cargo test -p planner --test all tree::`",
        "```sh\n./vlaps eval --driver expert \\\n    --episodes 10 | tee x\n```",
    ] {
        assert_eq!(facts.problems("README.md", right), [""; 0], "{right}");
    }
    for wrong in [
        "[map](ARCHITECTURE-OLD.md)",
        "[tick](ARCHITECTURE.md#no-tick)",
        "`./vlaps fly`",
        "`./vlaps up --locked`",
        "`eval --episodes none`",
        "`./vlaps up --set gate.perriod_s=5`",
        "`--no-such-option`",
        "`gate.perriod_s`",
        "`vehicle/src/wings.rs`",
        "`no_such_key_anywhere`",
        "`Observation::wings_of_it`",
        "`cargo test -p wings`",
        "`cargo test -p planner --test tree`",
        "```sh\n./vlaps eval --driver expert \\\n    --wings\n```",
    ] {
        let problems = facts.problems("README.md", wrong);
        assert_eq!(problems.len(), 1, "{wrong}: {problems:?}");
    }
}
