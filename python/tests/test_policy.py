"""Policy files: read, run, refused and written."""

import os
import pickle
import subprocess
from pathlib import Path

import numpy as np
import pytest

import vlaps

RANDOM = np.random.default_rng(7)
OBSERVATIONS = RANDOM.random((50, 259), np.float32)


def layers(*widths, last="tanh"):
    """A net of random weights."""
    sizes = list(zip((259, *widths), (*widths, 2)))
    return [
        (RANDOM.normal(0, 0.2, (to, of)), RANDOM.normal(0, 0.1, to), last if k == len(widths) else "relu")
        for k, (of, to) in enumerate(sizes)
    ]


def answers(net, rows):
    """The net in double precision."""
    for weights, bias, activation in net:
        rows = rows @ np.asarray(weights).T + bias
        rows = {"relu": lambda x: np.maximum(x, 0), "tanh": np.tanh, None: lambda x: x}[activation](rows)
    return np.clip(rows, -1, 1)


def test_a_written_policy_answers_as_its_layers(tmp_path):
    for net in (layers(64, 32), layers(), layers(16, last=None)):
        written = vlaps.export(net, tmp_path / "p.onnx", algorithm="bc", seed=3, steps=40, commit="abc")
        policy = vlaps.Policy(tmp_path / "p.onnx")
        assert (policy.sha256, policy.runtime, policy.probes) == (written.sha256, "native", 16)
        assert policy.origin == {"algorithm": "bc", "seed": 3, "steps": 40, "commit": "abc"}
        actions = policy(OBSERVATIONS)
        assert actions.shape == (50, 2) and actions.dtype == np.float32
        assert np.abs(actions - answers(net, OBSERVATIONS)).max() < 1e-5
        assert (policy(OBSERVATIONS[3]) == actions[3]).all()
        assert (pickle.loads(pickle.dumps(policy))(OBSERVATIONS) == actions).all()


def test_a_normalisation_goes_into_the_first_layer(tmp_path):
    net = layers(32)
    mean, std = RANDOM.random(259), RANDOM.uniform(0.5, 2.0, 259)
    policy = vlaps.export(net, tmp_path / "p.onnx", mean=mean, std=std)
    assert np.abs(policy(OBSERVATIONS) - answers(net, (OBSERVATIONS - mean) / std)).max() < 1e-5
    with pytest.raises(ValueError, match="std positive"):
        vlaps.export(net, tmp_path / "p.onnx", std=np.zeros(259))


def test_files_that_are_refused(tmp_path):
    path = tmp_path / "p.onnx"
    whole = vlaps.export(layers(8), path).bytes
    assert vlaps.Policy.refusal(path) is None
    for wrong, reason in [
        (b"", "empty"),
        (whole[: len(whole) // 2], "truncated|graph"),
        (b"no file of onnx", "ONNX|truncated"),
        (whole.replace(b"Tanh", b"Sinh"), "operator|graph"),
        (bytes(9_000_000), "over the limit"),
    ]:
        with pytest.raises(ValueError, match=reason):
            vlaps.Policy(wrong)
        assert "refused" in vlaps.Policy.refusal(wrong)
    with pytest.raises(FileNotFoundError):
        vlaps.Policy(tmp_path / "none.onnx")


def test_policies_that_cannot_be_written(tmp_path):
    path = tmp_path / "p.onnx"
    broken = layers(8)
    broken[0][0][2, 5] = np.nan
    for wrong, message in [
        (broken, "finite"),
        (layers(8)[1:], "input"),
        (layers(8)[:1], "output"),
        ([], "layers"),
        ([(np.zeros(259), np.zeros(1), None)], "outputs, inputs"),
    ]:
        with pytest.raises(ValueError, match=message):
            vlaps.export(wrong, path)
    with pytest.raises(TypeError, match="sigmoid.*relu"):
        vlaps.export([(np.zeros((2, 259)), np.zeros(2), "sigmoid")], path)
    with pytest.raises(TypeError, match="torch module"):
        vlaps.export(3, path)
    with pytest.raises(ValueError, match=".onnx"):
        vlaps.export(layers(8), tmp_path / "p.pt")
    assert not path.exists()


def test_observations_that_are_wrong(tmp_path):
    policy = vlaps.export(layers(8), tmp_path / "p.onnx")
    for wrong, message in [
        (np.zeros(43), "259"),
        (np.zeros((2, 2, 259)), "shape"),
        (np.full(259, np.nan), "finite"),
    ]:
        with pytest.raises(ValueError, match=message):
            policy(wrong)
    assert policy(np.zeros((0, 259))).shape == (0, 2)


def test_vlaps_eval_adopts_a_written_policy(tmp_path):
    checkout, programs = os.environ.get("VLAPS_CHECKOUT"), os.environ.get("VLAPS_PROGRAMS")
    if not (checkout and programs and (Path(programs) / "vlaps-lab").exists()):
        pytest.skip("VLAPS_PROGRAMS names no folder with the built programs")
    path = tmp_path / "p.onnx"
    vlaps.export(layers(32), path)
    command = [str(Path(programs) / "vlaps-lab"), "eval", "--driver", str(path), "--episodes", "2"]
    output = subprocess.run(command, capture_output=True, text=True, cwd=checkout, timeout=120)
    assert output.returncode == 0, output.stderr
    table = str(vlaps.evaluate(path, range(1000, 1002), quiet=True))
    told = [line.rstrip() for line in output.stdout.splitlines() if line.startswith("  ")]
    assert told and all(line in table for line in told[1:]), f"{output.stdout}\n{table}"
