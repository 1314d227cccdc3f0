#!/usr/bin/env python3
"""Policies of VLAPS in highway-env, beside its own driver, a constant and a random action.

    ./vlaps setup python
    cargo build --release -p capi
    target/python/bin/pip install highway-env==1.12.1
    target/python/bin/python examples/python/highway/evaluate.py results/learning/ppl-50000.onnx

It needs Python 3.11 or later. Every driver drives the same seeds. `idm` is highway-env's
IDMVehicle (IDM and MOBIL) in the ego's place, `straight` the action [0, 0], `random` a
uniform action in each step. A column counts the episodes that ended so; *arrived* is the
goal, or in highway-fast and racetrack 40 s without an accident. The return is the sum of
highway-env's rewards times the step of 0.1 s. Results: results/highway.md.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import vlaps
from vlaps import process
from world import ENDS, GOALS, HZ, World


def drives(driver: str, seed: int) -> Callable[[World], tuple[float, float]]:
    """What a driver answers in the episode of a seed, as an action of highway-env."""
    if driver == "idm":
        return lambda world: world.env.vehicle.decide()
    if driver == "straight":
        return lambda world: (0.0, 0.0)
    if driver == "random":
        draws = np.random.default_rng(seed)
        return lambda world: tuple(draws.uniform(-1.0, 1.0, 2))
    policy = vlaps.Policy(driver)
    return lambda world: world.control(*map(float, policy(world.features())))


def drive(world: World, seed: int, driver: str) -> dict:
    """One episode: how it ended, its return, mean speed, m/s, and time, s."""
    answer = drives(driver, seed)
    world.reset(seed)
    if driver == "idm":
        world.put_own_driver()
    total, speeds_mps, ended = 0.0, [], ""
    while not ended:
        reward, ended = world.step(answer(world))
        total += float(reward) / HZ
        speeds_mps.append(world.env.vehicle.speed)
    figures = {"return": total, "speed_mps": float(np.mean(speeds_mps)), "time_s": len(speeds_mps) / HZ}
    return {"environment": world.name, "driver": driver, "seed": seed, "ended": ended, **figures}


def policy_file(path: str) -> str:
    """The path of a file that passes the controller's checks."""
    try:
        vlaps.Policy(path)
    except (OSError, ValueError) as error:
        raise argparse.ArgumentTypeError(f"{path}: {error}") from None
    return path


def row(episodes: list[dict]) -> str:
    """A row of the table."""
    counts = [sum(episode["ended"] == end for episode in episodes) for end in ENDS]
    speed, time, total = (np.mean([one[key] for one in episodes]) for key in ("speed_mps", "time_s", "return"))
    counted = " ".join(f"{count:>9}" for count in counts)
    name, driver = episodes[0]["environment"], Path(episodes[0]["driver"]).stem
    return f"{name:<16} {driver:<10} {counted} {speed:>10.1f} {time:>7.1f} {total:>7.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("policies", nargs="*", type=policy_file, metavar="FILE.onnx")
    parser.add_argument("--environment", action="append", choices=GOALS, help="repeatable; default: all")
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1000, help="seed of the first episode")
    parser.add_argument("--json", type=Path, help="writes a row for each episode")
    given = parser.parse_args()
    if given.episodes < 1:
        parser.error("argument --episodes: must be at least 1")
    try:
        process.Observation
    except ImportError as error:
        parser.error(str(error))
    print(f"{'environment':<16} {'driver':<10} {' '.join(f'{end:>9}' for end in ENDS)} speed, m/s time, s  return")
    driven = []
    for name in given.environment or GOALS:
        world = World(name)
        for driver in ["idm", "straight", "random", *given.policies]:
            seeds = range(given.seed, given.seed + given.episodes)
            episodes = [drive(world, seed, driver) for seed in seeds]
            print(row(episodes), flush=True)
            driven += episodes
    if given.json:
        given.json.write_text("".join(json.dumps(episode) + "\n" for episode in driven))


if __name__ == "__main__":
    main()
