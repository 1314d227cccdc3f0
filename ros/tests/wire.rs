//! What is published, as a program without any of this code sees it.

mod stage;

use std::time::Duration;

use recorder::Channel;
use recorder::schema::ENCAPSULATION;
use shm_config::layout::Layout as _;
use shm_config::message::Step;
use vlaps_ros::names::{ATTACHMENT_BYTES, TopicType};
use vlaps_ros::publisher::RosPublisher;
use vlaps_ros::session::Link;
use zenoh::Wait;

use stage::{LOST, free_router, hear, router, settings, until};

fn step_cdr(tick: u64) -> Vec<u8> {
    let mut step = Step::default();
    step.header.tick = tick;
    step.observation.ego.speed_mps = 3.5;
    [&ENCAPSULATION[..], step.as_bytes()].concat()
}

fn step_type() -> TopicType {
    TopicType::of(&Channel::named("step").expect("a channel")).expect("a type")
}

#[test]
fn a_message_arrives_byte_by_byte_with_its_number_time_and_sender() {
    let address = free_router();
    let router = router(&address);
    let of = step_type();
    let heard = hear(
        &router,
        &format!("0/vlaps/step/{}/{}", of.dds_name(), of.hash),
    );
    let mut link = Link::open(&settings(&address), "vlaps").expect("a session");
    let mut publisher = RosPublisher::declare(&mut link, "/vlaps/step", &of).expect("a topic");
    until("the subscription is seen", || publisher.is_wanted());
    for sequence in 1..=3_u64 {
        let cdr = step_cdr(40 + sequence);
        assert!(publisher.put(7_000 + sequence, &cdr));
        let sample = heard.recv_timeout(LOST).expect("the message");
        assert_eq!(*sample.payload().to_bytes(), cdr);
        let attachment = sample.attachment().expect("an attachment").to_bytes();
        assert_eq!(attachment.len(), ATTACHMENT_BYTES);
        assert_eq!(attachment[..8], sequence.to_le_bytes());
        assert_eq!(attachment[8..16], (7_000 + sequence).to_le_bytes());
        assert_eq!(attachment[16], 16);
    }
    // As `ros2 node list` and `ros2 topic list` find them.
    let mut tokens = stage::tokens(&router);
    tokens.sort_unstable();
    assert_eq!(tokens.len(), 2, "{tokens:?}");
    assert!(tokens[0].ends_with("/0/0/NN/%/%/vlaps"), "{tokens:?}");
    assert!(
        tokens[1].contains("/MP/%/%/vlaps/%vlaps%step/"),
        "{tokens:?}"
    );
}

#[test]
fn a_router_that_dies_and_returns_gets_what_is_published_then() {
    let address = free_router();
    let first = router(&address);
    let mut link = Link::open(&settings(&address), "vlaps").expect("a session");
    let of = step_type();
    let mut publisher = RosPublisher::declare(&mut link, "/vlaps/step", &of).expect("a topic");
    assert!(link.is_connected());
    first.close().wait().expect("it ends");
    until("the end is seen", || !link.is_connected());
    // Nothing waits for a router.
    assert!(!publisher.is_wanted());
    publisher.put(1, &step_cdr(1));
    let mut second = None;
    until("the port is free", || {
        second = stage::try_router(&address);
        second.is_some()
    });
    let second = second.expect("a router");
    let heard = hear(&second, "0/vlaps/step/*/*");
    until("the new router is seen", || {
        link.is_connected() && publisher.is_wanted()
    });
    publisher.put(2, &step_cdr(2));
    let sample = heard.recv_timeout(LOST).expect("the message");
    assert_eq!(*sample.payload().to_bytes(), step_cdr(2));
    let nothing = heard.recv_timeout(Duration::from_millis(100));
    assert!(nothing.is_err(), "the message of before is not repeated");
}

#[test]
fn no_router_is_an_error_of_one_line() {
    let error = Link::open(&settings(&free_router()), "vlaps").err();
    let error = error.expect("no router answers");
    assert_eq!(error.lines().count(), 1, "{error}");
}
