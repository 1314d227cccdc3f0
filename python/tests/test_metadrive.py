"""The package beside the real MetaDrive (c29cc37) in one process, with the same actions.

    ./vlaps setup metadrive --checkout FOLDER
    target/metadrive/bin/pip install pytest WHEEL
    target/metadrive/bin/python -m pytest python/tests/test_metadrive.py -s
"""

import importlib.util
import os
import sys
from pathlib import Path

import numpy as np
import pytest

import vlaps

ROOT = Path(os.environ.get("VLAPS_CHECKOUT", Path(__file__).resolve().parents[2]))
SEEDS = range(1000, 1020)
TOLERANCE = 1e-3
#: Features of car, road and route; the beams follow. A beam that grazes a corner moves by
#: metres when the car moves by a tenth of a millimetre, so beams are counted.
MOTION = 19


def metadrive():
    """The experiment's environment of the real simulator."""
    sys.path.insert(0, str(ROOT / "sim/metadrive"))
    from check import EXPERIMENT, SCANNER, stub_assets

    stub_assets()
    from environment import ExperimentEnv, environment_config

    return ExperimentEnv(environment_config(EXPERIMENT, SCANNER))


def events(terminated, truncated, info):
    """Cost and flags of a step, as far as they must be equal."""
    flags = ("arrive_dest", "crash_vehicle", "crash_object")
    return (bool(terminated), bool(truncated), *(bool(info[flag]) for flag in flags), float(info["cost"]))


def first(hits):
    """The first step, counted from 1, of a list of truth values."""
    return hits.index(True) + 1 if True in hits else None


@pytest.mark.skipif(importlib.util.find_spec("metadrive") is None, reason="metadrive is not installed")
@pytest.mark.parametrize("noise", [0.0, 0.1], ids=["idm", "idm with noise"])
def test_the_same_actions_give_the_same_observations_rewards_and_ends(noise):
    """Until the trajectories part, everything is equal; most episodes end alike even then."""
    theirs, ours = metadrive(), vlaps.MetaDriveEnv(start_seed=SEEDS.start, num_scenarios=len(SEEDS))
    same_ends, compared, beams_off = 0, 0, 0
    for seed in SEEDS:
        random = np.random.default_rng(seed)
        expected, _ = theirs.reset(seed=seed)
        observation, _ = ours.reset(seed=seed)
        assert np.abs(observation - expected).max() <= TOLERANCE, seed
        parted, paid, differing, touched, ended = [], [], [], [], False
        while not ended:
            action = np.clip(ours.expert("idm") + random.normal(0.0, noise, 2), -1.0, 1.0).astype(np.float32)
            expected, their_reward, *their_ends, their_info = theirs.step(action.tolist())
            observation, reward, *ends, info = ours.step(action)
            off = np.abs(observation - expected)
            mine, other = events(*ends, info), events(*their_ends, their_info)
            parted.append(bool(off[:MOTION].max() > TOLERANCE))
            paid.append(abs(reward - their_reward) > TOLERANCE)
            differing.append(mine != other)
            touched.append(mine[3] or mine[4] or other[3] or other[4])
            if not any(parted):
                compared += 1
                beams_off += int((off[MOTION:] > TOLERANCE).sum())
            ended = any(ends) or any(their_ends)
        print(
            f"seed {seed}, {len(parted)} steps, first step with contact {first(touched)}; that differs "
            f"by more than {TOLERANCE}: motion {first(parted)}, reward {first(paid)}, events {first(differing)}"
        )
        limit = first(parted) or len(parted) + 1
        assert (first(paid) or limit) >= limit and (first(differing) or limit) >= limit, seed
        same_ends += mine == other
    theirs.close()
    print(f"{compared} steps, {beams_off} of {240 * compared} beams off, {same_ends} episodes end alike")
    assert compared > 60 * len(SEEDS)
    assert beams_off < 0.002 * 240 * compared
    assert same_ends >= 0.6 * len(SEEDS)
