"""`vlaps.process` needs its library only when it is used."""

import os
import subprocess
import sys


def run(code: str, library: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "VLAPS_LIBRARY": library}
    command = [sys.executable, "-c", code]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_the_module_is_imported_without_the_library() -> None:
    assert run("from vlaps import process; process.Reader", "/no/such/library.so").returncode == 0


def test_a_missing_library_is_named_with_the_remedy() -> None:
    ended = run("from vlaps import process; process.Observation", "/no/such/library.so")
    assert ended.returncode == 1
    assert "/no/such/library.so" in ended.stderr
    assert "cargo build --release -p capi" in ended.stderr
