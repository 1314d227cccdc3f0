//! Both sides of a row over networks that fail.

use super::*;
use rand::{Rng as _, RngExt as _, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

const ROW: RowId = RowId(1);
const MS: u64 = 1_000_000;

fn message(number: u64) -> Arc<[u8]> {
    number.to_le_bytes().to_vec().into()
}

fn number(parcel: &Parcel) -> u64 {
    u64::from_le_bytes(parcel.bytes[..].try_into().expect("eight bytes"))
}

/// Sends over a network that loses, doubles, delays and reorders; returns what arrives.
fn pass(seed: u64, passage: Passage, count: u64) -> (Vec<u64>, Outbox, Inbox) {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let (mut outbox, mut inbox) = (Outbox::default(), Inbox::default());
    let mut on_the_way: Vec<(u64, Parcel)> = Vec::new();
    let mut acks: Vec<(u64, Reached)> = Vec::new();
    let mut arrived = Vec::new();
    for turn in 0..count * 40 {
        let now = Instant(turn * MS);
        if turn % 2 == 0 && turn / 2 < count {
            outbox.push(ROW, passage, message(turn / 2 + 1));
        }
        outbox.due(now, 50 * MS, &mut |parcel| {
            for _ in 0..1 + u32::from(random.random_ratio(1, 20)) {
                if !random.random_ratio(1, 10) {
                    on_the_way.push((turn + random.next_u64() % 30, parcel.clone()));
                }
            }
        });
        let (here, later): (Vec<_>, _) = on_the_way.into_iter().partition(|(at, _)| *at <= turn);
        on_the_way = later;
        for (_, parcel) in here {
            inbox.take(parcel, passage, &mut |parcel| arrived.push(number(&parcel)));
        }
        inbox.acknowledge(|_, last| {
            if !random.random_ratio(1, 10) {
                acks.push((turn + 15, last));
            }
        });
        acks.retain(|(at, last)| {
            if *at <= turn {
                outbox.acknowledge(ROW, *last, now);
            }
            *at > turn
        });
        if outbox.is_empty() && turn / 2 > count {
            break;
        }
    }
    (arrived, outbox, inbox)
}

#[test]
fn every_message_arrives_once_and_in_order_over_a_network_that_loses_doubles_and_reorders() {
    for seed in 0..8 {
        let (arrived, outbox, inbox) = pass(seed, Passage::Every, 500);
        assert_eq!(arrived, (1..=500).collect::<Vec<_>>(), "seed {seed}");
        let received = inbox.received().next().expect("a row").1;
        assert_eq!((received.messages, received.lost), (500, 0), "seed {seed}");
        assert!(
            received.doubled > 0 && received.reordered > 0,
            "seed {seed}"
        );
        assert!(
            outbox.sent().next().expect("a row").1.again > 0,
            "seed {seed}"
        );
    }
}

#[test]
fn the_newest_arrives_at_last_and_never_after_a_newer_one() {
    for seed in 0..8 {
        let (arrived, _, inbox) = pass(seed, Passage::Newest, 300);
        assert_eq!(arrived.last(), Some(&300), "seed {seed}");
        assert!(arrived.is_sorted(), "seed {seed}");
        let received = inbox.received().next().expect("a row").1;
        let first = arrived[0];
        let counted = first - 1 + received.messages + received.skipped;
        assert_eq!(counted, 300, "seed {seed}");
    }
}

/// A partition longer than the queue: both sides count the same loss, and go on.
#[test]
fn what_the_full_queue_drops_is_counted_on_both_sides() {
    let (mut outbox, mut inbox) = (Outbox::default(), Inbox::default());
    let dropped = 300;
    let mut arrived = Vec::new();
    outbox.push(ROW, Passage::Every, message(0));
    outbox.due(Instant(0), 50 * MS, &mut |parcel| {
        inbox.take(parcel, Passage::Every, &mut |_| {});
    });
    inbox.acknowledge(|row, last| outbox.acknowledge(row, last, Instant(0)));
    for k in 1..=QUEUE_MAX as u64 + dropped {
        outbox.push(ROW, Passage::Every, message(k));
    }
    for turn in 0..200 {
        let now = Instant(turn * MS);
        let mut parcels = Vec::new();
        outbox.due(now, 50 * MS, &mut |parcel| parcels.push(parcel));
        for parcel in parcels {
            inbox.take(parcel, Passage::Every, &mut |parcel| {
                arrived.push(number(&parcel))
            });
        }
        inbox.acknowledge(|row, last| outbox.acknowledge(row, last, now));
    }
    assert_eq!(arrived.first(), Some(&(dropped + 1)));
    assert_eq!(arrived.len(), QUEUE_MAX);
    assert_eq!(outbox.sent().next().expect("a row").1.lost, dropped);
    assert_eq!(inbox.received().next().expect("a row").1.lost, dropped);
}

#[test]
fn a_false_acknowledgement_frees_nothing() {
    let mut outbox = Outbox::default();
    outbox.push(ROW, Passage::Every, message(1));
    outbox.acknowledge(ROW, Reached::all(7), Instant(0));
    outbox.acknowledge(RowId(9), Reached::all(1), Instant(0));
    assert!(!outbox.is_empty());
    outbox.acknowledge(ROW, Reached::all(1), Instant(0));
    assert!(outbox.is_empty());
}

/// A cut in the middle: a new connection sends again what is not acknowledged, at once.
#[test]
fn a_new_connection_begins_at_the_first_message_that_is_missing() {
    let mut outbox = Outbox::default();
    for k in 1..=10 {
        outbox.push(ROW, Passage::Every, message(k));
    }
    let due = |outbox: &mut Outbox, at: u64| {
        let mut numbers = Vec::new();
        outbox.due(Instant(at), 50 * MS, &mut |parcel| {
            numbers.push(parcel.sequence)
        });
        numbers
    };
    assert_eq!(due(&mut outbox, 0).len(), 10);
    assert!(due(&mut outbox, MS).is_empty());
    outbox.acknowledge(ROW, Reached::all(4), Instant(2 * MS));
    outbox.begin_again();
    assert_eq!(due(&mut outbox, 3 * MS), (5..=10).collect::<Vec<_>>());
}

/// The bytes of a message that is longer than a piece.
fn long(number: u64, bytes: usize) -> Arc<[u8]> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(number);
    let mut whole = vec![0; bytes];
    random.fill_bytes(&mut whole);
    whole.into()
}

