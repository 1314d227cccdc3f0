//! Compilers and interpreters of the tests: programs on libvlaps.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use vlaps_tests::{programs, skip_unless};

pub fn checkout() -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    root.canonicalize().expect("the checkout")
}

/// The folder of libvlaps, which is built as a dependency of this test.
pub fn libraries() -> PathBuf {
    programs().join("deps")
}

pub fn has_compiler() -> bool {
    let mut word = ["c++", "--version"];
    !["c++", "cc"].into_iter().any(|compiler| {
        word[0] = compiler;
        skip_unless(
            &word,
            &format!("programs on libvlaps: no compiler {compiler}"),
        )
    })
}

pub fn has_python() -> bool {
    let probe = [
        "python3",
        "-c",
        "import sys, ctypes; assert sys.version_info >= (3, 10)",
    ];
    !skip_unless(&probe, "programs on vlaps.process: no Python 3.10 or newer")
}

/// Compiles a source into a program of this name, with the headers of `include` first.
pub fn compile(folder: &Path, source: &Path, include: &[PathBuf]) -> PathBuf {
    let is_c = source.extension().is_some_and(|extension| extension == "c");
    let program = folder.join(source.file_stem().expect("a name"));
    let libraries = libraries();
    let mut command = match is_c {
        true => Command::new("cc"),
        false => Command::new("c++"),
    };
    command.arg(if is_c { "-std=gnu11" } else { "-std=c++17" });
    command.args(["-O1", "-Wall", "-Wextra", "-Werror"]);
    for include in include {
        command.arg("-I").arg(include);
    }
    command.arg("-I").arg(checkout().join("capi/include"));
    command.arg(source).arg("-o").arg(&program);
    command.arg("-L").arg(&libraries);
    command.args(["-lvlaps", "-lm", "-pthread"]);
    // The older tag precedes the folders of cargo, where an older libvlaps may be.
    let place = format!("-Wl,--disable-new-dtags,-rpath,{}", libraries.display());
    command.arg(place);
    let output = command.output().expect("the compiler starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{}: {said}", source.display());
    program
}

pub fn example_in_cpp(folder: &Path, name: &str) -> PathBuf {
    compile(
        folder,
        &checkout().join(format!("examples/cpp/{name}.cpp")),
        &[],
    )
}

pub fn example_in_python(folder: &Path, name: &str) -> PathBuf {
    in_python(
        folder,
        &checkout().join(format!("examples/python/{name}.py")),
    )
}

/// A program that runs a source in Python with the module alone: the package's compiled
/// part is built on request.
pub fn in_python(folder: &Path, source: &Path) -> PathBuf {
    let root = checkout();
    let text = format!(
        "#!/usr/bin/env python3\n\
         import os, runpy, sys, types\n\
         os.environ['VLAPS_LIBRARY'] = {library:?}\n\
         sys.dont_write_bytecode = True\n\
         package = types.ModuleType('vlaps')\n\
         package.__path__ = [{package:?}]\n\
         sys.modules['vlaps'] = package\n\
         runpy.run_path({source:?}, run_name='__main__')\n",
        library = libraries().join("libvlaps.so"),
        package = root.join("python/vlaps"),
    );
    let name = source.file_stem().expect("a name").to_string_lossy();
    let program = folder.join(format!("{name}-in-python"));
    fs::write(&program, text).expect("a program");
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).expect("executable");
    program
}
