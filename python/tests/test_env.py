"""One environment."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import vlaps
from drive import SHORT, actions, rollout


@pytest.mark.parametrize("render_mode", [None, "rgb_array"])
def test_gymnasium_checks_the_environment(render_mode):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(vlaps.ENV_ID, num_scenarios=5, render_mode=render_mode)
        check_env(env.unwrapped, skip_render_check=render_mode is None)


def test_the_same_seed_is_the_same_episode():
    driven = actions(1, 300)[:, 0]
    env = vlaps.MetaDriveEnv()
    env.reset(seed=42)
    first = rollout(env, driven)
    env.reset(seed=43)
    other = rollout(env, driven)
    env.reset(seed=42)
    assert rollout(env, driven) == first
    assert other != first


def test_a_reset_without_seed_begins_the_next_episode():
    env = vlaps.MetaDriveEnv(start_seed=7, num_scenarios=3)
    assert [env.reset()[1]["seed"] for _ in range(5)] == [7, 8, 9, 7, 8]
    assert env.reset(seed=1000)[1]["seed"] == 1000
    assert [env.reset()[1]["seed"] for _ in range(2)] == [7, 8]


def test_an_episode_ends_at_its_horizon():
    env = vlaps.MetaDriveEnv(horizon=4)
    env.reset(seed=1)
    ends = [env.step([0.0, 0.0])[2:4] for _ in range(4)]
    assert ends == [(False, False)] * 3 + [(False, True)]
    with pytest.raises(RuntimeError, match="call reset first"):
        env.step([0.0, 0.0])


def test_info_has_the_figures_of_the_step():
    env = vlaps.MetaDriveEnv()
    _, info = env.reset(seed=3)
    assert (info["episode_length"], info["cost"], info["seed"]) == (0, 0.0, 3)
    for _ in range(20):
        _, reward, _, _, info = env.step([0.0, 1.0])
    assert info["episode_length"] == 20 and isinstance(info["episode_length"], int)
    assert info["velocity"] > 5.0
    assert reward == info["step_reward"] > 0.0
    assert info["arrive_dest"] is False
    assert 0.0 < info["route_completion"] < 1.0


def test_noise_and_dropout_change_the_beams_alone_and_repeat():
    lidar = {"gaussian_noise": 0.1, "dropout_prob": 0.2}
    noisy = vlaps.MetaDriveEnv(vehicle_config={"lidar": lidar})
    plain = vlaps.MetaDriveEnv()
    (seen, _), (true, _) = noisy.reset(seed=9), plain.reset(seed=9)
    assert (seen[:19] == true[:19]).all()
    assert 20 < (seen[19:] == 0.0).sum() < 80
    free = (true[19:] == 1.0) & (seen[19:] > 0.0)
    assert 0.3 < (seen[19:][free] < 1.0).mean() < 0.7
    assert 0.03 < np.abs(seen[19:] - true[19:])[seen[19:] > 0.0].mean() < 0.12
    assert noisy.observation_space.contains(seen)
    assert (noisy.reset(seed=9)[0] == seen).all()
    assert (noisy.step([0, 0])[0][19:] != seen[19:]).any()


def test_options_change_the_world():
    long = vlaps.MetaDriveEnv(map="SSSSSS", traffic_density=0.0, accident_prob=0.0)
    observation, _ = long.reset(seed=1)
    assert (observation[19:] == 1.0).all()
    few = vlaps.MetaDriveEnv(**SHORT)
    assert few.observation_space.shape == (43,)
    contact = vlaps.MetaDriveEnv(driving_reward=0.0, speed_reward=0.0)
    contact.reset(seed=1)
    assert contact.step([0.0, 1.0])[1] == 0.0


def test_a_car_that_drives_straight_on_leaves_the_road():
    env = vlaps.MetaDriveEnv(map="C", out_of_road_penalty=7.0, out_of_road_cost=3.0)
    env.reset(seed=5)
    terminated = False
    while not terminated:
        _, reward, terminated, truncated, info = env.step([0.0, 1.0])
        assert not truncated
    assert info["out_of_road"] and (reward, info["cost"]) == (-7.0, 3.0)
    assert not info["strict_success"]