/// Half a megabyte over a network that drops each long packet, and one in ten of the others.
#[test]
fn a_policy_file_arrives_over_a_network_that_drops_long_packets() {
    const PACKET: usize = 33 << 10;
    for seed in 0..8 {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let (mut outbox, mut inbox) = (Outbox::default(), Inbox::default());
        let whole = long(seed, 535_000);
        outbox.push(ROW, Passage::Newest, whole.clone());
        let mut arrived = Vec::new();
        let mut turn = 0;
        while arrived.is_empty() && turn < 20_000 {
            turn += 1;
            let now = Instant(turn * MS);
            let mut parcels = Vec::new();
            outbox.due(now, 50 * MS, &mut |parcel| parcels.push(parcel));
            parcels.retain(|parcel| parcel.bytes.len() <= PACKET && !random.random_ratio(1, 10));
            for parcel in parcels {
                inbox.take(parcel, Passage::Newest, &mut |parcel| arrived.push(parcel));
            }
            inbox.acknowledge(|row, reached| {
                if !random.random_ratio(1, 10) {
                    outbox.acknowledge(row, reached, now);
                }
            });
        }
        assert_eq!(arrived.len(), 1, "seed {seed}");
        assert!(arrived[0].bytes == whole, "seed {seed}");
        let received = inbox.received().next().expect("a row").1;
        assert_eq!((received.messages, received.skipped), (1, 0), "seed {seed}");
    }
}

