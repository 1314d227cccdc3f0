"""What the scripts with a teacher share: lessons in shared control, and a memory."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import torch
from curve import Curve
from numpy.typing import NDArray
from torch import nn
from training import MAPS, evaluate_policy, parser_of

import vlaps


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


class Lesson(NamedTuple):
    """A step of all worlds."""

    states: list[vlaps.State]  # before the step
    observations: NDArray[np.float32]  # that the learner's proposal answers
    proposal: NDArray[np.float32]
    after: NDArray[np.float32]  # of the next episode where one ended
    ended: NDArray[np.bool_]
    info: dict[str, Any]  # "takeover", "expert", "applied": see vlaps.Takeover


def arguments_of(text: str, out: str) -> argparse.Namespace:
    """The command line."""
    parser = parser_of(text, out=out, steps=20_000, every=2_000, envs=8)
    parser.add_argument("--updates", type=int, default=4, help="updates after each step of all worlds")
    parser.add_argument("--expert", default="mpc", help="the teacher: idm, rrt-star, informed, kinodynamic, mpc")
    return parser.parse_args()


def lessons(actor: nn.Module, title: str, arguments: argparse.Namespace, demonstration: float) -> Iterator[Lesson]:
    """The learner drives and the expert takes over; the expert drives the first share alone."""
    envs = vlaps.MetaDriveVectorEnv(
        arguments.envs, autoreset_mode="SameStep", takeover=vlaps.Takeover("differs", arguments.expert), **MAPS
    )
    curve = Curve(f"{arguments.out}.svg", title)
    observations, _ = envs.reset()
    taken, due = [1.0], 0
    for step in range(0, arguments.steps, arguments.envs):
        if step >= due:
            evaluate_policy(actor, step, curve, takeovers=float(np.mean(taken[-200:])))
            due += arguments.every
        with torch.no_grad():
            proposal = actor(torch.from_numpy(observations)).numpy()
        states = [envs.get_state(world) for world in range(envs.num_envs)]
        shown = step < demonstration * arguments.steps
        after, _, terminated, truncated, info = envs.step(proposal, takeover=True if shown else None)
        taken.append(info["takeover"].mean())
        yield Lesson(states, observations, proposal, after, terminated | truncated, info)
        observations = after
    evaluate_policy(actor, arguments.steps, curve, takeovers=float(np.mean(taken[-200:])))
