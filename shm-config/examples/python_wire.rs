//! Prints the wire as a Python module, for the world process of MetaDrive.

fn main() {
    print!("{}", shm_config::python::module());
}
