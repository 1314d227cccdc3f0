"""Drives on from a recorded tick, with the built program."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def fork(
    recording: str | os.PathLike[str],
    tick: int,
    *,
    policy: str | os.PathLike[str] | None = None,
    driver: str | None = None,
    settings: Mapping[str, Any] | None = None,
    seconds: float | None = None,
    program: str | os.PathLike[str] | None = None,
) -> dict[str, Any]:
    """Drives on from a tick of a recording, closed loop, and returns the figures.

    Runs `./vlaps fork`, which docs/replay.md describes: without a change the result must be the
    recording, bit by bit (`figures["identical"]`). `program` is `vlaps` of a checkout or its
    built `vlaps-lab`; without it the environment variable VLAPS_PROGRAMS names the folder of the
    programs. The package itself does not hold the process set's code.

    Raises `FileNotFoundError` without the program and `RuntimeError` with its error line.
    """
    command = [str(_program(program)), "fork", os.fspath(recording), "--tick", str(tick)]
    given = {"--policy": policy, "--driver": driver, "--seconds": seconds}
    for option, value in given.items():
        if value is not None:
            command += [option, str(value)]
    for key, value in (settings or {}).items():
        command += ["--set", f"{key}={value}"]
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / "fork.json"
        done = subprocess.run([*command, "--json", str(written)], capture_output=True, text=True)
        # 1: it ran, and is not the recording.
        if done.returncode not in (0, 1) or not written.exists():
            lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
            raise RuntimeError(f"fork: {lines[-1]}")
        figures: dict[str, Any] = json.loads(written.read_text())
        return figures


def _program(given: str | os.PathLike[str] | None) -> Path:
    folder = os.environ.get("VLAPS_PROGRAMS")
    if given is None and folder:
        given = Path(folder) / "vlaps-lab"
    if given is None:
        raise FileNotFoundError(
            "fork runs the built program: name it with program=, such as ./vlaps of a checkout, or "
            "set VLAPS_PROGRAMS=target/release"
        )
    path = Path(given).absolute()
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such program; `./vlaps up` in a checkout builds it")
    return path
