//! Tests of the dependencies between crates, the homes of `unsafe` and of iceoryx2, the
//! files of `tests/`, and the size of files.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Which crates of this workspace each crate may use in shipped code.
const ARROWS: &[(&str, &[&str])] = &[
    ("vehicle", &[]),
    ("shm-config", &["vehicle"]),
    ("runtime", &["shm-config"]),
    ("tracker", &["vehicle", "shm-config"]),
    ("planner", &["vehicle", "shm-config", "runtime", "tracker"]),
    ("safety", &["vehicle", "shm-config"]),
    (
        "gate",
        &["vehicle", "shm-config", "runtime", "safety", "policy"],
    ),
    (
        "judge",
        &["vehicle", "shm-config", "policy", "gate", "learner"],
    ),
    ("policy", &["vehicle", "shm-config"]),
    (
        "controller",
        &[
            "vehicle",
            "shm-config",
            "runtime",
            "tracker",
            "safety",
            "policy",
        ],
    ),
    ("robot", &["vehicle", "shm-config", "runtime"]),
    ("sim", &["vehicle", "shm-config", "runtime", "robot"]),
    ("capi", &["vehicle", "shm-config", "runtime", "robot"]),
    (
        "learner",
        &["vehicle", "shm-config", "runtime", "policy", "stack"],
    ),
    ("supervisor", &["vehicle", "shm-config", "runtime"]),
    (
        "recorder",
        &["vehicle", "shm-config", "tracker", "planner", "runtime"],
    ),
    (
        "python",
        &[
            "vehicle",
            "shm-config",
            "safety",
            "policy",
            "controller",
            "sim",
            "stack",
            "recorder",
        ],
    ),
    (
        "stack",
        &[
            "vehicle",
            "shm-config",
            "tracker",
            "planner",
            "controller",
            "sim",
        ],
    ),
    (
        "view",
        &[
            "vehicle",
            "shm-config",
            "gate",
            "planner",
            "recorder",
            "sim",
            "stack",
            "supervisor",
        ],
    ),
    (
        "lab",
        &[
            "vehicle",
            "shm-config",
            "planner",
            "gate",
            "policy",
            "controller",
            "sim",
            "judge",
            "recorder",
            "learner",
            "stack",
            "view",
            "supervisor",
        ],
    ),
];

/// Begins the list of the files that may hold `unsafe`, in docs/unsafe.md: the one
/// definition. A row is `| path | why |`.
const UNSAFE_HEADING: &str = "# Homes of `unsafe`";

/// Lines of the longest source file.
const LINES_MAX: usize = 500;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn manifest(path: &Path) -> toml::Table {
    let text = fs::read_to_string(path).expect("a manifest");
    text.parse().expect("TOML")
}

fn keys<'a>(manifest: &'a toml::Table, table: &str) -> BTreeSet<&'a str> {
    let table = manifest.get(table).and_then(|table| table.as_table());
    table
        .into_iter()
        .flatten()
        .map(|(key, _)| key.as_str())
        .collect()
}

fn sources() -> Vec<(String, String)> {
    let mut files = Vec::new();
    let mut folders: Vec<PathBuf> = members().iter().map(|name| root().join(name)).collect();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder").flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let name = path
                    .strip_prefix(root())
                    .expect("inside")
                    .display()
                    .to_string();
                files.push((name, fs::read_to_string(&path).expect("a source")));
            }
        }
    }
    assert!(files.len() > 50, "the sources were found");
    files
}

fn members() -> Vec<String> {
    let root = manifest(&root().join("Cargo.toml"));
    let members = root["workspace"]["members"].as_array().expect("members");
    members
        .iter()
        .filter_map(|name| name.as_str().map(String::from))
        .collect()
}

#[test]
fn arrows_point_one_way() {
    let workspace: BTreeSet<String> = members().into_iter().collect();
    for (name, allowed) in ARROWS {
        let manifest = manifest(&root().join(name).join("Cargo.toml"));
        for used in keys(&manifest, "dependencies") {
            let ours = workspace.contains(used);
            assert!(
                !ours || allowed.contains(&used),
                "{name} must not use {used}"
            );
        }
    }
}

