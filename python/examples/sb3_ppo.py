"""PPO of Stable-Baselines3; writes a policy file that `./vlaps up --policy` drives.

    pip install stable-baselines3
    python sb3_ppo.py --steps 24000000
"""

from __future__ import annotations

import numpy as np
import torch
from curve import Curve
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize
from training import CAREFUL, CONTACT_ENDS, LEAST_VARIANCE, MAPS, evaluate_policy, parser_of

from vlaps.sb3 import VlapsVecEnv

#: MetaDrive pays for metres. With 0.99 a metre now is worth so much more than one in ten
#: seconds that the car drives at 11 m/s and leaves the road on three maps of ten.
GAMMA = 0.997
ROLLOUT, BATCH, EPOCHS = 16_384, 2048, 6
#: Without a reward for its entropy the distribution of actions narrows within a million
#: steps, to a car that is too fast in turns. The reward fades, since the mean drives later.
ENTROPY = 0.01


class Examine(BaseCallback):
    """Fades the entropy's reward; evaluates the policy after every so many steps."""

    def __init__(self, every: int, curve: Curve) -> None:
        super().__init__()
        self.every, self.curve, self.due = every, curve, 0

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        self.model.ent_coef = ENTROPY * (1.0 - self.num_timesteps / self.model._total_timesteps)
        if self.num_timesteps >= self.due:
            self.due = self.num_timesteps + self.every
            self.evaluate_policy()

    def evaluate_policy(self) -> None:
        """Adds a point to the curve; the policy's file takes the normalisation in."""
        seen = self.model.get_env().obs_rms
        std = np.sqrt(seen.var + LEAST_VARIANCE)
        evaluate_policy(self.model, self.num_timesteps, self.curve, seen.mean, std)


def main() -> None:
    parser = parser_of(__doc__, out="sb3_ppo", steps=24_000_000, every=500_000, envs=128)
    arguments = parser.parse_args()
    worlds = VlapsVecEnv(arguments.envs, horizon=1000, **CAREFUL, **CONTACT_ENDS, **MAPS)
    # Rewards are scaled by their returns. No clip may bind, since a policy's file has none.
    env = VecNormalize(worlds, gamma=GAMMA, epsilon=LEAST_VARIANCE, clip_obs=1e3, clip_reward=1e3)
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=ROLLOUT // arguments.envs,
        batch_size=BATCH,
        n_epochs=EPOCHS,
        learning_rate=lambda left: 4e-4 * left,
        gamma=GAMMA,
        ent_coef=ENTROPY,
        seed=0,
        device="cpu",
        policy_kwargs={
            "net_arch": {"pi": [64, 64], "vf": [64, 64]},
            "activation_fn": torch.nn.Tanh,
            "log_std_init": -0.7,
        },
    )
    curve = Curve(f"{arguments.out}.svg", "PPO of Stable-Baselines3")
    callback = Examine(arguments.every, curve)
    model.learn(arguments.steps, callback=callback)
    callback.evaluate_policy()


if __name__ == "__main__":
    main()
