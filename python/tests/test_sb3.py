"""The adapter for Stable-Baselines3; with PyTorch, a short training too."""

import importlib.util

import numpy as np
import pytest

from drive import SHORT, actions

if importlib.util.find_spec("stable_baselines3") is None:
    pytest.skip("stable-baselines3 is not installed", allow_module_level=True)
if importlib.util.find_spec("torch") is None:
    pytest.skip("stable-baselines3 needs torch, which is not installed", allow_module_level=True)

from vlaps.sb3 import VlapsVecEnv  # noqa: E402


def test_the_adapter_steps_and_reports_ends():
    env = VlapsVecEnv(4, threads=2, **SHORT)
    env.seed(3)
    observation = env.reset()
    assert observation.shape == (4, 43)
    assert [info["seed"] for info in env.reset_infos] == [3, 4, 5, 6]
    ends, returns = 0, np.zeros(4)
    for action in actions(4, 40):
        observation, reward, done, infos = env.step(action)
        returns += reward
        for k in range(4):
            assert ("episode" in infos[k]) == done[k]
            if done[k]:
                ends += 1
                assert infos[k]["episode"]["r"] == pytest.approx(returns[k])
                assert infos[k]["episode"]["l"] == infos[k]["episode_length"] <= 12
                assert infos[k]["TimeLimit.truncated"] == infos[k]["max_step"]
                assert (infos[k]["terminal_observation"] != observation[k]).any()
                returns[k] = 0.0
    assert ends >= 12
    state = env.env_method("get_state", indices=[2])[0]
    assert env.env_method("set_state", state, indices=2)[0].shape == (43,)
    assert env.get_attr("render_mode") == [None] * 4
    env.close()


def test_ppo_trains():
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_checker import check_env

    import vlaps

    check_env(vlaps.MetaDriveEnv(num_scenarios=3))
    env = VlapsVecEnv(8, num_scenarios=100, horizon=40)
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=128, device="cpu", seed=1)
    model.learn(2048)
    assert len(model.ep_info_buffer) > 0
