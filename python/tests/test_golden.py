"""Rewards and costs beside those that MetaDrive (c29cc37) recorded."""

import os
from pathlib import Path

import numpy as np
import pytest

import vlaps

ROOT = Path(os.environ.get("VLAPS_CHECKOUT", Path(__file__).resolve().parents[2]))
ROLLOUTS = ROOT.parent / "shared" / "data" / "rollouts"
FILES = sorted(ROLLOUTS.glob("*/seed*.npz"))
#: Open-loop actions do not correct the simulators' rounding, so their trajectories part
#: slowly, and after a contact at once.
TOLERANCE = 1e-3


def starts():
    """Each recorded rollout with an environment at its start."""
    env = vlaps.MetaDriveEnv(start_seed=100, num_scenarios=50)
    for file in FILES:
        recorded = np.load(file)
        observation, _ = env.reset(seed=int(file.stem.removeprefix("seed")))
        assert np.abs(observation - recorded["obs"][0]).max() <= TOLERANCE, file
        yield file, recorded, env


@pytest.mark.skipif(not FILES, reason=f"no recorded rollouts at {ROLLOUTS}")
def test_reward_and_cost_of_a_step_are_those_of_metadrive():
    """While the observations agree to 1e-3, so do reward, cost and flags."""
    compared = 0
    for file, recorded, env in starts():
        for step, action in enumerate(recorded["act"]):
            observation, reward, terminated, truncated, info = env.step(action)
            if np.abs(observation - recorded["obs"][step + 1]).max() > TOLERANCE:
                break
            compared += 1
            where = f"{file.name} of {file.parent.name}, step {step}"
            expected_reward, expected_cost = recorded["rew_cost"][step]
            assert abs(reward - expected_reward) <= TOLERANCE, where
            assert abs(info["cost"] - expected_cost) <= TOLERANCE, where
            vehicle, obstacle, _, _, arrived, _ = recorded["flags"][step].astype(bool)
            flags = [info[name] for name in ("crash_vehicle", "crash_object", "arrive_dest")]
            assert flags == [vehicle, obstacle, arrived], where
            if terminated or truncated:
                break
    assert compared > 70 * len(FILES)


@pytest.mark.skipif(not FILES, reason=f"no recorded rollouts at {ROLLOUTS}")
def test_returns_and_ends_are_those_of_metadrive():
    """Of the episodes without contact most end at the same step with the same reward."""
    same, different = 0, []
    for file, recorded, env in starts():
        if recorded["flags"][:, :2].any():
            continue
        total = 0.0
        for step, action in enumerate(recorded["act"]):
            _, reward, terminated, truncated, _ = env.step(action)
            total += reward
            if terminated or truncated:
                break
        rewards = recorded["rew_cost"][:, 0]
        if step + 1 == len(rewards) and abs(reward - rewards[-1]) < 0.01:
            assert abs(total / rewards.sum() - 1.0) < 0.003, file
            same += 1
        else:
            different.append(f"{file.parent.name}/{file.name}")
    assert same >= 0.8 * (same + len(different)) > 40, different
