"""Policies of torch and of Stable-Baselines3 as files."""

import importlib.util
from functools import partial

import gymnasium
import numpy as np
import pytest

import vlaps

for name in ("torch", "stable_baselines3"):
    if importlib.util.find_spec(name) is None:
        pytest.skip(f"{name} is not installed", allow_module_level=True)

import torch  # noqa: E402
from stable_baselines3 import A2C, PPO, SAC, TD3  # noqa: E402
from torch import nn  # noqa: E402

OBSERVATIONS = np.random.default_rng(7).random((50, 259), np.float32)


def test_a_module_of_torch_is_written(tmp_path):
    torch.manual_seed(0)
    net = nn.Sequential(nn.Linear(259, 16), nn.ReLU(), nn.Sequential(nn.Linear(16, 2), nn.Tanh()))
    policy = vlaps.export(net, tmp_path / "p.onnx")
    with torch.no_grad():
        expected = net(torch.as_tensor(OBSERVATIONS)).numpy()
    assert np.abs(policy(OBSERVATIONS) - expected).max() < 1e-5
    assert net.training
    both = [vlaps.evaluate(one, range(1000, 1004), quiet=True, horizon=30) for one in (net, policy)]
    assert [one.seed for one in both[0].episodes] == [one.seed for one in both[1].episodes]
    assert both[0]["completion"].mean == pytest.approx(both[1]["completion"].mean, abs=1e-3)


@pytest.mark.parametrize("make", [gymnasium.make, partial(gymnasium.make_vec, num_envs=3)])
def test_torchrl_checks_the_environment(make):
    pytest.importorskip("torchrl")
    from torchrl.envs import GymWrapper
    from torchrl.envs.utils import check_env_specs

    vector = {"autoreset_mode": "Disabled"} if isinstance(make, partial) else {}
    check_env_specs(GymWrapper(make(vlaps.ENV_ID, num_scenarios=3, **vector)))


@pytest.mark.parametrize("algorithm", [PPO, A2C, SAC, TD3])
def test_a_model_of_stable_baselines_is_written(tmp_path, algorithm):
    model = algorithm("MlpPolicy", vlaps.MetaDriveEnv(), seed=1, device="cpu")
    policy = vlaps.export(model, tmp_path / "p.onnx")
    expected, _ = model.predict(OBSERVATIONS, deterministic=True)
    assert np.abs(policy(OBSERVATIONS) - expected).max() < 1e-5
    assert policy.origin["algorithm"] == algorithm.__name__.lower()
    assert policy.origin["seed"] == 1


class Reordered(nn.Module):
    """Runs its layers in another order than it lists them."""

    def __init__(self):
        super().__init__()
        self.last = nn.Linear(259, 2)
        self.first = nn.Linear(259, 259)

    def forward(self, x):
        return self.last(self.first(x))


class Doubled(nn.Module):
    def __init__(self):
        super().__init__()
        self.layer = nn.Linear(259, 2)

    def forward(self, x):
        return 2.0 * self.layer(x)


@pytest.mark.parametrize(
    ("net", "error", "message"),
    [
        (Doubled(), ValueError, "differ by"),
        (Reordered(), ValueError, "refused"),
        (nn.Sequential(nn.Linear(259, 2), nn.Sigmoid()), TypeError, "Sigmoid"),
        (nn.Sequential(nn.Tanh(), nn.Linear(259, 2)), TypeError, "follow"),
        (nn.Linear(43, 2), ValueError, "input"),
    ],
)
def test_modules_that_cannot_be_written(tmp_path, net, error, message):
    with pytest.raises(error, match=message):
        vlaps.export(net, tmp_path / "p.onnx")
    assert not (tmp_path / "p.onnx").exists()
