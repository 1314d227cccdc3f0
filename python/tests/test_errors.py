"""Exceptions that say what to do; after each the environment still works."""

import numpy as np
import pytest

import vlaps


@pytest.fixture
def env():
    env = vlaps.MetaDriveEnv(num_scenarios=3)
    env.reset()
    yield env
    env.step([0.0, 0.5])


@pytest.fixture
def vector():
    vector = vlaps.MetaDriveVectorEnv(3, num_scenarios=3)
    vector.reset()
    yield vector
    vector.step(np.zeros((3, 2), np.float32))


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf")])
def test_actions_that_are_no_numbers(env, vector, bad):
    with pytest.raises(ValueError, match="finite"):
        env.step([0.0, bad])
    actions = np.zeros((3, 2), np.float32)
    actions[1, 0] = bad
    with pytest.raises(ValueError, match="action 1.*finite"):
        vector.step(actions)


@pytest.mark.parametrize("shape", [(3,), (1, 2), (0,), ()])
def test_actions_of_the_wrong_shape(env, shape):
    with pytest.raises(ValueError, match="shape"):
        env.step(np.zeros(shape, np.float32))


@pytest.mark.parametrize("shape", [(2, 2), (3, 3), (3,), (3, 2, 1)])
def test_batches_of_the_wrong_shape(vector, shape):
    with pytest.raises((ValueError, TypeError), match="shape|dimensions"):
        vector.step(np.zeros(shape, np.float32))


def test_actions_of_the_wrong_type(env):
    with pytest.raises((ValueError, TypeError)):
        env.step(["left", "fast"])


def test_environments_that_are_closed():
    env = vlaps.MetaDriveEnv()
    env.reset()
    env.close()
    env.close()
    for call in (env.reset, env.get_state, lambda: env.step([0, 0])):
        with pytest.raises(RuntimeError, match="closed"):
            call()
    vector = vlaps.MetaDriveVectorEnv(2)
    vector.close()
    with pytest.raises(RuntimeError, match="closed"):
        vector.reset()


def test_a_step_before_the_first_reset():
    with pytest.raises(RuntimeError, match="reset"):
        vlaps.MetaDriveEnv().step([0, 0])
    with pytest.raises(RuntimeError, match="reset"):
        vlaps.MetaDriveVectorEnv(2).step(np.zeros((2, 2), np.float32))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"trafic_density": 0.1}, "did you mean 'traffic_density'"),
        ({"vehicle_config": {"lidar": {"lasers": 2}}}, "num_lasers"),
        ({"vehicle_config": 3}, "dictionary"),
        ({"num_scenarios": 0}, "num_scenarios"),
        ({"start_seed": -1}, "seed"),
        ({"horizon": 0}, "horizon"),
        ({"map": "SZ"}, "Z"),
        ({"map_config": {"lane_num": 99}}, "lane"),
        ({"traffic_density": -1.0}, "density"),
        ({"accident_prob": 2.0}, "accident"),
        ({"vehicle_config": {"lidar": {"num_lasers": 10_000}}}, "beam_count"),
        ({"vehicle_config": {"lidar": {"distance": -5.0}}}, "lidar_range_m"),
        ({"vehicle_config": {"lidar": {"dropout_prob": 1.5}}}, "dropout_prob"),
        ({"vehicle_config": {"lidar": {"gaussian_noise": float("nan")}}}, "gaussian_noise"),
        ({"driving_reward": float("nan")}, "driving_reward"),
        ({"driving_reward": "much"}, "driving_reward"),
        ({"horizon": "long"}, "horizon"),
        ({"render_mode": "ascii"}, "render_mode"),
    ],
)
def test_options_that_are_wrong(options, message):
    with pytest.raises((ValueError, TypeError), match=message):
        vlaps.MetaDriveEnv(**options).reset()


def test_seeds_that_are_wrong(env, vector):
    for seed in (-1, 2**63):
        with pytest.raises(Exception, match="seed|Seed"):
            env.reset(seed=seed)
    with pytest.raises(ValueError, match="2 seeds for 3"):
        vector.reset(seed=[1, 2])
    with pytest.raises(ValueError, match="reset_mask"):
        vector.reset(options={"reset_mask": np.ones(2, bool)})
    with pytest.raises(ValueError, match="reset_mask"):
        vector.reset(options={"reset_mask": [1, 0, 1]})


def test_sizes_that_are_wrong(vector):
    for count in (0, -3):
        with pytest.raises(ValueError, match="num_envs"):
            vlaps.MetaDriveVectorEnv(count)
    with pytest.raises(ValueError, match="threads"):
        vlaps.MetaDriveVectorEnv(2, threads=0)
    with pytest.raises(ValueError):
        vlaps.MetaDriveVectorEnv(2, autoreset_mode="sometimes")
    with pytest.raises(IndexError, match="there are 3"):
        vector.get_state(3)
