"""Recorded episodes, and their export to Minari."""

from __future__ import annotations

import copy
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from .config import whole
from .drivers import driving, name_of
from .env import action_space, observation_space
from .registration import ENV_ID
from .vector import MetaDriveVectorEnv


@dataclass(frozen=True)
class Recorded:
    """One episode of `steps` steps. Only the last step may be terminated or truncated; it is
    neither if the recording ended before the episode."""

    seed: int
    #: `[steps + 1, features]`: from the first to the last observation.
    observations: NDArray[np.float32]
    #: `[steps, 2]`: the actions that the world applied.
    actions: NDArray[np.float32]
    #: `[steps]`.
    rewards: NDArray[np.float64]
    #: `[steps]`.
    costs: NDArray[np.float64]
    #: `[steps]`.
    terminated: NDArray[np.bool_]
    #: `[steps]`.
    truncated: NDArray[np.bool_]
    #: `[steps, 2]`: the actions that the driver proposed; they differ in takeovers.
    proposals: NDArray[np.float32]
    #: `[steps]`: whether the expert drove.
    takeover: NDArray[np.bool_]


@dataclass(frozen=True)
class Dataset:
    """Episodes of one driver."""

    driver: str
    #: The environment's options; `None` when it was recorded elsewhere.
    config: dict[str, Any] | None
    episodes: list[Recorded]

    def __len__(self) -> int:
        """Number of steps."""
        return sum(len(one.actions) for one in self.episodes)

    def transitions(self) -> dict[str, NDArray[Any]]:
        """All steps as one array per name: "observations", "next_observations",
        "actions", "rewards", "costs", "terminated", "truncated", "proposals", "takeover"."""
        names = ("actions", "rewards", "costs", "terminated", "truncated", "proposals", "takeover")
        columns = {name: [getattr(one, name) for one in self.episodes] for name in names}
        columns["observations"] = [one.observations[:-1] for one in self.episodes]
        columns["next_observations"] = [one.observations[1:] for one in self.episodes]
        return {name: np.concatenate(parts) for name, parts in columns.items()}

    def to_minari(self, dataset_id: str, **description: Any) -> Any:
        """Writes a Minari dataset, such as "vlaps/idm-v0", and returns it.

        Costs, proposals and takeovers are in the infos. An unfinished episode is marked as
        truncated. `description` are keywords of `minari.create_dataset_from_buffers`, such
        as `author`.
        """
        try:
            import minari
            from minari.data_collector.episode_buffer import EpisodeBuffer
        except ImportError as error:
            raise ImportError('to_minari needs Minari: pip install "minari[hdf5]" pillow') from error
        features = self.episodes[0].observations.shape[1]
        buffers = []
        for number, one in enumerate(self.episodes):
            truncated = one.truncated.copy()
            truncated[-1] |= not one.terminated[-1]
            buffers.append(
                EpisodeBuffer(
                    id=number,
                    seed=one.seed,
                    observations=one.observations,
                    actions=one.actions,
                    rewards=one.rewards.tolist(),
                    terminations=one.terminated.tolist(),
                    truncations=truncated.tolist(),
                    infos={"cost": one.costs, "proposal": one.proposals, "takeover": one.takeover},
                )
            )
        spec = None
        if self.config is not None:
            spec = copy.deepcopy(gymnasium.spec(ENV_ID))
            spec.kwargs.update(self.config)
        given = {
            "algorithm_name": self.driver,
            "observation_space": observation_space(features),
            "action_space": action_space(),
            "env": spec,
            **description,
        }
        return minari.create_dataset_from_buffers(dataset_id, buffers, **given)

    def to_lerobot(self, folder: str | os.PathLike[str], fps: int = 10) -> Path:
        """Writes a dataset of LeRobot into a new folder and returns the folder.

        See `vlaps.lerobot.write_lerobot`. `fps` is the number of steps in a second; those of
        the environments are 0.1 s.
        """
        from .lerobot import write_lerobot

        return write_lerobot(self, folder, fps)


def collect(driver: Any, steps: int, *, num_envs: int = 1, **options: Any) -> Dataset:
    """Drives and records at least `steps` steps in total: each world drives the same number,
    which is rounded up.

    `driver` is a driver of `vlaps.evaluate`, except "expert" and "lane". `options` are those
    of `MetaDriveVectorEnv`, such as `threads`, `takeover`, `start_seed` and `num_scenarios`.
    World k drives the episodes k, k + num_envs, ... in the order of seeds; the last episode
    of each world ends with the recording.
    """
    steps, num_envs = whole("steps", steps, 1), whole("num_envs", num_envs, 1)
    if "autoreset_mode" in options:
        raise ValueError("autoreset_mode: collect sets it itself; leave it out")
    answer = driving(driver)
    envs = MetaDriveVectorEnv(num_envs, autoreset_mode="SameStep", **options)
    observations, info = envs.reset()
    running = [_Recording(observations[k], int(info["seed"][k])) for k in range(num_envs)]
    done: list[tuple[int, int, Recorded]] = []
    for step in range(-(-steps // num_envs)):
        actions = answer(envs, observations)
        after, rewards, terminated, truncated, info = envs.step(actions)
        ended = terminated | truncated
        columns = (
            info.get("applied", actions),
            rewards,
            info["cost"],
            terminated,
            truncated,
            actions,
            info.get("takeover", np.zeros(num_envs, np.bool_)),
        )
        seeds = envs.seeds() if ended.any() else info["seed"]
        for k, recording in enumerate(running):
            last = info["final_obs"][k] if ended[k] else after[k]
            recording.add(last, tuple(column[k] for column in columns))
            if ended[k]:
                done.append((k, step, recording.recorded()))
                running[k] = _Recording(after[k], int(seeds[k]))
        observations = after
    done += [(k, steps, one.recorded()) for k, one in enumerate(running) if one.rows]
    envs.close()
    episodes = [one for _, _, one in sorted(done, key=lambda entry: entry[:2])]
    return Dataset(name_of(driver), envs.config, episodes)


class _Recording:
    """An episode that is being recorded."""

    def __init__(self, first: NDArray[np.float32], seed: int) -> None:
        self.seed, self.observations, self.rows = seed, [first], list[tuple[Any, ...]]()

    def add(self, observation: NDArray[np.float32], row: tuple[Any, ...]) -> None:
        self.observations.append(observation)
        self.rows.append(row)

    def recorded(self) -> Recorded:
        """The episode as arrays."""
        columns = [np.array(column) for column in zip(*self.rows)]
        columns[0], columns[5] = columns[0].astype(np.float32), columns[5].astype(np.float32)
        return Recorded(self.seed, np.array(self.observations, np.float32), *columns)
