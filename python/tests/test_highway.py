"""The example that drives policies in highway-env sees and steers as VLAPS does."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import vlaps
from vlaps import process

pytest.importorskip("highway_env", reason="highway-env is not installed: pip install highway-env==1.12.1")

EXAMPLES = Path(os.environ.get("VLAPS_CHECKOUT", Path(__file__).parents[2])) / "examples/python"
SEED = 1000


@pytest.fixture(scope="module")
def world():
    try:
        process.Observation
    except ImportError as error:
        pytest.skip(str(error))
    sys.path[:0] = [str(EXAMPLES / "highway")]
    import world

    yield world
    sys.path.remove(str(EXAMPLES / "highway"))


@pytest.fixture(scope="module")
def lane_keeper(world, tmp_path_factory):
    path = tmp_path_factory.mktemp("policy") / "lane.onnx"
    subprocess.run([sys.executable, EXAMPLES / "policy.py", path], check=True)
    return path


@pytest.mark.parametrize("turned_rad", [0.0, 0.5])
def test_beams_run_counter_clockwise_from_straight_ahead(world, turned_rad):
    from highway_env.vehicle.kinematics import Vehicle
    from sight import BEAMS, RANGE_M, ranges_m

    driven = world.World("highway-fast-v0")
    driven.reset(SEED)
    ego, road = driven.env.vehicle, driven.env.road
    ego.heading = turned_rad
    ahead = np.array([np.cos(turned_rad), np.sin(turned_rad)])
    # y points to the right.
    left = np.array([ahead[1], -ahead[0]])
    road.vehicles = [ego] + [
        Vehicle(road, ego.position + away, turned_rad) for away in (20.0 * ahead, 10.0 * left)
    ]
    seen_m = ranges_m(road, ego)
    assert seen_m[0] == pytest.approx(20.0 - Vehicle.LENGTH / 2)
    assert seen_m[BEAMS // 4] == pytest.approx(10.0 - Vehicle.WIDTH / 2)
    assert seen_m[BEAMS // 2] == seen_m[3 * BEAMS // 4] == RANGE_M


def test_positive_steering_turns_left_and_the_pedal_changes_the_speed(world):
    driven = world.World("highway-fast-v0")
    for steer, pedal in [(0.1, 0.5), (-0.1, -0.5)]:
        driven.reset(SEED)
        ego = driven.env.vehicle
        heading_rad, speed_mps = ego.heading, ego.speed
        driven.step(driven.control(steer, pedal))
        assert np.sign(heading_rad - ego.heading) == np.sign(steer)
        assert np.sign(ego.speed - speed_mps) == np.sign(pedal)
        assert driven.action == pytest.approx((steer, pedal))
        # Feature 7 is the size of the yaw rate, rad/s.
        assert driven.features()[7] == pytest.approx(min(abs(heading_rad - ego.heading) * world.HZ, 1.0), abs=1e-5)


@pytest.mark.parametrize("name", ["highway-fast-v0", "merge-v1", "roundabout-v1", "racetrack-v1"])
def test_features_show_the_lane_of_each_environment(world, name):
    driven = world.World(name)
    driven.reset(SEED)
    features, ego = driven.features(), driven.env.vehicle
    assert features.shape == (259,) and ((features >= 0.0) & (features <= 1.0)).all()
    _, left_m = ego.lane.local_coordinates(ego.position)
    # The middle of the lane, as in docs/policies.md; left_m is to the right in highway-env.
    assert features[8] == pytest.approx(0.5 + left_m / 4.5, abs=0.05)


def test_a_policy_file_keeps_to_the_racetrack(world, lane_keeper):
    driven, policy = world.World("racetrack-v1"), vlaps.Policy(lane_keeper)
    driven.env.configure({"other_vehicles": 0})
    driven.reset(SEED)
    ended = ""
    while not ended:
        _, ended = driven.step(driven.control(*map(float, policy(driven.features()))))
    assert ended == "arrived"
    assert driven.env.vehicle.speed == pytest.approx(5.0, abs=1.0)


def test_the_table_has_a_row_for_each_driver(lane_keeper):
    given = ["--environment", "merge-v1", "--episodes", "1", lane_keeper]
    command = [sys.executable, EXAMPLES / "highway/evaluate.py", *given]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    assert [line.split()[1] for line in text.splitlines()[1:]] == ["idm", "straight", "random", "lane"]
