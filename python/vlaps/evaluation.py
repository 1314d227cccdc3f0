"""Evaluates a driver on whole episodes and prints the table of `./vlaps eval`."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import _vlaps
from .config import expert_json, listed, merged, to_json, whole
from .drivers import driving, loaded, name_of
from .env import EXPERTS
from .policy import Policy
from .vector import MetaDriveVectorEnv, _cores

#: Episodes per task. It is fixed, so that a driver that answers whole batches gets the same
#: batches with any number of processes.
CHUNK = 64
#: The two-sided 95 % quantile of the normal distribution.
_Z = 1.959963984540054
#: Duration of a step, s.
_STEP_S = 0.1
_FOOTNOTE = (
    "crash at the last step is MetaDrive's flag, which counts sidewalks, too; contact counts "
    "vehicles and objects, at any step: either may be the larger one."
)
#: Key, name in the table, digits after the point.
_ROWS = (
    ("success", "success", 3),
    ("strict_success", "strict success", 3),
    ("crash_last_step", "crash at the last step", 3),
    ("contact", "contact", 3),
    ("contact_vehicle", "  with a vehicle", 3),
    ("contact_object", "  with an object", 3),
    ("out_of_road", "out of road", 3),
    ("max_step", "max step", 3),
    ("completion", "completion", 3),
    ("mean_length", "length, steps", 0),
    ("mean_speed_mps", "speed, m/s", 2),
)


@dataclass(frozen=True)
class Episode:
    """One episode. `outcome` is "arrived", "out_of_road", "max_step" or, if an option ends
    episodes at a contact, "driving". Contacts are counted in steps."""

    seed: int
    outcome: str
    steps: int
    completion: float
    driven_m: float
    vehicle_contacts: int
    object_contacts: int
    crash_last_step: bool

    @property
    def is_strict_success(self) -> bool:
        """Whether the car arrived without any contact."""
        return self.outcome == "arrived" and self.vehicle_contacts + self.object_contacts == 0


@dataclass(frozen=True)
class Estimate:
    """A mean with its 95 % confidence interval."""

    mean: float
    low: float
    high: float


def _share(hits: list[bool]) -> Estimate:
    """A share with Wilson's score interval."""
    n, count = len(hits), sum(hits)
    share, square = count / n, _Z * _Z / n
    middle = (share + square / 2.0) / (1.0 + square)
    half = _Z * math.sqrt(share * (1.0 - share) / n + square / (4.0 * n)) / (1.0 + square)
    return Estimate(share, middle - half if count else 0.0, middle + half if count < n else 1.0)


def _mean(values: list[float]) -> Estimate:
    """A mean with its bootstrap interval."""
    return Estimate(*_vlaps.mean_interval(values))


class Evaluation:
    """The figures of a driver; `str()` returns the table of `./vlaps eval`."""

    def __init__(self, driver: str, episodes: list[Episode], planning: list[tuple[int, int]]) -> None:
        self.driver = driver
        #: Sorted by seed.
        self.episodes = sorted(episodes, key=lambda episode: episode.seed)
        of = self.episodes
        contacts = [(one.vehicle_contacts > 0, one.object_contacts > 0) for one in of]
        #: Figures by their keys in the JSON of `./vlaps eval`.
        self.figures: dict[str, Estimate] = {
            "success": _share([one.outcome == "arrived" for one in of]),
            "strict_success": _share([one.is_strict_success for one in of]),
            "crash_last_step": _share([one.crash_last_step for one in of]),
            "contact": _share([any(pair) for pair in contacts]),
            "contact_vehicle": _share([pair[0] for pair in contacts]),
            "contact_object": _share([pair[1] for pair in contacts]),
            "out_of_road": _share([one.outcome == "out_of_road" for one in of]),
            "max_step": _share([one.outcome == "max_step" for one in of]),
            "completion": _mean([one.completion for one in of]),
            "mean_length": _mean([float(one.steps) for one in of]),
            "mean_speed_mps": _mean([one.driven_m / (max(one.steps, 1) * _STEP_S) for one in of]),
        }
        #: 99 % quantile of the planning times, us; None for drivers that do not plan.
        self.planning_p99_us = _quantile(planning, 0.99)

    def __getitem__(self, key: str) -> Estimate:
        if key not in self.figures:
            raise KeyError(f"no figure {key!r}; there are {', '.join(self.figures)}")
        return self.figures[key]

    def keys(self) -> list[str]:
        """The names of the figures."""
        return list(self.figures)

    def __repr__(self) -> str:
        return f"Evaluation({self.driver!r}: {len(self.episodes)} episodes, success {self['success'].mean:.3f})"

    def __str__(self) -> str:
        rows = [("", "mean", "95 %")]
        for key, name, digits in _ROWS:
            one = self.figures[key]
            interval = f"{one.low:.{digits}f} to {one.high:.{digits}f}"
            rows.append((name, f"{one.mean:.{digits}f}", interval if math.isfinite(one.low) else "-"))
        if self.planning_p99_us is not None:
            rows.append(("planning p99, us (wall clock)", str(self.planning_p99_us), ""))
        first, second, third = (max(len(row[column]) for row in rows) for column in range(3))
        rule = "─" * (first + second + third + 10)
        lines = [f"  {a:{first}}   {b:>{second}}   {c:>{third}}".rstrip() for a, b, c in rows]
        seeds = [one.seed for one in self.episodes]
        head = f"{self.driver} in the built-in world, {len(seeds)} episodes, seeds {seeds[0]} to {seeds[-1]}"
        return "\n".join([head, lines[0], rule, *lines[1:], rule, _FOOTNOTE])


