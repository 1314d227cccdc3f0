//! Tests that the checked-in Python module is generated from these tables.

const CHECKED_IN: &str = include_str!("../../sim/metadrive/wire_layout.py");

#[test]
fn the_python_wire_is_the_one_of_this_crate() {
    let module = shm_config::python::module();
    let differs = module
        .lines()
        .zip(CHECKED_IN.lines())
        .find(|(ours, theirs)| ours != theirs);
    assert!(
        module == CHECKED_IN,
        "sim/metadrive/wire_layout.py is out of date, first at {differs:?}; renew it: \
         cargo run -p shm-config --example python_wire > sim/metadrive/wire_layout.py"
    );
}