/// Each picture takes longer than the next one: the one that is on its way arrives, and then
/// the newest.
#[test]
fn a_message_on_its_way_in_pieces_is_not_replaced() {
    let (mut outbox, mut inbox) = (Outbox::default(), Inbox::default());
    let mut arrived = Vec::new();
    for turn in 1..=100 {
        let now = Instant(turn * MS);
        outbox.push(ROW, Passage::Newest, long(turn, 300_000));
        outbox.due(now, 50 * MS, &mut |parcel| {
            inbox.take(parcel, Passage::Newest, &mut |parcel| {
                arrived.push(parcel.sequence);
            });
        });
        inbox.acknowledge(|row, reached| outbox.acknowledge(row, reached, now));
    }
    // Ten pieces, four in a turn.
    assert_eq!(&arrived[..3], [1, 4, 7]);
    let sent = outbox.sent().next().expect("a row").1;
    assert_eq!(sent.again, 0);
}

/// A slow network: a piece takes longer than the wait that the round trip of a ping gives.
#[test]
fn pieces_are_not_sent_again_because_the_network_is_slow() {
    let (mut outbox, mut inbox) = (Outbox::default(), Inbox::default());
    outbox.push(ROW, Passage::Newest, long(1, 535_000));
    let mut queue = VecDeque::new();
    let (mut free, mut arrived) = (0, 0);
    for turn in 1..=30_000 {
        let now = Instant(turn * MS);
        outbox.due(now, 100 * MS, &mut |parcel| queue.push_back(parcel));
        if turn >= free
            && let Some(parcel) = queue.pop_front()
        {
            free = turn + 260;
            inbox.take(parcel, Passage::Newest, &mut |_| arrived += 1);
        }
        inbox.acknowledge(|row, reached| outbox.acknowledge(row, reached, now));
    }
    assert_eq!(arrived, 1);
    let sent = outbox.sent().next().expect("a row").1;
    assert!(sent.again <= 8, "{}", sent.again);
    assert!(outbox.is_empty());
}

/// The other process is another one now, and has no piece.
#[test]
fn a_new_process_gets_all_pieces() {
    let mut outbox = Outbox::default();
    let whole = long(1, 300_000);
    outbox.push(ROW, Passage::Newest, whole.clone());
    let turn = |inbox: &mut Inbox, outbox: &mut Outbox, at: u64| {
        let mut arrived = Vec::new();
        outbox.due(Instant(at * MS), 50 * MS, &mut |parcel| {
            inbox.take(parcel, Passage::Newest, &mut |parcel| arrived.push(parcel));
        });
        inbox.acknowledge(|row, reached| outbox.acknowledge(row, reached, Instant(at * MS)));
        arrived
    };
    assert!(turn(&mut Inbox::default(), &mut outbox, 1).is_empty());
    outbox.begin_again();
    let mut inbox = Inbox::default();
    let arrived: Vec<_> = (2..=4)
        .flat_map(|at| turn(&mut inbox, &mut outbox, at))
        .collect();
    assert_eq!(arrived.len(), 1);
    assert!(arrived[0].bytes == whole);
}

/// The session is lost with most of the pieces here; of these only the four are sent again
/// of which nothing is known yet.
#[test]
fn a_new_session_goes_on_with_the_pieces_that_are_here() {
    let (mut outbox, mut inbox) = (Outbox::default(), Inbox::default());
    let whole = long(1, 535_000);
    outbox.push(ROW, Passage::Newest, whole.clone());
    let (mut arrived, mut sent) = (Vec::new(), Vec::new());
    for turn in 1..=8 {
        if turn == 4 {
            outbox.begin_again();
        }
        outbox.due(Instant(turn * MS), 50 * MS, &mut |parcel| {
            sent.push(parcel.piece);
            inbox.take(parcel, Passage::Newest, &mut |parcel| arrived.push(parcel));
        });
        inbox.acknowledge(|row, reached| outbox.acknowledge(row, reached, Instant(turn * MS)));
    }
    let pieces: Vec<u16> = (0..12).chain(0..4).chain(12..17).collect();
    assert_eq!(sent, pieces);
    assert_eq!(arrived.len(), 1);
    assert!(arrived[0].bytes == whole);
    assert!(outbox.is_empty());
}
