"""PPO of skrl.

    pip install torch skrl
    python skrl_ppo.py --steps 2000000
"""

from __future__ import annotations

import argparse

import torch
from curve import Curve
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer
from torch import nn

import vlaps


def network(outputs: int) -> nn.Sequential:
    """Two hidden layers."""
    return nn.Sequential(nn.Linear(259, 128), nn.Tanh(), nn.Linear(128, 128), nn.Tanh(), nn.Linear(128, outputs))


class Actor(GaussianMixin, Model):
    """Mean and deviation of the action."""

    def __init__(self, **spaces: object) -> None:
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self, clip_actions=False)
        self.net = network(2)
        self.log_std = nn.Parameter(torch.full((2,), -0.7))

    def compute(self, inputs: dict, role: str = "") -> tuple:
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Critic(DeterministicMixin, Model):
    """Value of an observation."""

    def __init__(self, **spaces: object) -> None:
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self, clip_actions=False)
        self.net = network(1)

    def compute(self, inputs: dict, role: str = "") -> tuple:
        return self.net(inputs["observations"]), {}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=2_000_000)
    parser.add_argument("--every", type=int, default=200_000)
    parser.add_argument("--envs", type=int, default=32)
    parser.add_argument("--out", default="skrl_ppo")
    arguments = parser.parse_args()
    torch.manual_seed(0)
    torch.set_num_threads(1)
    env = wrap_env(
        vlaps.MetaDriveVectorEnv(
            arguments.envs, autoreset_mode="SameStep", start_seed=100, num_scenarios=800, shuffle=True
        ),
        wrapper="gymnasium",
        verbose=False,
    )
    spaces = {
        "observation_space": env.observation_space,
        "action_space": env.action_space,
        "device": env.device,
    }
    models = {"policy": Actor(**spaces), "value": Critic(**spaces)}
    rollouts = max(1, min(8192, arguments.steps) // arguments.envs)
    config = PPO_CFG(rollouts=rollouts, learning_epochs=6, mini_batches=8, learning_rate=4e-4)
    config.experiment.write_interval = config.experiment.checkpoint_interval = 0
    agent = PPO(
        models=models,
        memory=RandomMemory(memory_size=rollouts, num_envs=env.num_envs, device=env.device),
        cfg=config,
        **spaces,
    )
    curve = Curve(f"{arguments.out}.svg", "PPO of skrl, 50 episodes a point")
    driven = 0
    while driven < arguments.steps:
        part = min(arguments.every, arguments.steps - driven)
        timesteps = max(1, part // arguments.envs)
        trainer = SequentialTrainer(
            env=env,
            agents=agent,
            cfg={"timesteps": timesteps, "headless": True, "disable_progressbar": True, "close_environment_at_exit": False},
        )
        trainer.train()
        driven += timesteps * arguments.envs
        policy = vlaps.export(models["policy"].net, f"{arguments.out}.onnx", algorithm="ppo", steps=driven)
        found = vlaps.evaluate(policy, range(1000, 1050), quiet=True)
        curve.add(driven, success=found["success"].mean, completion=found["completion"].mean)


if __name__ == "__main__":
    main()
