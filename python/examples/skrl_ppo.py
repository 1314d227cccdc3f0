"""PPO of skrl.

    pip install torch skrl
    python skrl_ppo.py --steps 10000000
"""

from __future__ import annotations

import torch
from curve import Curve
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer
from torch import nn
from training import CONTACT_ENDS, MAPS, SMALL_REWARDS, evaluate_policy, network, parser_of

import vlaps


class Actor(GaussianMixin, Model):
    """Mean and deviation of the action."""

    def __init__(self, **spaces: object) -> None:
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self, clip_actions=False)
        self.net = network((259, 64, 2), nn.Tanh)
        self.log_std = nn.Parameter(torch.full((2,), -0.7))

    def compute(self, inputs: dict, role: str = "") -> tuple:
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Critic(DeterministicMixin, Model):
    """Value of an observation."""

    def __init__(self, **spaces: object) -> None:
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self, clip_actions=False)
        self.net = network((259, 64, 1), nn.Tanh)

    def compute(self, inputs: dict, role: str = "") -> tuple:
        return self.net(inputs["observations"]), {}


def main() -> None:
    arguments = parser_of(__doc__, out="skrl_ppo", steps=10_000_000, every=500_000, envs=128).parse_args()
    worlds = vlaps.MetaDriveVectorEnv(
        arguments.envs, autoreset_mode="SameStep", **SMALL_REWARDS, **CONTACT_ENDS, **MAPS
    )
    env = wrap_env(worlds, wrapper="gymnasium", verbose=False)
    spaces = {
        "observation_space": env.observation_space,
        "action_space": env.action_space,
        "device": env.device,
    }
    models = {"policy": Actor(**spaces), "value": Critic(**spaces)}
    rollouts = max(1, min(16_384, arguments.steps) // arguments.envs)
    config = PPO_CFG(
        rollouts=rollouts, learning_epochs=6, mini_batches=8, learning_rate=4e-4, entropy_loss_scale=0.01
    )
    config.experiment.write_interval = config.experiment.checkpoint_interval = 0
    agent = PPO(
        models=models,
        memory=RandomMemory(memory_size=rollouts, num_envs=env.num_envs, device=env.device),
        cfg=config,
        **spaces,
    )
    curve = Curve(f"{arguments.out}.svg", "PPO of skrl")
    driven = 0
    while driven < arguments.steps:
        part = min(arguments.every, arguments.steps - driven)
        timesteps = -(-part // arguments.envs)
        trainer = SequentialTrainer(
            env=env,
            agents=agent,
            cfg={
                "timesteps": timesteps,
                "headless": True,
                "disable_progressbar": True,
                "close_environment_at_exit": False,
            },
        )
        trainer.train()
        driven += timesteps * arguments.envs
        evaluate_policy(models["policy"].net, driven, curve)


if __name__ == "__main__":
    main()
