"""The table of `./vlaps eval` from Python, on threads, processes and nodes."""

import importlib.util
import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import vlaps
from drive import turn_and_go

CHECKOUT = os.environ.get("VLAPS_CHECKOUT", str(Path(__file__).parents[2]))
POLICY = Path(CHECKOUT) / "results/learning/ppl-50000.onnx"


def figures(evaluation):
    return {key: (one.mean, one.low, one.high) for key, one in evaluation.figures.items()}


@pytest.mark.parametrize("driver", ["idm", "lane", "mpc", "policy"])
def test_the_figures_are_those_of_vlaps_eval(tmp_path, driver):
    programs = os.environ.get("VLAPS_PROGRAMS")
    if not (programs and (Path(programs) / "vlaps-lab").exists()):
        pytest.skip("VLAPS_PROGRAMS names no folder with the built programs")
    name = str(POLICY) if driver == "policy" else driver
    count = 3 if driver == "mpc" else 12
    written = tmp_path / "figures.json"
    command = [str(Path(programs) / "vlaps-lab"), "eval", "--driver", name, "--episodes", str(count)]
    output = subprocess.run(
        [*command, "--first-seed", "1003", "--json", str(written)],
        capture_output=True,
        text=True,
        cwd=CHECKOUT,
    )
    assert output.returncode == 0, output.stderr
    expected = json.loads(written.read_text())
    evaluation = vlaps.evaluate(name, range(1003, 1003 + count), threads=2)
    for key, found in figures(evaluation).items():
        one = expected[key]
        told = (one["mean"], one["low"], one["high"]) if isinstance(one, dict) else (one, *expected[f"{key}_interval"])
        assert found == told, key
    table = str(evaluation)
    lines = [line.rstrip() for line in output.stdout.splitlines() if line.startswith("  ")]
    if driver == "mpc":
        assert evaluation.planning_p99_us > 0
        # The wall clock differs.
        lines = [line for line in lines if "planning" not in line]
    assert len(lines) >= 11 and all(line in table for line in lines), output.stdout


def test_known_figures():
    """Recorded once from `./vlaps eval --driver idm --first-seed 100 --episodes 50`."""
    evaluation = vlaps.evaluate("idm", range(100, 150), quiet=True)
    assert evaluation["success"].mean == 0.92
    assert evaluation["completion"].mean == pytest.approx(0.9576665961950499, abs=1e-12)


def test_a_policy_is_evaluated_alike_as_file_object_and_function():
    policy = vlaps.Policy(POLICY)
    seeds = [1003, 5, 1007, 2000]
    found = [
        vlaps.evaluate(one, seeds, quiet=True).episodes
        for one in (POLICY, str(POLICY), policy, policy.__call__)
    ]
    assert found[0] == found[1] == found[2] == found[3]
    assert [one.seed for one in found[0]] == sorted(seeds)


def test_no_figure_depends_on_threads_or_processes(monkeypatch):
    monkeypatch.setattr("vlaps.evaluation.CHUNK", 8)
    one = vlaps.evaluate(turn_and_go, range(20), quiet=True, threads=1, horizon=200)
    assert 0.0 < one["completion"].mean < 1.0
    for number in ({"threads": 3}, {"processes": 2}):
        other = vlaps.evaluate(turn_and_go, range(20), quiet=True, horizon=200, **number)
        assert other.episodes == one.episodes and figures(other) == figures(one)
    named = [vlaps.evaluate("idm", range(20), quiet=True, processes=count).episodes for count in (1, 2)]
    assert named[0] == named[1]


def test_evaluations_that_are_asked_wrongly():
    for arguments, error, message in [
        (("none",), ValueError, "idm"),
        (("idm", []), ValueError, "no seeds"),
        (("idm", [-1]), ValueError, "seed = -1"),
        (("idm", [1.9]), TypeError, "seed = 1.9"),
        (("idm", 3), TypeError, "seeds = 3"),
        ((lambda seen: None,), TypeError, "returned None"),
        ((3,), TypeError, "cannot drive"),
        ((lambda seen: np.zeros((1, 2)),), ValueError, "shape"),
        ((lambda seen: np.full((len(seen), 2), np.nan),), ValueError, "finite"),
    ]:
        with pytest.raises(error, match=message):
            vlaps.evaluate(*arguments)
    for options, message in [
        ({"threads": 0}, "threads"),
        ({"processes": 0}, "processes"),
        ({"start_seed": 3}, "start_seed.*leave it out"),
        ({"num_scenarios": 3}, "num_scenarios.*leave it out"),
        ({"expert_config": {"mpc": {"speed": 1}}}, "speed"),
        ({"horizont": 3}, "horizon"),
        ({"vehicle_config": {"lidar": {"dropout_prob": 0.5}}}, "noise"),
    ]:
        with pytest.raises(ValueError, match=message):
            vlaps.evaluate("mpc", [3], **options)
    with pytest.raises(TypeError, match="processes = 'x'"):
        vlaps.evaluate("mpc", [3], processes="x")
    few = {"lidar": {"num_lasers": 60}}
    policy = vlaps.Policy(POLICY)
    with pytest.raises(ValueError, match="num_lasers = 60.*240"):
        vlaps.evaluate(policy, [3], vehicle_config=few)
    evaluation = vlaps.evaluate("idm", [3], quiet=True)
    assert "success" in evaluation.keys() and "1 episodes" in repr(evaluation)
    with pytest.raises(KeyError, match="there are success"):
        evaluation["sucess"]


@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="ray is not installed")
def test_two_nodes_of_ray_find_the_same(monkeypatch):
    import ray
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    try:
        cluster.add_node(num_cpus=1)
        ray.init(address=cluster.address, logging_level="ERROR")
        assert len(ray.nodes()) == 2
        monkeypatch.setattr("vlaps.evaluation.CHUNK", 4)
        for driver in ("idm", POLICY):
            alone = vlaps.evaluate(driver, range(1000, 1012), quiet=True)
            spread = vlaps.evaluate(driver, range(1000, 1012), quiet=True, ray=True, threads=1)
            assert spread.episodes == alone.episodes and figures(spread) == figures(alone)
    finally:
        ray.shutdown()
        cluster.shutdown()
