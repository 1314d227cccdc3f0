"""PPO (Schulman et al. 2017) in one file, after CleanRL's ppo_continuous_action.py.

    pip install torch
    python ppo.py --steps 2000000

With `--cost-limit N` it is safe: a Lagrange multiplier weighs the cost against the reward
until an episode costs N on average (Ray, Achiam, Amodei 2019); see safe_rl.py.
"""

from __future__ import annotations

import argparse

import numpy as np
import torch
from curve import Curve
from torch import nn

import vlaps

GAMMA, LAMBDA, CLIP, EPOCHS, BATCH = 0.99, 0.95, 0.2, 6, 1024


def network(outputs: int, gain: float) -> nn.Sequential:
    """Two hidden layers, orthogonally initialised."""
    net = nn.Sequential(nn.Linear(259, 128), nn.Tanh(), nn.Linear(128, 128), nn.Tanh(), nn.Linear(128, outputs))
    for layer, scale in zip(net[::2], (2**0.5, 2**0.5, gain)):
        nn.init.orthogonal_(layer.weight, scale)
        nn.init.zeros_(layer.bias)
    return net


class Agent(nn.Module):
    """Mean and deviation of the action; values of reward and of cost."""

    def __init__(self) -> None:
        super().__init__()
        self.mean, self.values = network(2, 0.01), network(2, 1.0)
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


def update(agent: Agent, optimiser: torch.optim.Optimizer, rows: list[torch.Tensor], weight: float) -> None:
    """Some epochs of the clipped objective; `weight` is the cost's multiplier."""
    seen, actions, before, advantage, returns = rows
    advantage = (advantage[:, 0] - weight * advantage[:, 1]) / (1.0 + weight)
    for _ in range(EPOCHS):
        for part in torch.randperm(len(seen)).split(BATCH):
            distribution = agent.distribution(seen[part])
            ratio = (distribution.log_prob(actions[part]).sum(1) - before[part]).exp()
            scaled = (advantage[part] - advantage[part].mean()) / (advantage[part].std() + 1e-8)
            gain = torch.min(ratio * scaled, ratio.clamp(1 - CLIP, 1 + CLIP) * scaled).mean()
            loss = 0.5 * ((agent.values(seen[part]) - returns[part]) ** 2).mean() - gain
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimiser.step()


def train(arguments: argparse.Namespace) -> None:
    """Trains, and draws the curve."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    count, steps = arguments.envs, max(1, 8192 // arguments.envs)
    envs = vlaps.MetaDriveVectorEnv(
        count, autoreset_mode="SameStep", start_seed=100, num_scenarios=800, shuffle=True, horizon=1000
    )
    agent = Agent()
    optimiser = torch.optim.Adam(agent.parameters(), lr=4e-4, eps=1e-5)
    curve = Curve(f"{arguments.out}.svg", f"{arguments.out}, 50 episodes a point")
    observations, _ = envs.reset(seed=100)
    driven, due, weight, cost, costs = 0, 0, 0.0, np.zeros(count), [0.0]
    while driven < arguments.steps:
        rows: list[list[torch.Tensor]] = []
        for _ in range(steps):
            with torch.no_grad():
                seen = torch.from_numpy(observations)
                distribution = agent.distribution(seen)
                action = distribution.sample()
                row = [seen, action, distribution.log_prob(action).sum(1), agent.values(seen)]
            observations, reward, terminated, truncated, info = envs.step(action.numpy())
            ended = terminated | truncated
            cost += info["cost"]
            costs.extend(cost[ended])
            cost[ended] = 0.0
            gains = np.stack([reward, info["cost"]], 1).astype(np.float32)
            rows.append([*row, torch.from_numpy(gains), torch.from_numpy(ended.astype(np.float32))])
        driven += steps * count
        seen, actions, before, values, gains, ends = (torch.stack(column) for column in zip(*rows))
        with torch.no_grad():
            advantage = advantages(gains, values, agent.values(torch.from_numpy(observations)), ends)
        mean_cost = float(np.mean(costs[-100:]))
        if arguments.cost_limit is not None:
            weight = max(0.0, weight + 0.05 * (mean_cost - arguments.cost_limit))
        flat = [one.flatten(0, 1) for one in (seen, actions, before, advantage, advantage + values)]
        update(agent, optimiser, flat, weight)
        if driven >= due or driven >= arguments.steps:
            due = driven + arguments.every
            policy = vlaps.export(agent.mean, f"{arguments.out}.onnx", algorithm="ppo", steps=driven)
            found = vlaps.evaluate(policy, range(1000, 1050), quiet=True)
            shares = {key: found[key].mean for key in ("success", "completion", "contact")}
            print(f"cost of an episode {mean_cost:.2f}, multiplier {weight:.2f}")
            curve.add(driven, **shares)


def arguments_of(text: str, out: str, cost_limit: float | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=text.splitlines()[0])
    parser.add_argument("--steps", type=int, default=2_000_000, help="steps of all worlds together")
    parser.add_argument("--every", type=int, default=200_000, help="steps between two points of the curve")
    parser.add_argument("--envs", type=int, default=32)
    parser.add_argument("--cost-limit", type=float, default=cost_limit, help="cost of an episode that is allowed")
    parser.add_argument("--out", default=out, help="name of the curve and of the policy, without suffix")
    return parser.parse_args()


if __name__ == "__main__":
    train(arguments_of(__doc__, "ppo", None))
