"""What the examples with a teacher share: network, memory, examination, arguments."""

from __future__ import annotations

import argparse

import numpy as np
import torch
from curve import Curve
from torch import nn

import vlaps

SEEDS = range(1000, 1020)


def network(inputs: int, outputs: int, *end: nn.Module) -> nn.Sequential:
    """Two hidden layers of 128; Linear, ReLU and Tanh fit a policy file."""
    return nn.Sequential(
        nn.Linear(inputs, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU(), nn.Linear(128, outputs), *end
    )


class Memory:
    """Rows of equal-length float arrays, in the order they came."""

    def __init__(self, *widths: int, limit: int = 100_000) -> None:
        self.arrays = [np.zeros((limit, width), np.float32) for width in widths]
        self.limit, self.count, self.added = limit, 0, 0

    def add(self, *columns: np.ndarray) -> None:
        """Adds rows; the oldest ones are overwritten when it is full."""
        places = (self.added + np.arange(len(columns[0]))) % self.limit
        for array, column in zip(self.arrays, columns):
            array[places] = np.reshape(column, (len(places), array.shape[1]))
        self.added += len(places)
        self.count = min(self.added, self.limit)

    def draw(self, random: np.random.Generator, count: int) -> list[torch.Tensor]:
        """Random rows of each array."""
        rows = random.integers(self.count, size=count)
        return [torch.from_numpy(array[rows]) for array in self.arrays]


def arguments_of(text: str, **defaults: object) -> argparse.Namespace:
    """The options that the examples have in common."""
    parser = argparse.ArgumentParser(description=text.splitlines()[0])
    parser.add_argument("--steps", type=int, default=20_000, help="steps of all worlds together")
    parser.add_argument("--every", type=int, default=2_000, help="steps between two points of the curve")
    parser.add_argument("--envs", type=int, default=8)
    parser.add_argument("--updates", type=int, default=4, help="updates after each step of all worlds")
    parser.add_argument("--expert", default="mpc", help="the teacher: idm, rrt-star, informed, kinodynamic, mpc")
    parser.add_argument("--out", help="name of the curve and of the policy, without suffix")
    parser.set_defaults(**defaults)
    arguments = parser.parse_args()
    torch.manual_seed(0)
    torch.set_num_threads(1)
    return arguments


def examine(actor: nn.Module, step: int, curve: Curve, path: str, **more: float) -> None:
    """Writes the policy, drives it alone on seeds that training does not see, adds a point."""
    policy = vlaps.export(actor, path, algorithm=curve.title.split()[0].lower(), steps=step)
    found = vlaps.evaluate(policy, SEEDS, quiet=True)
    curve.add(step, success=found["success"].mean, completion=found["completion"].mean, **more)
