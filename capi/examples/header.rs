//! Prints the C header.

fn main() {
    print!("{}", vlaps::header::text());
}
