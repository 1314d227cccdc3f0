//! The stand-in over HTTP: it recognises the safer driver, and asking twice reduces a
//! bias towards the first path.

use bench::judging::measure;
use bench::{Bench, Command};
use clap::Parser;
use shm_config::Instant;
use shm_config::config::Config;
use supervisor::subcommand::Program;

/// Nothing here is timed.
fn no_clock() -> Instant {
    Instant(0)
}

#[test]
fn the_stand_in_is_right_and_asking_twice_reduces_its_bias() {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("judging");
    let _ = std::fs::remove_dir_all(&folder);
    let words = format!(
        "vlaps bench judge --scenes 30 --view top_down --first-seed 1000 --record {}",
        folder.display()
    );
    let arguments = Program::<Command>::try_parse_from(words.split(' ')).expect("a command");
    let Command::Bench(Bench::Judge(arguments)) = arguments.command else {
        panic!("no judge: {words}");
    };
    let rows = measure(&arguments, &Config::default(), (no_clock, None), || {}).expect("measured");
    let [once, twice, biased, mended] = rows.as_slice() else {
        panic!("two servers, each asked once and twice: {rows:?}");
    };
    for row in &rows {
        let asked: usize = row.confusion.iter().flatten().sum();
        assert_eq!((asked, row.failed), (30, 0), "{row:?}");
    }
    for name in ["top_down-stand-in", "top_down-stand-in-bias-0.72"] {
        assert!(folder.join(name).is_dir(), "one folder per judge: {name}");
    }
    let share = |row: &bench::judging::evaluation::Row| row.right_of_preferences.mean();
    assert!(share(once) >= 0.9 && share(twice) >= 0.9, "{rows:#?}");
    assert!(share(biased) < share(once), "a bias shows: {rows:#?}");
    assert!(share(mended) > share(biased), "and is mended: {rows:#?}");
    let off = |row: &bench::judging::evaluation::Row| (row.first_place.mean() - 0.5).abs();
    assert!(off(mended) < off(biased), "{rows:#?}");
    assert!(
        mended.abstained > twice.abstained,
        "by abstaining: {rows:#?}"
    );
}
