"""Each example trains for a while, and leaves its curve and a policy that drives."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

import vlaps

EXAMPLES = Path(os.environ.get("VLAPS_CHECKOUT", Path(__file__).parents[2])) / "python/examples"
#: Lines of the longest example.
LINES_MAX = 150

SCRIPTS = [
    ("hg_dagger", ["--steps", "800", "--every", "400", "--expert", "idm"], ["torch"]),
    ("pvp", ["--steps", "800", "--every", "400", "--expert", "idm"], ["torch"]),
    ("ppl", ["--steps", "800", "--every", "400", "--expert", "idm"], ["torch"]),
    ("safe_rl", ["--steps", "20000"], ["torch"]),
    ("ppo", ["--steps", "20000"], ["torch"]),
    ("sb3_ppo", ["--steps", "20000"], ["torch", "stable_baselines3"]),
    ("skrl_ppo", ["--steps", "20000"], ["torch", "skrl", "tensorboard"]),
    ("torchrl_ppo", ["--steps", "20000"], ["torch", "torchrl"]),
]


def run(name, arguments, folder):
    command = [sys.executable, "-W", "ignore", str(EXAMPLES / f"{name}.py"), *arguments]
    output = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert output.returncode == 0, output.stdout + output.stderr
    return output.stdout


@pytest.mark.parametrize(("name", "arguments", "needed"), SCRIPTS, ids=[one[0] for one in SCRIPTS])
def test_an_example_trains_and_draws_its_curve(tmp_path, name, arguments, needed):
    for package in needed:
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed")
    text = run(name, [*arguments, "--out", name], tmp_path)
    last = [line for line in text.splitlines() if line.startswith("step ")][-1]
    # PPO steps in whole batches.
    assert int(last.split()[1].rstrip(":")) >= 0.9 * int(arguments[1]), text
    assert "completion" in last
    picture = (tmp_path / f"{name}.svg").read_text()
    assert picture.startswith("<svg") and "completion" in picture
    assert vlaps.Policy(tmp_path / f"{name}.onnx").runtime == "native"


def test_the_example_without_a_library_trains(tmp_path):
    assert "generation 1" in run("train", ["--generations", "2", "--horizon", "20"], tmp_path)


def test_no_example_is_long():
    lengths = {path.name: len(path.read_text().splitlines()) for path in EXAMPLES.glob("*.py")}
    assert len(lengths) >= len(SCRIPTS) and max(lengths.values()) < LINES_MAX, lengths
