//! Telling the photographer costs a tick no allocation and no waiting, whether or
//! not anybody reads what is told.

use allocation_counter::measure;
use shm_config::message::Header;
use sim::photographer::{Move, Seen, film};
use vehicle::Action;

/// Twice as many as the queue holds, an instant and a move each.
const TICKS: u64 = 1 << 16;

#[test]
fn what_nobody_reads_is_dropped_without_an_allocation() {
    let control = measure(|| drop(std::hint::black_box(Vec::<u8>::with_capacity(100))));
    assert_eq!(control.count_total, 1, "the counter counts");

    let (mut recorder, mut film) = film();
    let telling = measure(|| {
        for episode in 0..2 {
            recorder.begin(episode, 7);
            for tick in 0..TICKS {
                recorder.saw(Seen {
                    tick,
                    taken_ns: tick,
                    passed: 0.0,
                });
                recorder.moved(Move {
                    action: Action::BRAKE,
                    substeps: 5,
                });
            }
        }
    });
    assert_eq!((telling.count_total, telling.count_current), (0, 0));

    // It was really told, and really too much.
    film.develop();
    let reel = film.reel(0).expect("the episode");
    let at = |tick| {
        reel.at(&Header {
            tick,
            ..Header::default()
        })
    };
    assert!(at(30_000).is_some() && at(TICKS - 1).is_none());
    assert!(
        film.reel(1).is_none(),
        "there was no room for its beginning"
    );
}
