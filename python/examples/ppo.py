"""PPO (Schulman et al. 2017) written out, after CleanRL's ppo_continuous_action.py.

    pip install torch
    python ppo.py --steps 15000000

With `--cost-limit N` it is safe: a Lagrange multiplier weighs the cost against the reward
until an episode costs N on average (Ray, Achiam, Amodei 2019); see safe_rl.py.
"""

from __future__ import annotations

import argparse
from collections import deque

import numpy as np
import torch
from curve import Curve
from torch import nn
from training import CONTACT_ENDS, MAPS, Standard, evaluate_policy, network, parser_of

import vlaps

#: MetaDrive pays for metres. With 0.99 a metre now is worth so much more than one in ten
#: seconds that the car drives at 11 m/s and leaves the road on three maps of ten.
GAMMA = 0.997
LAMBDA, CLIP, RATE = 0.95, 0.2, 4e-4
ROLLOUT, EPOCHS, BATCH = 16_384, 6, 2048
#: Without a reward for its entropy the distribution of actions narrows within a million
#: steps, to a car that is too fast in turns. The reward fades, since the mean drives later.
ENTROPY = 0.01
#: Taken from each step's reward: with a discount this near to 1 a car that stands before a
#: junction keeps its hope for very long, and has nothing to lose.
STEP = 0.1
#: The cost's multiplier is 0 in the first share of the steps: weighed from the beginning, the
#: cost teaches the car to stand. Then an episode too expensive by 1 adds to it after each
#: rollout, up to the last number.
FREE, GAIN, MOST = 0.4, 0.15, 8.0


class Agent(nn.Module):
    """Mean and deviation of the action; values of reward and of cost."""

    def __init__(self) -> None:
        super().__init__()
        self.mean, self.values = network((259, 64, 2), nn.Tanh), network((259, 64, 2), nn.Tanh)
        for net, gain in ((self.mean, 0.01), (self.values, 1.0)):
            for layer, scale in zip(net[::2], (2**0.5, 2**0.5, gain)):
                nn.init.orthogonal_(layer.weight, scale)
                nn.init.zeros_(layer.bias)
        self.log_std = nn.Parameter(torch.full((2,), -0.7))

    def distribution(self, seen: torch.Tensor) -> torch.distributions.Normal:
        """Of the action; the world clips it to [-1, 1]."""
        return torch.distributions.Normal(self.mean(seen), self.log_std.exp())


def advantages(gains: torch.Tensor, values: torch.Tensor, last: torch.Tensor, ended: torch.Tensor) -> torch.Tensor:
    """Generalised advantage estimation over `[steps, worlds, 2]`; ends cut the sum."""
    result, running = torch.zeros_like(values), torch.zeros_like(last)
    for step in reversed(range(len(gains))):
        going = 1.0 - ended[step][:, None]
        following = last if step == len(gains) - 1 else values[step + 1]
        running = gains[step] + GAMMA * going * following - values[step] + GAMMA * LAMBDA * going * running
        result[step] = running
    return result


def update(
    agent: Agent, optimiser: torch.optim.Optimizer, rows: list[torch.Tensor], weight: float, left: float
) -> None:
    """Some epochs of the clipped objective; `weight` is the cost's multiplier, `left` the share of steps left."""
    seen, actions, before, advantage, returns = rows
    advantage = (advantage[:, 0] - weight * advantage[:, 1]) / (1.0 + weight)
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    optimiser.param_groups[0]["lr"] = RATE * left
    for _ in range(EPOCHS):
        for part in torch.randperm(len(seen)).split(BATCH):
            distribution = agent.distribution(seen[part])
            ratio = (distribution.log_prob(actions[part]).sum(1) - before[part]).exp()
            gain = torch.min(ratio * advantage[part], ratio.clamp(1 - CLIP, 1 + CLIP) * advantage[part]).mean()
            error = ((agent.values(seen[part]) - returns[part]) ** 2).mean()
            loss = error - gain - ENTROPY * left * agent.log_std.sum()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimiser.step()


def train(arguments: argparse.Namespace) -> None:
    """Trains, and draws the curve."""
    count, limit = arguments.envs, arguments.cost_limit
    steps = max(1, min(ROLLOUT, arguments.steps) // count)
    envs = vlaps.MetaDriveVectorEnv(count, autoreset_mode="SameStep", horizon=1000, **CONTACT_ENDS, **MAPS)
    # Rewards are divided by the deviation of the returns so far, which grow as the car learns.
    agent, standard, paid, scale = Agent(), Standard(), np.zeros(count), Standard(1)
    optimiser = torch.optim.Adam(agent.parameters(), lr=RATE, eps=1e-5)
    curve = Curve(f"{arguments.out}.svg", "PPO" if limit is None else f"PPO, cost of an episode limited to {limit:g}")
    observations, _ = envs.reset()
    driven, due, weight, cost, costs = 0, 0, 0.0, np.zeros(count), deque([0.0], maxlen=200)
    while driven < arguments.steps:
        rows, raw = [], []
        for _ in range(steps):
            raw.append(observations)
            with torch.no_grad():
                seen = standard(observations)
                distribution = agent.distribution(seen)
                action = distribution.sample()
                row = [seen, action, distribution.log_prob(action).sum(1), agent.values(seen)]
            observations, reward, terminated, truncated, info = envs.step(action.numpy())
            ended = terminated | truncated
            reward = reward - STEP
            paid = GAMMA * paid + reward
            scale.add(paid[:, None])
            paid[ended] = 0.0
            gains = np.stack([reward / scale.std, info["cost"]], 1).astype(np.float32)
            cost += info["cost"]
            costs.extend(cost[ended])
            cost[ended] = 0.0
            # The horizon ends no value: what would have come counts.
            for world in np.flatnonzero(truncated & ~terminated):
                with torch.no_grad():
                    gains[world] += GAMMA * agent.values(standard(info["final_obs"][world])).numpy()
            rows.append([*row, torch.from_numpy(gains), torch.from_numpy(ended.astype(np.float32))])
        driven += steps * count
        seen, actions, before, values, gains, ends = (torch.stack(column) for column in zip(*rows))
        with torch.no_grad():
            advantage = advantages(gains, values, agent.values(standard(observations)), ends)
        if limit is not None and driven > FREE * arguments.steps:
            weight = min(max(0.0, weight + GAIN * (float(np.mean(costs)) - limit)), MOST)
        flat = [one.flatten(0, 1) for one in (seen, actions, before, advantage, advantage + values)]
        update(agent, optimiser, flat, weight, max(0.0, 1.0 - driven / arguments.steps))
        last = standard.mean, standard.std
        standard.add(np.concatenate(raw).astype(np.float64))
        if driven >= due or driven >= arguments.steps:
            due = driven + arguments.every
            print(f"multiplier {weight:.2f}")
            evaluate_policy(agent.mean, driven, curve, *last, cost=float(np.mean(costs)))


def arguments_of(text: str, out: str, cost_limit: float | None) -> argparse.Namespace:
    """The command line."""
    parser = parser_of(text, out=out, steps=15_000_000, every=500_000, envs=128)
    parser.add_argument("--cost-limit", type=float, default=cost_limit, help="cost of an episode that is allowed")
    return parser.parse_args()


if __name__ == "__main__":
    train(arguments_of(__doc__, "ppo", None))