/// Cargo compiles no file of `tests/` by itself where a manifest says `autotests = false`.
#[test]
fn every_file_of_tests_is_compiled() {
    let mut merged = 0;
    for member in members() {
        let folder = root().join(&member);
        let manifest = manifest(&folder.join("Cargo.toml"));
        if manifest["package"].get("autotests") != Some(&toml::Value::Boolean(false)) {
            continue;
        }
        merged += 1;
        let programs = manifest["test"].as_array().expect("a list of programs");
        let all = fs::read_to_string(folder.join("tests/all.rs")).expect("the program of modules");
        for entry in fs::read_dir(folder.join("tests")).expect("the folder of tests") {
            let file = entry.expect("an entry").file_name();
            let Some(name) = file.to_str().and_then(|file| file.strip_suffix(".rs")) else {
                continue;
            };
            let is_program = programs
                .iter()
                .any(|program| program["name"].as_str() == Some(name));
            let is_module = all.lines().any(|line| line == format!("mod {name};"));
            assert!(
                is_program != is_module,
                "{member}/tests/{name}.rs: either a module of {member}/tests/all.rs or a program of its manifest"
            );
        }
    }
    assert!(merged > 5, "{merged} crates with one program of tests");
}

#[test]
fn only_the_wire_names_iceoryx2() {
    for name in members() {
        let manifest = manifest(&root().join(&name).join("Cargo.toml"));
        let tables = ["dependencies", "dev-dependencies", "build-dependencies"];
        let uses = tables
            .iter()
            .any(|table| keys(&manifest, table).contains("iceoryx2"));
        // The comparison with the bare library needs it, in one file.
        assert_eq!(
            uses,
            ["shm-config", "bench"].contains(&name.as_str()),
            "{name}"
        );
    }
    for (name, text) in sources() {
        let is_home = name.starts_with("shm-config/") || name.ends_with("bench/src/ipc/bare.rs");
        if is_home || name.ends_with("tests/tests/boundaries.rs") {
            continue;
        }
        assert!(
            !text.contains("use iceoryx2"),
            "{name} must not name iceoryx2"
        );
    }
}

/// The files that docs/unsafe.md lists.
fn unsafe_homes() -> BTreeSet<String> {
    let text = fs::read_to_string(root().join("docs/unsafe.md")).expect("docs/unsafe.md");
    let (_, after) = text.split_once(UNSAFE_HEADING).expect("the list of homes");
    let list = after.split("\n## ").next().unwrap_or(after);
    let rows = list.lines().filter_map(|line| line.strip_prefix("| `"));
    rows.filter_map(|row| Some(row.split_once('`')?.0.to_string()))
        .collect()
}

/// Whether the line contains `unsafe` as a keyword, and not within a comment, a string
/// or a longer name.
fn is_unsafe(line: &str) -> bool {
    let code = line.split("//").next().unwrap_or_default();
    let is_name = |c: char| c.is_alphanumeric() || c == '_';
    let word = "unsafe";
    code.match_indices(word).any(|(at, _)| {
        let (before, after) = (&code[..at], &code[at + word.len()..]);
        let quoted = before.matches('"').count() % 2 == 1;
        !quoted && !before.ends_with(is_name) && !after.starts_with(is_name)
    })
}

#[test]
fn unsafe_code_stays_in_its_homes_and_says_why() {
    let homes = unsafe_homes();
    assert!(homes.len() >= 5, "the list was read: {homes:?}");
    let mut seen = BTreeSet::new();
    for (name, text) in sources() {
        let blocks = text.lines().filter(|line| is_unsafe(line)).count();
        let is_allowed = text.contains(concat!("allow(", "unsafe_code)"));
        if blocks == 0 && !is_allowed {
            continue;
        }
        assert!(
            homes.contains(&name),
            "{name} is no home of unsafe: say why in docs/unsafe.md, \
             or do without"
        );
        assert!(
            text.contains("SAFETY:"),
            "{name}: each has its SAFETY sentence"
        );
        seen.insert(name);
    }
    assert_eq!(seen, homes, "a home without unsafe is none");
}

#[test]
fn the_search_for_unsafe_finds_what_it_should() {
    for line in [
        "unsafe {",
        "    unsafe impl Send for X {}",
        "pub unsafe fn f() {",
        "#[unsafe(no_mangle)]",
        "unsafe extern \"C\" {",
    ] {
        assert!(is_unsafe(line), "{line}");
    }
    for line in ["// unsafe", "let unsafe_code = 1;", "let a = \"unsafe\";"] {
        assert!(!is_unsafe(line), "{line}");
    }
}

#[test]
fn files_stay_readable() {
    let long: Vec<_> = sources()
        .into_iter()
        .map(|(name, text)| (text.lines().count(), name))
        .filter(|(lines, _)| *lines > LINES_MAX)
        .collect();
    assert_eq!(long, [], "over {LINES_MAX} lines");
}
