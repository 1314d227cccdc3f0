"""PPO of TorchRL.

    pip install torch torchrl
    python torchrl_ppo.py --steps 10000000
"""

from __future__ import annotations

import gymnasium
import torch
from curve import Curve
from tensordict.nn import TensorDictModule
from tensordict.nn.distributions import NormalParamExtractor
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import GymWrapper
from torchrl.envs.utils import check_env_specs
from torchrl.modules import IndependentNormal, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE
from training import CONTACT_ENDS, MAPS, SMALL_REWARDS, evaluate_policy, network, parser_of

import vlaps

BATCH, EPOCHS = 2048, 6


def environment(**options: object) -> GymWrapper:
    """A vector of worlds as one batched environment of TorchRL."""
    return GymWrapper(gymnasium.make_vec(vlaps.ENV_ID, autoreset_mode="Disabled", **options))


class Widths(nn.Module):
    """A deviation that does not depend on the observation, beside the mean."""

    def __init__(self) -> None:
        super().__init__()
        self.scale = nn.Parameter(torch.full((2,), -0.5))

    def forward(self, mean: torch.Tensor) -> torch.Tensor:
        return torch.cat([mean, self.scale.expand_as(mean)], -1)


def main() -> None:
    arguments = parser_of(__doc__, out="torchrl_ppo", steps=10_000_000, every=500_000, envs=128).parse_args()
    options = {**SMALL_REWARDS, **CONTACT_ENDS, **MAPS}
    check_env_specs(environment(num_envs=2, **options))
    env = environment(num_envs=arguments.envs, **options)
    mean = network((259, 64, 2), nn.Tanh)
    actor = ProbabilisticActor(
        TensorDictModule(nn.Sequential(mean, Widths(), NormalParamExtractor()), ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )
    critic = ValueOperator(network((259, 64, 1), nn.Tanh), in_keys=["observation"])
    loss = ClipPPOLoss(actor, critic, clip_epsilon=0.2, entropy_coeff=0.01)
    estimator = GAE(gamma=0.99, lmbda=0.95, value_network=critic)
    optimiser = torch.optim.Adam(loss.parameters(), lr=4e-4)
    frames = max(1, min(16_384, arguments.steps) // arguments.envs) * arguments.envs
    total = -(-arguments.steps // frames) * frames
    collector = Collector(env, actor, frames_per_batch=frames, total_frames=total)
    curve = Curve(f"{arguments.out}.svg", "PPO of TorchRL")
    driven, due = 0, 0
    for data in collector:
        driven += data.numel()
        with torch.no_grad():
            estimator(data)
        rows = data.reshape(-1)
        for _ in range(EPOCHS):
            for part in torch.randperm(len(rows)).split(BATCH):
                terms = loss(rows[part])
                optimiser.zero_grad()
                (terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]).backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
                optimiser.step()
        if driven >= due or driven >= total:
            due = driven + arguments.every
            evaluate_policy(mean, driven, curve)
    collector.shutdown()


if __name__ == "__main__":
    main()
