"""What the training scripts share: maps, command line, network, normalisation, evaluation."""

from __future__ import annotations

import argparse

import numpy as np
import torch
from curve import Curve
from numpy.typing import ArrayLike, NDArray
from torch import nn

import vlaps

#: Maps to learn from; there are more than any script drives.
MAPS = {"start_seed": 2000, "num_scenarios": 50_000, "shuffle": True}
#: Maps that no training sees.
HELD_OUT = range(1000, 1100)
#: With MetaDrive's rules a car that is stuck on a cone pays 5 a step until the horizon, and
#: such returns hide all others: a contact ends PPO's training episodes, not the evaluation's.
CONTACT_ENDS = {"crash_vehicle_done": True, "crash_object_done": True}
#: Four times MetaDrive's penalties, for PPO's training: a driver that pays 5 for the end of a
#: drive of 300 m takes turns at the limit of its tyres.
CAREFUL = {"out_of_road_penalty": 20.0, "crash_vehicle_penalty": 20.0, "crash_object_penalty": 20.0}
#: MetaDrive's rewards divided by 20: returns of about 100 hide the actor's gradient.
SMALL_REWARDS = {
    name: vlaps.DEFAULTS[name] / 20.0
    for name in ("driving_reward", "speed_reward", "success_reward")
    + ("out_of_road_penalty", "crash_vehicle_penalty", "crash_object_penalty")
}
#: Added to a feature's variance: one that hardly changes is not blown up.
LEAST_VARIANCE = 0.0025
#: Names of a curve's lines, and their keys in an evaluation.
FIGURES = {"success": "success", "strict": "strict_success", "completion": "completion", "contact": "contact"}


def parser_of(text: str, *, out: str, steps: int, every: int, envs: int) -> argparse.ArgumentParser:
    """The options that all scripts have, with their defaults; also seeds torch."""
    torch.manual_seed(0)
    # The nets are small: a second thread costs more than it saves.
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description=text.splitlines()[0])
    parser.add_argument("--steps", type=int, default=steps, help="steps of all worlds together")
    parser.add_argument("--every", type=int, default=every, help="steps between two points of the curve")
    parser.add_argument("--envs", type=int, default=envs, help="worlds that step together")
    parser.add_argument("--out", default=out, help="name of the curve and of the policy, without suffix")
    return parser


def network(sizes: tuple[int, int, int], activation: type[nn.Module], *end: nn.Module) -> nn.Sequential:
    """Two hidden layers: sizes of input, of each hidden layer and of output."""
    inputs, hidden, outputs = sizes
    first, second = nn.Linear(inputs, hidden), nn.Linear(hidden, hidden)
    return nn.Sequential(first, activation(), second, activation(), nn.Linear(hidden, outputs), *end)


class Standard:
    """Mean and deviation of all rows so far; a policy's file takes those of observations in."""

    def __init__(self, width: int = 259) -> None:
        self.count, self.mean, self.variance = 0, np.zeros(width), np.ones(width)

    @property
    def std(self) -> NDArray[np.float64]:
        """What rows are divided by."""
        return np.sqrt(self.variance + LEAST_VARIANCE)

    def add(self, rows: NDArray[np.float64]) -> None:
        """Counts more rows in."""
        share, off = len(rows) / (self.count + len(rows)), rows.mean(0) - self.mean
        self.variance = (1 - share) * self.variance + share * rows.var(0) + share * (1 - share) * off**2
        self.mean, self.count = self.mean + share * off, self.count + len(rows)

    def __call__(self, observations: NDArray[np.float32]) -> torch.Tensor:
        return torch.from_numpy(((observations - self.mean) / self.std).astype(np.float32))


def evaluate_policy(
    policy: object,
    steps: int,
    curve: Curve,
    mean: ArrayLike | None = None,
    std: ArrayLike | None = None,
    **more: float,
) -> None:
    """Writes the policy's file, drives it alone on the maps held out, adds a point."""
    algorithm = curve.title.replace(",", " ").split()[0].lower()
    path = curve.path.with_suffix(".onnx")
    file = vlaps.export(policy, path, algorithm=algorithm, steps=steps, mean=mean, std=std)
    found = vlaps.evaluate(file, HELD_OUT, quiet=True)
    curve.add(steps, **{name: found[key].mean for name, key in FIGURES.items()}, **more)
