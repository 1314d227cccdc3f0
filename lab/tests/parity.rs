//! Comparison with the recordings, if available: in the folder named by `VLAPS_GOLDEN`,
//! otherwise in `shared/data` beside the repository.

use std::path::{Path, PathBuf};

use lab::parity::Comparison;
use lab::parity::record::Golden;

fn folder() -> Option<PathBuf> {
    let named = std::env::var_os("VLAPS_GOLDEN").map(PathBuf::from);
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let folder = named.unwrap_or_else(beside);
    if Golden::read(&folder).is_ok() {
        return Some(folder);
    }
    println!(
        "skipped: no recordings in {} (set VLAPS_GOLDEN)",
        folder.display()
    );
    None
}

#[test]
fn every_bar_is_met() {
    let Some(folder) = folder() else { return };
    let comparison = Comparison::of(&folder).expect("the record is whole");
    assert!(comparison.conditions.seeds >= 50 && comparison.conditions.drives >= 100);
    assert!(
        comparison
            .rows
            .iter()
            .filter(|row| row.bar.is_some())
            .count()
            >= 24
    );
    assert!(comparison.is_met(), "\n{}", comparison.table());
}
