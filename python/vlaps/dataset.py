"""Recorded episodes, and their export to Minari."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from .drivers import driving, name_of
from .env import action_space, observation_space
from .registration import ENV_ID
from .vector import MetaDriveVectorEnv


@dataclass(frozen=True)
class Recorded:
    """One episode of `steps` steps. Only the last step of an episode may be terminated or
    truncated; one that was going on when the recording ended is neither."""

    seed: int
    #: `[steps + 1, features]`: the first and the last one included.
    observations: NDArray[np.float32]
    #: `[steps, 2]`, as the world obeyed them.
    actions: NDArray[np.float32]
    #: `[steps]`.
    rewards: NDArray[np.float64]
    #: `[steps]`.
    costs: NDArray[np.float64]
    #: `[steps]`.
    terminated: NDArray[np.bool_]
    #: `[steps]`.
    truncated: NDArray[np.bool_]
    #: `[steps, 2]`: what the driver proposed where an expert could take over.
    proposals: NDArray[np.float32]
    #: `[steps]`: whether the expert drove.
    takeover: NDArray[np.bool_]


@dataclass(frozen=True)
class Dataset:
    """Episodes of one driver."""

    driver: str
    config: dict[str, Any]
    episodes: list[Recorded]

    def __len__(self) -> int:
        """Number of steps."""
        return sum(len(one.actions) for one in self.episodes)

    def transitions(self) -> dict[str, NDArray[Any]]:
        """All steps in one array for each name: "observations", "next_observations",
        "actions", "rewards", "costs", "terminated", "truncated", "proposals", "takeover"."""
        names = ("actions", "rewards", "costs", "terminated", "truncated", "proposals", "takeover")
        columns = {name: [getattr(one, name) for one in self.episodes] for name in names}
        columns["observations"] = [one.observations[:-1] for one in self.episodes]
        columns["next_observations"] = [one.observations[1:] for one in self.episodes]
        return {name: np.concatenate(parts) for name, parts in columns.items()}

    def to_minari(self, dataset_id: str, **description: Any) -> Any:
        """Writes a dataset of Minari, such as "vlaps/idm-v0", and returns it.

        Costs, proposals and takeovers are in the infos. An episode that was going on when
        the recording ended is truncated there. `description` are keywords of
        `minari.create_dataset_from_buffers`, such as `author`.
        """
        try:
            import minari
            from minari.data_collector.episode_buffer import EpisodeBuffer
        except ImportError as error:
            raise ImportError('to_minari needs Minari: pip install "minari[hdf5]"') from error
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


def collect(driver: Any, steps: int, *, num_envs: int = 1, **options: Any) -> Dataset:
    """Drives, and records at least `steps` steps of all worlds together.

    `driver` is that of `vlaps.evaluate`, or a name of an expert. `options` are those of
    `MetaDriveVectorEnv`, such as `threads`, `takeover`, `start_seed` and `num_scenarios`.
    World k drives the episodes k, k + num_envs, ... in the order of seeds; the last one of
    each world ends where the recording does.
    """
    if steps < 1:
        raise ValueError(f"steps = {steps}: it must be at least 1")
    if "autoreset_mode" in options:
        raise ValueError("autoreset_mode: a recording has its own")
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
    """An episode as it goes."""

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
