//! The vehicle's door against peers without a key, of another role, run, time or layout,
//! against what is sent twice, and against noise. Without a network: packets are handed over.

mod common;

use common::{Line, MS, bundle, keys};
use rand::{Rng as _, RngExt as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;
use shm_config::message::{Advice, Learning, Step};
use shm_config::services::{ADVICE, COMMAND, LEARNING, STEP, WEIGHTS};
use vlaps_link::cipher::SessionKeys;
use vlaps_link::host::{Event, Host, Seats};
use vlaps_link::keys::RunKeys;
use vlaps_link::packet::{Kind, seal, sign};
use vlaps_link::peer::{News, Peer};
use vlaps_link::refusal::Reason;
use vlaps_link::role::{Role, RowId, layouts};
use vlaps_link::rows::bytes_of;

fn row(service: &str) -> RowId {
    RowId::of(service).expect("a row that leaves")
}

fn line(role: Role) -> Line {
    let keys = keys();
    let peer = Peer::new(&bundle(&keys, role)).expect("a peer");
    Line::new(Host::new(keys, Seats::One(role)).expect("a host"), peer)
}

#[test]
fn a_judge_hears_steps_and_its_advice_arrives() {
    let mut line = line(Role::Judge);
    line.run(300);
    assert!(line.peer.live.is_some());
    let mut step = Step::default();
    step.header.tick = 5;
    line.host.push(row(STEP.name), bytes_of(&step));
    line.peer
        .push(row(ADVICE.name), bytes_of(&Advice::default()));
    line.run(20);
    let heard = |news: &News| matches!(news, News::Message(is, _) if *is == row(STEP.name));
    assert!(line.news.iter().any(heard));
    let came = |event: &Event| matches!(event, Event::Message(_, is, _) if *is == row(ADVICE.name));
    assert!(line.events.iter().any(came));
    assert_eq!(line.host.refused.all(), 0);
    let clock = &line.peer.live.as_ref().expect("a session").clock;
    assert!(
        clock
            .mapped(line.now.0)
            .is_some_and(|map| map.offset_ns.abs() < 10_000_000)
    );
}

#[test]
fn no_role_sends_what_another_may() {
    for (role, service) in [
        (Role::Judge, WEIGHTS.name),
        (Role::Judge, LEARNING.name),
        (Role::Judge, STEP.name),
        (Role::Learner, ADVICE.name),
        (Role::Learner, STEP.name),
        (Role::View, ADVICE.name),
        (Role::View, WEIGHTS.name),
        (Role::Recorder, LEARNING.name),
    ] {
        let keys = keys();
        let peer = Peer::new(&bundle(&keys, role)).expect("a peer");
        let seats = match role {
            Role::View | Role::Recorder => Seats::Readers,
            _ => Seats::One(role),
        };
        let mut line = Line::new(Host::new(keys, seats).expect("a host"), peer);
        line.run(300);
        line.peer.push(row(service), bytes_of(&Learning::default()));
        line.run(20);
        let taken = line
            .events
            .iter()
            .filter(|event| matches!(event, Event::Message(..)));
        assert_eq!(taken.count(), 0, "{role} sends {service}");
        assert!(
            line.host.refused.of(Reason::NotAllowed) > 0,
            "{role} sends {service}"
        );
    }
}

/// A command has no code at all; every code that is none is refused for every role.
#[test]
fn no_command_comes_from_elsewhere() {
    assert_eq!(RowId::of(COMMAND.name), None);
    for role in Role::ALL {
        let keys = keys();
        let peer = Peer::new(&bundle(&keys, *role)).expect("a peer");
        let seats = match role.stands_for() {
            Some(_) => Seats::One(*role),
            None => Seats::Readers,
        };
        let mut line = Line::new(Host::new(keys, seats).expect("a host"), peer);
        line.run(300);
        for code in 0..=u8::MAX {
            if !role.may_send(RowId(code)) {
                line.peer
                    .push(RowId(code), bytes_of(&Step::default().command));
            }
        }
        line.run(50);
        assert!(
            !line
                .events
                .iter()
                .any(|event| matches!(event, Event::Message(..)))
        );
        assert!(line.host.refused.of(Reason::NotAllowed) >= 250);
    }
}

fn refused(host: Host, peer: Peer, epoch_s: u64) -> (Reason, Line) {
    let mut line = Line::new(host, peer);
    line.epoch_s = epoch_s;
    line.run(600);
    assert!(line.peer.live.is_none(), "it must not join");
    assert!(
        !line
            .events
            .iter()
            .any(|event| matches!(event, Event::Joined(_)))
    );
    let told = line.news.iter().find_map(|news| match news {
        News::Refused(reason) => Some(*reason),
        _ => None,
    });
    let told = told.expect("a refusal that is told");
    assert!(line.host.refused.of(told) > 0, "{told} is counted");
    (told, line)
}

#[test]
fn each_wrong_peer_is_refused_with_its_own_reason() {
    let seats = Seats::One(Role::Judge);
    let host = || Host::new(keys(), seats).expect("a host");
    let invited = || bundle(&keys(), Role::Judge);
    let peer = |bundle| Peer::new(&bundle).expect("a peer");
    // Of another run.
    let other = RunKeys::make("drive").expect("keys");
    let foreign = bundle(&other, Role::Judge);
    assert_eq!(
        refused(host(), peer(foreign.clone()), 1).0,
        Reason::OtherRun
    );
    // Of another run, which names this one.
    let mut liar = foreign;
    liar.identity = keys().identity;
    assert_eq!(refused(host(), peer(liar), 1).0, Reason::WrongKey);
    // Of another role, honestly and with a changed word.
    let learner = bundle(&keys(), Role::Learner);
    assert_eq!(
        refused(host(), peer(learner.clone()), 1).0,
        Reason::WrongRole
    );
    let mut liar = learner;
    liar.role = "judge".into();
    assert_eq!(refused(host(), peer(liar), 1).0, Reason::WrongKey);
    // Ended, honestly and with a later end written in.
    let end = invited().expires_epoch_s;
    assert_eq!(refused(host(), peer(invited()), end).0, Reason::Expired);
    let mut liar = invited();
    liar.expires_epoch_s += 1_000_000;
    assert_eq!(refused(host(), peer(liar), end).0, Reason::WrongKey);
    // Revoked.
    let mut strict = host();
    let gone = invited();
    strict.revoke(vec![gone.peer]);
    assert_eq!(refused(strict, peer(gone), 1).0, Reason::Revoked);
    // Other layouts.
    let mut changed = peer(invited());
    changed.set_layouts(layouts() ^ 1);
    assert_eq!(refused(host(), changed, 1).0, Reason::OtherLayout);
}

#[test]
fn an_invitation_that_ends_or_is_revoked_ends_its_session() {
    for revokes in [false, true] {
        let mut line = line(Role::Judge);
        line.run(300);
        let claim = *line.peer.claim();
        match revokes {
            true => line.host.revoke(vec![claim.peer]),
            false => line.epoch_s = claim.expires_epoch_s,
        }
        line.peer
            .push(row(ADVICE.name), bytes_of(&Advice::default()));
        line.host.poll(line.now, line.epoch_s);
        line.run(300);
        assert!(
            line.events
                .iter()
                .any(|event| matches!(event, Event::Left(..)))
        );
        let taken = line
            .events
            .iter()
            .filter(|event| matches!(event, Event::Message(..)));
        assert_eq!(taken.count(), 0);
    }
}

/// A file of keys that is replaced, deleted or damaged undoes no revocation.
#[test]
fn without_the_keys_of_the_run_all_invitations_are_revoked() {
    let reads: [fn() -> std::io::Result<Option<RunKeys>>; 3] = [
        || Ok(Some(RunKeys::make("drive").expect("keys"))),
        || Ok(None),
        || Err(std::io::Error::other("damaged")),
    ];
    for read in reads {
        let mut line = line(Role::Judge);
        line.run(300);
        line.host.renew(read());
        line.host.renew(read());
        line.run(1_500);
        assert!(line.peer.live.is_none());
        assert!(line.host.refused.of(Reason::Revoked) > 0);
        let told = |event: &&Event| matches!(event, Event::Closed(Some(_)));
        assert_eq!(line.events.iter().filter(told).count(), 1);
        // The keys are put back, from a time before the peer was revoked.
        line.host.revoke(vec![line.peer.claim().peer]);
        line.host.renew(Ok(Some(keys())));
        line.run(1_500);
        assert!(line.events.contains(&Event::Closed(None)));
        assert!(line.peer.live.is_none());
    }
}

#[test]
fn a_second_judge_waits_until_the_first_is_gone() {
    let mut line = line(Role::Judge);
    line.run(300);
    let mut second = Peer::new(&bundle(&keys(), Role::Judge)).expect("a peer");
    second.poll(line.now);
    for bytes in second.take_out() {
        line.host.receive(&bytes, (line.now, line.now), 1);
    }
    assert_eq!(line.host.refused.of(Reason::Occupied), 1);
    // The first falls silent; the second asks again.
    line.now = line.now.after_ns(2_000 * MS);
    second.poll(line.now);
    for bytes in second.take_out() {
        line.host.receive(&bytes, (line.now, line.now), 1);
    }
    assert_eq!(line.host.refused.of(Reason::Occupied), 1);
    second.receive(&answer_to(&mut line), (line.now, line.now));
    assert!(second.live.is_some());
}

/// The vehicle's newest answer.
fn answer_to(line: &mut Line) -> Vec<u8> {
    let (_, _, bytes) = line.host.take_out().pop().expect("an answer");
    bytes
}

/// One invitation on two machines: the first one keeps its session until it is silent.
#[test]
fn a_twin_of_an_invitation_takes_no_session() {
    let keys = keys();
    let invitation = bundle(&keys, Role::Judge);
    let peer = Peer::new(&invitation).expect("a peer");
    let mut twin = Peer::new(&invitation).expect("a peer");
    let host = Host::new(keys, Seats::One(Role::Judge)).expect("a host");
    let mut line = Line::new(host, peer);
    line.run(300);
    twin.poll(line.now);
    for bytes in twin.take_out() {
        line.host.receive(&bytes, (line.now, line.now), 1);
    }
    twin.receive(&answer_to(&mut line), (line.now, line.now));
    assert_eq!(twin.take_news(), [News::Refused(Reason::Occupied)]);
    assert_eq!(line.host.refused.of(Reason::Occupied), 1);
    line.run(300);
    assert!(line.peer.live.is_some());
    assert_eq!(line.peer.joins, 1);
}

/// The vehicle's answer to a hello begins one session: a second one would have its keys, and
/// so the same key stream for other messages.
#[test]
fn an_answer_begins_one_session() {
    let mut line = line(Role::Judge);
    line.peer.poll(line.now);
    for bytes in line.peer.take_out() {
        line.host.receive(&bytes, (line.now, line.now), 1);
    }
    let answer = answer_to(&mut line);
    line.peer.receive(&answer, (line.now, line.now));
    assert!(line.peer.live.is_some());
    line.peer.end();
    line.peer.poll(line.now.after_ns(1_000 * MS));
    line.peer.receive(&answer, (line.now, line.now));
    assert!(line.peer.live.is_none());
    assert_eq!(line.peer.refused.of(Reason::Replayed), 1);
}

/// Another peer that hears what the router passes on reads nothing of it.
#[test]
fn no_message_can_be_read_on_the_way() {
    let mut line = line(Role::Judge);
    line.tape = Some(Vec::new());
    line.run(300);
    let text = b"advice to the car";
    line.peer.push(row(ADVICE.name), text[..].into());
    line.run(20);
    let came = |event: &Event| matches!(event, Event::Message(_, _, bytes) if **bytes == text[..]);
    assert!(line.events.iter().any(came));
    for bytes in line.tape.take().expect("a tape") {
        assert!(!bytes.windows(text.len()).any(|part| part == text));
    }
}

/// Every packet of a session that was taken is sent again, in it and after it: a message, an
/// acknowledgement, the hello.
#[test]
fn what_was_recorded_and_is_sent_again_changes_nothing() {
    let mut line = line(Role::Judge);
    line.tape = Some(Vec::new());
    line.run(300);
    for _ in 0..5 {
        line.peer
            .push(row(ADVICE.name), bytes_of(&Advice::default()));
        line.run(10);
    }
    let messages = |line: &Line| {
        let is_message = |event: &&Event| matches!(event, Event::Message(..));
        line.events.iter().filter(is_message).count()
    };
    assert_eq!(messages(&line), 5);
    let tape = line.tape.take().expect("a tape");
    assert!(tape.len() >= 7);
    let before = line.host.refused;
    for bytes in &tape {
        line.host.receive(bytes, (line.now, line.now), 1);
    }
    line.events.extend(line.host.take_events());
    assert_eq!(messages(&line), 5);
    let replayed = line.host.refused.of(Reason::Replayed) - before.of(Reason::Replayed);
    let hellos = tape
        .iter()
        .filter(|bytes| bytes[4] == Kind::Hello.code() as u8)
        .count();
    assert_eq!(replayed as usize, tape.len() - hellos);
    // The hellos have opened nothing: the session that lives goes on.
    line.run(300);
    assert!(line.peer.live.is_some());
    let joined = |event: &&Event| matches!(event, Event::Joined(_));
    assert_eq!(line.events.iter().filter(joined).count(), 1);
    // In a later session the old packets are of none.
    line.peer.end();
    line.run(600);
    let before = line.host.refused;
    for bytes in &tape {
        line.host.receive(bytes, (line.now, line.now), 1);
    }
    let of_none = line.host.refused.of(Reason::NoSession) - before.of(Reason::NoSession);
    assert_eq!(of_none as usize, tape.len() - hellos);
    line.events.extend(line.host.take_events());
    assert_eq!(messages(&line), 5);
}

/// Noise, packets of this protocol with other keys, and true packets with changed bits.
#[test]
fn two_thousand_hostile_frames_are_counted_and_change_nothing() {
    let seed = 21;
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut line = line(Role::Judge);
    line.tape = Some(Vec::new());
    line.run(300);
    line.peer
        .push(row(ADVICE.name), bytes_of(&Advice::default()));
    line.run(20);
    let tape = line.tape.take().expect("a tape");
    let before = line.events.len();
    let session = line.peer.live.as_ref().expect("a session").session;
    let key = ring::hmac::Key::new(ring::hmac::HMAC_SHA256, b"a guess");
    let guess = SessionKeys::of(&key, [[0; 16]; 2]);
    let frames = 2_000;
    for number in 0..frames {
        let bytes = match number % 4 {
            0 => {
                let mut noise = vec![0; random.random_range(0..4_000)];
                random.fill_bytes(&mut noise);
                noise
            }
            1 => {
                let mut body = vec![0; random.random_range(0..200)];
                random.fill_bytes(&mut body);
                let kind = Kind::ALL[random.random_range(0..Kind::ALL.len())];
                match kind.is_greeting() {
                    true => sign(kind, &body, &key),
                    false => seal(kind, (session, u64::MAX - number), &body, &guess.up),
                }
            }
            2 => {
                let mut changed = tape[random.random_range(0..tape.len())].clone();
                let place = random.random_range(0..changed.len());
                changed[place] ^= 1 << random.random_range(0..8);
                changed
            }
            _ => {
                let whole = &tape[random.random_range(0..tape.len())];
                whole[..random.random_range(0..whole.len())].to_vec()
            }
        };
        line.host.receive(&bytes, (line.now, line.now), 1);
    }
    line.events.extend(line.host.take_events());
    assert_eq!(line.events.len(), before, "seed {seed}");
    assert_eq!(line.host.refused.all(), frames, "seed {seed}");
    line.run(300);
    assert!(line.peer.live.is_some(), "the session goes on");
}

#[test]
fn a_cut_connection_is_begun_again_and_what_was_missed_arrives() {
    let mut line = line(Role::Learner);
    let mut step = Step::default();
    let push = |line: &mut Line, step: &mut Step| {
        step.header.tick += 1;
        line.host.push(row(STEP.name), bytes_of(step));
    };
    // Before the learner has come.
    (0..20).for_each(|_| push(&mut line, &mut step));
    line.run(300);
    (0..20).for_each(|_| push(&mut line, &mut step));
    line.run(20);
    line.is_cut = true;
    for _ in 0..300 {
        push(&mut line, &mut step);
        line.run(10);
    }
    assert!(line.peer.live.is_none());
    line.is_cut = false;
    let begun = line.now;
    let mut rejoined = None;
    for _ in 0..200 {
        line.run(10);
        if line.peer.live.is_some() && rejoined.is_none() {
            rejoined = Some(line.now.since_ns(begun));
        }
    }
    let rejoined = rejoined.expect("it joins again");
    assert!(rejoined < 2_000 * MS, "{rejoined} ns");
    let ticks: Vec<u64> = line
        .news
        .iter()
        .filter_map(|news| match news {
            News::Message(is, bytes) if *is == row(STEP.name) => Some(
                vlaps_link::rows::message_of::<Step>(bytes)
                    .expect("a step")
                    .header
                    .tick,
            ),
            _ => None,
        })
        .collect();
    assert_eq!(ticks, (1..=340).collect::<Vec<_>>());
}

#[test]
fn a_vehicle_that_is_started_anew_is_joined_anew() {
    let mut line = line(Role::Judge);
    line.run(300);
    line.host = Host::new(keys(), Seats::One(Role::Judge)).expect("a host");
    line.run(2_500);
    assert!(line.peer.live.is_some());
    assert_eq!(line.peer.joins, 2);
    line.peer
        .push(row(ADVICE.name), bytes_of(&Advice::default()));
    line.run(20);
    let came = |event: &&Event| matches!(event, Event::Message(..));
    assert_eq!(line.events.iter().filter(came).count(), 1);
}

/// Answers take longer than the time between two hellos.
#[test]
fn a_peer_far_away_joins() {
    let mut line = line(Role::Judge);
    line.delay_ms = 400;
    line.run(2_000);
    assert!(line.peer.live.is_some());
    line.peer
        .push(row(ADVICE.name), bytes_of(&Advice::default()));
    line.run(1_000);
    let came = |event: &&Event| matches!(event, Event::Message(..));
    assert_eq!(line.events.iter().filter(came).count(), 1);
    assert_eq!(line.peer.joins, 1);
    assert_eq!(line.host.refused.all(), 0);
}
