//! Tests that the checked-in header is generated from the messages of this source, and
//! that a C and a C++ compiler agree with its layouts.

use shm_config::layout::Layout;
use shm_config::message::{Observation, Plan, Step};
use vlaps::description::{CONSTANTS, layout, layout_with, lists};

const CHECKED_IN: &str = include_str!("../include/vlaps.h");

#[test]
fn the_header_is_the_one_of_these_messages() {
    let text = vlaps::header::text();
    let differs = text
        .lines()
        .zip(CHECKED_IN.lines())
        .find(|(ours, theirs)| ours != theirs);
    assert!(
        text == CHECKED_IN,
        "capi/include/vlaps.h is out of date, first at {differs:?}; renew it: \
         cargo run -p capi --example header > capi/include/vlaps.h"
    );
}

#[test]
fn one_code_or_constant_changes_the_hash() {
    let ours = layout_with(&lists(), &CONSTANTS);
    assert_eq!(ours, layout());
    for k in 0..lists().len() {
        let mut others = lists();
        others[k].words[0].1 += 100;
        let name = others[k].name;
        assert_ne!(layout_with(&others, &CONSTANTS), ours, "{name}");
    }
    for k in 0..CONSTANTS.len() {
        let mut others = CONSTANTS;
        others[k].1 += 1;
        assert_ne!(layout_with(&lists(), &others), ours, "{:?}", CONSTANTS[k]);
    }
}

#[test]
fn every_field_of_the_header_says_what_it_is() {
    let said = "    /* Speed along the heading, m/s. */\n    double speed_mps;\n";
    assert!(CHECKED_IN.contains(said));
    for table in vlaps::description::tables() {
        for field in table.fields {
            let lines = vlaps::description::documented(field);
            let name = format!("{}.{}", table.name, field.name);
            assert!(!lines.concat().is_empty(), "{name}");
            assert!(!lines.concat().contains("*/"), "{name}");
        }
    }
}

#[test]
fn every_field_of_a_message_is_asserted_with_its_offset() {
    for (name, table) in [
        ("vlaps_observation", Observation::TABLE),
        ("vlaps_plan", Plan::TABLE),
        ("vlaps_step", Step::TABLE),
    ] {
        for field in table.fields {
            let line = format!(
                "VLAPS_ASSERT(offsetof({name}, {}) == {},",
                field.name, field.offset
            );
            assert!(CHECKED_IN.contains(&line), "{line}");
        }
    }
}

#[test]
fn the_description_names_every_message_of_the_table_with_its_types() {
    let described = vlaps::description::json();
    let messages = described["messages"].as_array().expect("messages");
    let mut known = vec!["u8", "u32", "u64", "f32", "f64"];
    for message in messages {
        for field in message["fields"].as_array().expect("fields") {
            let kind = field["type"].as_str().expect("a type");
            let element = kind.trim_start_matches('[').split(';').next();
            let element = element.expect("an element");
            assert!(known.contains(&element), "{element} comes before its use");
        }
        known.push(message["name"].as_str().expect("a name"));
    }
    for service in described["services"].as_array().expect("services") {
        let message = service["message"].as_str().expect("a message");
        assert!(known.contains(&message), "{message}");
    }
}
