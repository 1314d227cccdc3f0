//! Tests that the source folders import in one direction.

use std::fs;
use std::path::{Path, PathBuf};

fn sources_below(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder of sources").flatten() {
        let path = entry.path();
        match path.is_dir() {
            true => sources_below(&path, found),
            false => found.push(path),
        }
    }
}

#[test]
fn a_folder_imports_only_folders_above_it_in_the_documented_table() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let docs = fs::read_to_string(root.join("lib.rs")).expect("the crate's documentation");
    let order: Vec<&str> = docs
        .lines()
        .filter_map(|line| line.strip_prefix("//! | [`")?.split_once('`'))
        .map(|(folder, _)| folder)
        .collect();
    let mut imports = 0;
    for (place, folder) in order.iter().enumerate() {
        let mut files = Vec::new();
        sources_below(&root.join(folder), &mut files);
        for file in files {
            let text = fs::read_to_string(&file).expect("a source");
            let code = text.lines().filter(|line| !line.trim().starts_with("//"));
            for path in code.flat_map(|line| line.split("crate::").skip(1)) {
                let is_name = |name: &str| name.chars().all(|c| c.is_alphanumeric() || c == '_');
                let Some((other, _)) = path.split_once("::").filter(|(name, _)| is_name(name))
                else {
                    continue;
                };
                // The list of commands imports all folders but the last.
                let is_list = other == "arguments" && place + 1 == order.len();
                let above = is_list || order[..=place].contains(&other);
                assert!(above, "{} imports crate::{other}", file.display());
                imports += 1;
            }
        }
    }
    let folders = fs::read_dir(&root).expect("the sources").flatten();
    let folders = folders.filter(|entry| entry.path().is_dir()).count();
    assert_eq!(
        order.len(),
        folders,
        "each folder is in the table: {order:?}"
    );
    assert!(imports > 100, "imports were found: {imports}");
}