def _quantile(classes: list[tuple[int, int]], share: float) -> int | None:
    """A quantile of a histogram: pairs of upper bound and count."""
    total = sum(count for _, count in classes)
    passed = 0
    for value, count in sorted(classes):
        passed += count
        if passed >= max(1, math.ceil(share * total)):
            return value
    return None


@dataclass(frozen=True)
class _Task:
    """The arguments of a process that drives some seeds."""

    driver: Any
    options: dict[str, Any]
    expert_config: dict[str, Any] | None
    threads: int


_Driven = tuple[list[Episode], list[tuple[int, int]]]


def _drive(task: _Task, seeds: list[int]) -> _Driven:
    if isinstance(task.driver, (str, Policy)):
        driver = task.driver.bytes if isinstance(task.driver, Policy) else task.driver
        episodes, planning = _vlaps.drive_seeds(
            driver,
            seeds,
            to_json(merged(task.options)),
            expert_json(task.expert_config),
            min(task.threads, len(seeds)),
        )
        return [Episode(*one) for one in episodes], planning
    answer = driving(task.driver)
    envs = MetaDriveVectorEnv(
        len(seeds), threads=task.threads, autoreset_mode="Disabled", **task.options
    )
    observations, info = envs.reset(seed=seeds)
    running = np.ones(len(seeds), np.bool_)
    while running.any():
        observations, _, terminated, truncated, info = envs.step(answer(envs, observations))
        running = ~(terminated | truncated)
    envs.close()
    return [_episode(info, index) for index in range(len(seeds))], []


def _episode(info: dict[str, Any], index: int) -> Episode:
    """Makes an episode from the figures of its last step."""
    outcomes = (("arrive_dest", "arrived"), ("out_of_road", "out_of_road"), ("max_step", "max_step"))
    reached = [outcome for flag, outcome in outcomes if info[flag][index]]
    touched = ("crash_vehicle", "crash_object", "crash_sidewalk")
    return Episode(
        seed=int(info["seed"][index]),
        outcome=reached[0] if reached else "driving",
        steps=int(info["episode_length"][index]),
        completion=float(info["route_completion"][index]),
        driven_m=float(info["driven_m"][index]),
        vehicle_contacts=int(info["vehicle_contacts"][index]),
        object_contacts=int(info["object_contacts"][index]),
        crash_last_step=any(bool(info[flag][index]) for flag in touched),
    )


def evaluate(
    driver: Any,
    seeds: Iterable[int] = range(1000, 1200),
    *,
    threads: int | None = None,
    processes: int = 1,
    ray: bool = False,
    expert_config: dict[str, Any] | None = None,
    quiet: bool = False,
    **options: Any,
) -> Evaluation:
    """Drives an episode of each seed, prints the table of `./vlaps eval`, and returns it.

    `driver` is an expert's name or "lane" (a lane keeper), a `Policy` or its file, a
    function from observations `[count, features]` to actions `[count, 2]`, a torch module,
    or a model of Stable-Baselines3. Names and policy files drive as in `./vlaps eval`, on
    `threads` threads. With `processes` above 1, or with `ray=True` (needs the package ray),
    processes or tasks of a Ray cluster share the episodes; a function must then be
    importable by name. Only the planning time depends on the number of threads, processes
    or nodes. `options` are those of the environment.
    """
    wanted = [whole("seed", seed) for seed in listed("seeds", seeds)]
    if not wanted:
        raise ValueError("no seeds: pass for example range(1000, 1200)")
    processes = whole("processes", processes, 1)
    threads = max(1, _cores() // processes) if threads is None else whole("threads", threads, 1)
    for option in ("start_seed", "num_scenarios", "shuffle", "order_seed", "autoreset_mode"):
        if option in options:
            raise ValueError(f"{option}: evaluate drives an episode of each of `seeds`; leave it out")
    name, driver = name_of(driver), loaded(driver)
    if isinstance(driver, str) and driver not in (*EXPERTS, "expert", "lane"):
        raise ValueError(f"driver {driver!r}: choose from {', '.join(EXPERTS)}, expert, lane, or FILE.onnx")
    lidar = merged(options)["vehicle_config"]["lidar"]
    if isinstance(driver, (str, Policy)) and (lidar["gaussian_noise"] or lidar["dropout_prob"]):
        raise ValueError("gaussian_noise and dropout_prob: experts and policy files drive without them")
    if isinstance(driver, Policy) and lidar["num_lasers"] != 240:
        raise ValueError(f"num_lasers = {lidar['num_lasers']}: a policy file drives with 240")
    task = _Task(driver, options, expert_config, threads)
    chunks = [wanted[start : start + CHUNK] for start in range(0, len(wanted), CHUNK)]
    if ray:
        driven = _on_ray(task, chunks)
    elif processes > 1:
        import multiprocessing

        with multiprocessing.get_context("spawn").Pool(min(processes, len(chunks))) as pool:
            driven = pool.starmap(_drive, [(task, chunk) for chunk in chunks], chunksize=1)
    else:
        driven = [_drive(task, chunk) for chunk in chunks]
    episodes = [one for part, _ in driven for one in part]
    evaluation = Evaluation(name, episodes, [one for _, part in driven for one in part])
    if not quiet:
        print(evaluation)
    return evaluation


def _on_ray(task: _Task, chunks: list[list[int]]) -> list[_Driven]:
    try:
        import ray
    except ImportError as error:
        raise ImportError("ray=True needs the package ray: pip install ray") from error
    if not ray.is_initialized():
        ray.init()
    remote = ray.remote(_drive).options(num_cpus=task.threads)
    shared = ray.put(task)
    driven: list[_Driven] = ray.get([remote.remote(shared, chunk) for chunk in chunks])
    return driven
