//! A recorded drive as an animation: decoded again, it shows the drive; what cannot be
//! exported is told in one line, and no file remains.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use shm_config::message::Driver;
use shm_config::palette;
use vlaps_tests::{Set, programs};

fn export(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(programs().join("vlaps-supervisor"));
    command.arg("export").args(arguments).current_dir(folder);
    command.output().expect("the supervisor")
}

/// Pixels of each frame that have this colour, and the size of its rectangle.
fn frames(file: &Path, colour: [u8; 3]) -> Vec<(usize, [u32; 2])> {
    let bytes = fs::read(file).expect("a file");
    let decoder = png::Decoder::new(std::io::Cursor::new(bytes));
    let mut reader = decoder.read_info().expect("a PNG");
    let colours = reader.info().palette.clone().expect("a palette");
    let entry = colours.chunks_exact(3).position(|known| known == colour);
    let entry = entry.expect("the colour is in the palette") as u8;
    let control = reader.info().animation_control.expect("an animation");
    let frame = |_| {
        let mut buffer = vec![0; reader.output_buffer_size().expect("a size")];
        reader.next_frame(&mut buffer).expect("a frame");
        let part = reader.info().frame_control().expect("a frame");
        let shown = &buffer[..(part.width * part.height) as usize];
        let count = shown.iter().filter(|pixel| **pixel == entry).count();
        (count, [part.width, part.height])
    };
    (0..control.num_frames).map(frame).collect()
}

#[test]
fn an_animation_shows_the_recorded_drive() {
    let set = Set::new("export");
    let drive = [
        "--lockstep",
        "--seed",
        "3",
        "--duration",
        "10",
        "--record",
        "rec",
    ];
    let output = set.run(&drive);
    assert!(output.status.success(), "{output:?}\n{}", set.logs());
    let folder = set.folder();
    let span = [
        "--from", "2", "--to", "8", "--speed", "2", "--size", "320x180",
    ];
    let arguments = [&["rec", "--out", "drive.png"], &span[..]].concat();
    let output = export(folder, &arguments);
    assert!(output.status.success(), "{output:?}");
    let frames = frames(&folder.join("drive.png"), palette::driver(Driver::Expert));
    // Six seconds, twice as fast as driven, ten pictures a second.
    assert!((29..=32).contains(&frames.len()), "{}", frames.len());
    assert_eq!(frames[0].1, [320, 180]);
    assert!(
        frames[0].0 > 100,
        "the expert's car and its part of the band"
    );
    let moved = frames[1..].iter().filter(|(_, [width, _])| *width > 100);
    assert_eq!(moved.count(), frames.len() - 1, "the car moves: {frames:?}");
    // The same recording gives the same file.
    let first = fs::read(folder.join("drive.png")).expect("a file");
    assert!(export(folder, &arguments).status.success());
    assert!(first == fs::read(folder.join("drive.png")).expect("a file"));

    for (arguments, expected) in [
        (
            &["rec", "--out", "late.png", "--from", "100"][..],
            "no step of a controller",
        ),
        (&["rec", "--out", "drive.gif"], "must end in .png"),
        (&["nothing", "--out", "none.png"], "nothing"),
        (&["rec", "--size", "9x9"], "must be WIDTHxHEIGHT"),
        (&["rec", "--speed", "nan"], "must be a number"),
        (
            &["rec", "--out", "back.png", "--from", "5", "--to", "4"],
            "the end must be after",
        ),
    ] {
        let output = export(folder, arguments);
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {told}");
        assert!(told.contains(expected), "{arguments:?}: {told}");
    }
    let files = fs::read_dir(folder).expect("a folder").flatten();
    let names: Vec<_> = files
        .map(|file| file.file_name().into_string().expect("UTF-8"))
        .collect();
    let left = |name: &&String| name.ends_with(".part") || name.contains("late");
    assert_eq!(names.iter().find(left), None, "{names:?}");
}
