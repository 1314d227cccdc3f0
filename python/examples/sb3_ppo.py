"""PPO of Stable-Baselines3; writes a policy file that `./vlaps up --policy` drives.

    pip install stable-baselines3
    python sb3_ppo.py --steps 3000000
"""

from __future__ import annotations

import argparse

import torch
from curve import Curve
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

import vlaps
from vlaps.sb3 import VlapsVecEnv

SEEDS = range(1000, 1050)


class Examine(BaseCallback):
    """Evaluates the policy, and writes its file, after every so many steps."""

    def __init__(self, every: int, curve: Curve, path: str) -> None:
        super().__init__()
        self.every, self.curve, self.path, self.due = every, curve, path, 0

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        if self.num_timesteps < self.due:
            return
        self.due = self.num_timesteps + self.every
        self.examine()

    def examine(self) -> None:
        """Adds a point to the curve."""
        policy = vlaps.export(self.model, self.path)
        found = vlaps.evaluate(policy, SEEDS, quiet=True)
        self.curve.add(
            self.num_timesteps,
            success=found["success"].mean,
            completion=found["completion"].mean,
            strict=found["strict_success"].mean,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=3_000_000)
    parser.add_argument("--every", type=int, default=200_000)
    parser.add_argument("--envs", type=int, default=32)
    parser.add_argument("--horizon", type=int, default=1000)
    parser.add_argument("--out", default="sb3_ppo")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    env = VlapsVecEnv(
        arguments.envs, start_seed=100, num_scenarios=800, shuffle=True, horizon=arguments.horizon
    )
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=8192 // arguments.envs,
        batch_size=1024,
        n_epochs=6,
        learning_rate=lambda left: 4e-4 * left + 2e-5,
        gamma=0.99,
        ent_coef=0.0,
        seed=0,
        device="cpu",
        policy_kwargs={
            "net_arch": {"pi": [128, 128], "vf": [128, 128]},
            "activation_fn": torch.nn.Tanh,
            "log_std_init": -0.7,
        },
    )
    curve = Curve(f"{arguments.out}.svg", "PPO of Stable-Baselines3, 50 episodes a point")
    examine = Examine(arguments.every, curve, f"{arguments.out}.onnx")
    model.learn(arguments.steps, callback=examine)
    examine.examine()


if __name__ == "__main__":
    main()
