//! Tests that the checked-in page and picture are generated from the service table.

use shm_config::services;

fn assert_same(file: &str, checked_in: &str, printed: &str) {
    let differs = printed
        .lines()
        .zip(checked_in.lines())
        .find(|(ours, theirs)| ours != theirs);
    assert!(
        printed == checked_in,
        "docs/{file} is out of date, first at {differs:?}; renew it: \
         cargo run -p shm-config --example service_table"
    );
}

#[test]
fn the_page_is_that_of_the_table() {
    let checked_in = include_str!("../../docs/services.md");
    assert_same("services.md", checked_in, &services::markdown());
}

#[test]
fn the_picture_is_that_of_the_table() {
    let checked_in = include_str!("../../docs/data-flow.svg");
    assert_same("data-flow.svg", checked_in, &services::picture());
}
