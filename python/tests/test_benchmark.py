"""The benchmark measures what it says: all its ways drive the same."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import vlaps
from drive import actions
from vlaps import _vlaps
from vlaps.config import merged, to_json

ROOT = Path(os.environ.get("VLAPS_CHECKOUT", Path(__file__).resolve().parents[2]))


@pytest.mark.parametrize("threads", [0, 1, 2])
def test_the_batch_without_python_drives_the_same(threads):
    options = {"start_seed": 7, "num_scenarios": 500, "horizon": 30}
    bare = _vlaps.RustBatch(to_json(merged(options)), 5, threads)
    envs = vlaps.MetaDriveVectorEnv(5, autoreset_mode="SameStep", **options)
    seen, _ = envs.reset()
    for part in np.split(actions(5, 200), 4):
        for action in part:
            seen, *_ = envs.step(action)
        bare.drive(part)
        assert (bare.observations() == seen).all()
    with pytest.raises(ValueError, match=r"must be \(ticks, 5, 2\)"):
        bare.drive(actions(4, 1))


def test_the_benchmark_prints_each_bar(tmp_path):
    command = [sys.executable, ROOT / "python/benchmarks/speed.py", "--worlds", "4", "--rounds", "1"]
    # Another checkout has no MetaDrive, which would take half a minute.
    env = {**os.environ, "VLAPS_CHECKOUT": str(tmp_path)}
    command += ["--threads", "2", "--json", tmp_path / "speed.json"]
    output = subprocess.run(command, capture_output=True, text=True, env=env)
    assert output.returncode == 0, output.stderr
    assert "MetaDrive left out" in output.stderr
    bars = json.loads((tmp_path / "speed.json").read_text())["bars"]
    barred = {what for what, row in bars.items() if row["bar"] is not None}
    assert len(barred) >= 7, barred
    assert all(row["least"] <= row["median"] <= row["most"] for row in bars.values())
