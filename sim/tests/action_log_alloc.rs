//! Writing to the action log costs a tick no allocation and no wait, whether or not the
//! log is read.

use allocation_counter::measure;
use shm_config::message::Header;
use sim::render_thread::{Move, Seen, action_log};
use vehicle::Action;

/// Twice as many entries as the queue holds: an instant and a move each.
const TICKS: u64 = 1 << 16;

#[test]
fn entries_that_are_not_read_are_dropped_without_an_allocation() {
    let control = measure(|| drop(std::hint::black_box(Vec::<u8>::with_capacity(100))));
    assert_eq!(control.count_total, 1, "the counter counts");

    let (mut writer, mut log) = action_log();
    let telling = measure(|| {
        for episode in 0..2 {
            writer.begin(episode, 7);
            for tick in 0..TICKS {
                writer.saw(Seen {
                    tick,
                    taken_ns: tick,
                    passed: 0.0,
                });
                writer.moved(Move {
                    action: Action::BRAKE,
                    substeps: 5,
                });
            }
        }
    });
    assert_eq!((telling.count_total, telling.count_current), (0, 0));

    // The entries were written, and exceeded the queue.
    log.drain();
    let episode_log = log.episode(0).expect("the episode");
    let at = |tick| {
        episode_log.at(&Header {
            tick,
            ..Header::default()
        })
    };
    assert!(at(30_000).is_some() && at(TICKS - 1).is_none());
    assert!(
        log.episode(1).is_none(),
        "there was no room for its beginning"
    );
}
