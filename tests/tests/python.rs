//! The tests of the Python package. Without its environment, which `./vlaps setup
//! python` creates, this test prints that and passes.

use std::path::Path;
use std::process::Command;

use vlaps_tests::programs;

#[test]
fn the_tests_of_the_python_package_pass() {
    let target = programs().parent().expect("the build's folder");
    let pytest = target.join("python/bin/pytest");
    if !pytest.is_file() {
        eprintln!(
            "skipped: {}: no such file; run ./vlaps setup python",
            pytest.display()
        );
        return;
    }
    let checkout = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let output = Command::new(&pytest)
        .args(["-q", "--no-header", "-rs", "-p", "no:cacheprovider"])
        .arg(checkout.join("python/tests"))
        .env(
            "VLAPS_CHECKOUT",
            checkout.canonicalize().expect("the checkout"),
        )
        .env("VLAPS_PROGRAMS", programs())
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .output()
        .expect("pytest starts");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}");
    assert!(text.contains(" passed"), "{text}");
    eprintln!("{text}");
}
