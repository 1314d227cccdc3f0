"""States of an environment."""

import copy
import json
import pickle

import numpy as np
import pytest

import vlaps
from drive import SHORT, actions, rollout


@pytest.mark.parametrize("stored", [False, True])
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_a_state_is_gone_back_to_bit_by_bit(stored, noise):
    options = {"num_scenarios": 5, "vehicle_config": {"lidar": {"gaussian_noise": noise}}}
    env = vlaps.MetaDriveEnv(**options)
    env.reset(seed=3)
    driven = actions(1, 120)[:, 0]
    before = rollout(env, driven[:30])
    assert len(before) == 30
    state = env.get_state()
    after = rollout(env, driven[30:])
    if stored:
        state = bytes(state)
    observation = env.set_state(state)
    assert observation.tobytes() == before[-1][0]
    assert rollout(env, driven[30:]) == after
    other = vlaps.MetaDriveEnv(**options)
    other.set_state(state)
    assert rollout(other, driven[30:]) == after


def test_a_state_is_pickled_as_its_bytes():
    env = vlaps.MetaDriveEnv()
    env.reset(seed=3)
    env.step([0.1, 0.5])
    state = env.get_state()
    assert copy.deepcopy(state) is state and copy.copy(state) is state
    stored = pickle.loads(pickle.dumps(state))
    after = env.step([0.0, 0.5])[0]
    env.set_state(stored)
    assert (env.step([0.0, 0.5])[0] == after).all()


def test_the_end_of_an_episode_is_a_state_too():
    env = vlaps.MetaDriveEnv(**SHORT)
    env.reset(seed=1)
    rollout(env, actions(1, 50)[:, 0])
    for state in (env.get_state(), bytes(env.get_state())):
        other = vlaps.MetaDriveEnv(**SHORT)
        other.set_state(state)
        with pytest.raises(RuntimeError, match="call reset first"):
            other.step([0.0, 0.0])


def test_one_world_of_a_vector_is_set_and_the_others_stay():
    env = vlaps.MetaDriveVectorEnv(3, num_scenarios=9)
    driven = actions(3, 20)
    env.reset()
    for action in driven[:10]:
        env.step(action)
    state = env.get_state(1)
    after = [env.step(action)[0].copy() for action in driven[10:]]
    env.set_state(1, bytes(state))
    again = [env.step(action)[0].copy() for action in driven[10:]]
    assert all((a[1] == b[1]).all() for a, b in zip(after, again))
    assert not (after[-1][0] == again[-1][0]).all()


def test_the_order_of_seeds_goes_on_from_a_state():
    env = vlaps.MetaDriveEnv(num_scenarios=9)
    for _ in range(4):
        env.reset()
    state = bytes(env.get_state())
    other = vlaps.MetaDriveEnv(num_scenarios=9)
    other.set_state(state)
    assert env.reset()[1]["seed"] == other.reset()[1]["seed"] == 4


def test_states_of_other_versions_options_and_kinds_are_refused():
    env = vlaps.MetaDriveEnv()
    env.reset(seed=0)
    held = json.loads(bytes(env.get_state()))
    with pytest.raises(ValueError, match="version 999"):
        env.set_state(json.dumps({**held, "version": 999}).encode())
    with pytest.raises(ValueError, match="no state"):
        env.set_state(b"{}")
    with pytest.raises(ValueError, match="no state"):
        env.set_state(bytes(env.get_state())[:-9])
    with pytest.raises(TypeError, match="get_state"):
        env.set_state(7)
    other = vlaps.MetaDriveEnv(horizon=99)
    other.reset(seed=0)
    for state in (other.get_state(), bytes(other.get_state())):
        with pytest.raises(ValueError, match="other options"):
            env.set_state(state)
    assert np.isfinite(env.step([0, 0])[0]).all()
