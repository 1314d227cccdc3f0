"""Speed of the environments through Python beside the Rust batch and the real MetaDrive.

    ./vlaps setup python
    target/python/bin/python python/benchmarks/speed.py --json speed.json

All ways drive the same seeds with the same recorded actions of IDM, with 240 beams, traffic,
obstacles and resets, and alternate every few milliseconds; at the end their observations are
compared. A speed or ratio is the median of the rounds, with the least and the most. Speeds
and ratios on one thread count processor time, those of several threads the wall clock,
which only means something while nothing else runs. MetaDrive drives in the same run if
`./vlaps setup metadrive` has made its environment.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
import timeit
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import vlaps
from vlaps import _vlaps
from vlaps.config import merged, to_json

ROOT = Path(os.environ.get("VLAPS_CHECKOUT", Path(__file__).resolve().parents[2]))
#: Ticks of a round, and of a turn in it. Episodes of 300 to 700 ticks begin and end in each.
TICKS, TURN = 600, 20
#: Ticks of a single environment for each tick of the batch.
SINGLE_TICKS = 25
FIRST_SEED = 1000
OPTIONS: dict[str, Any] = {"start_seed": FIRST_SEED, "num_scenarios": 50_000}
#: Names of the ways, as the bars below use them.
ALONE, RUST, PYTHON, COPIED = "Rust, world by world", "Rust batch", "Python batch, copy=False", "Python batch"
SINGLE, METADRIVE = "one environment through Python", "MetaDrive, one core"

Drive = Callable[[NDArray[np.float32]], None]


class Way:
    """One way to drive the worlds, and its times."""

    def __init__(self, name: str, threads: int, reset: Callable[[], object], drive: Drive) -> None:
        self.name, self.threads, self.reset, self.drive = name, threads, reset, drive
        self.core_s: list[float] = []
        self.wall_s: list[float] = []

    def begin(self) -> None:
        """Begins a round."""
        self.reset()
        self.core_s.append(0.0)
        self.wall_s.append(0.0)

    def turn(self, actions: NDArray[np.float32]) -> None:
        """Drives some ticks."""
        wall, core = time.perf_counter(), time.process_time()
        self.drive(actions)
        self.core_s[-1] += time.process_time() - core
        self.wall_s[-1] += time.perf_counter() - wall


def recorded(worlds: int, ticks: int = TICKS) -> NDArray[np.float32]:
    """IDM's actions, `[ticks, worlds, 2]`."""
    envs = vlaps.MetaDriveVectorEnv(worlds, autoreset_mode="SameStep", copy=False, **OPTIONS)
    envs.reset()
    actions = np.empty((ticks, worlds, 2), np.float32)
    for tick in actions:
        tick[:] = envs.expert("idm")
        envs.step(tick)
    return actions


def rust(name: str, worlds: int, threads: int) -> tuple[Way, Callable[[], NDArray[np.float32]]]:
    """The worlds without Python; 0 threads drive them one by one."""
    batch = _vlaps.RustBatch(to_json(merged(OPTIONS)), worlds, threads)
    return Way(name, max(threads, 1), batch.reset, batch.drive), batch.observations


def begin(envs: vlaps.MetaDriveVectorEnv | vlaps.MetaDriveEnv) -> NDArray[np.float32]:
    """Begins the order of seeds again: a seed puts it back, and the next reset begins it."""
    envs.reset(seed=FIRST_SEED)
    return envs.reset()[0]


def python(name: str, worlds: int, threads: int, copy: bool) -> tuple[Way, Callable[[], NDArray[np.float32]]]:
    """The worlds as a vector environment."""
    envs = vlaps.MetaDriveVectorEnv(worlds, threads=threads, autoreset_mode="SameStep", copy=copy, **OPTIONS)
    seen = begin(envs)

    def drive(actions: NDArray[np.float32]) -> None:
        nonlocal seen
        for tick in actions:
            seen = envs.step(tick)[0]

    return Way(name, threads, lambda: begin(envs), drive), lambda: seen


def single() -> Way:
    """One environment, without the wrappers of `gymnasium.make`."""
    env = vlaps.MetaDriveEnv(**OPTIONS)
    actions = recorded(1, TICKS * SINGLE_TICKS)[:, 0]
    rest = iter(actions)

    def reset() -> None:
        nonlocal rest
        begin(env)
        rest = iter(actions)

    def drive(ticks: NDArray[np.float32]) -> None:
        for action in islice(rest, len(ticks) * SINGLE_TICKS):
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()

    return Way(SINGLE, 1, reset, drive)


def call_us(worlds: int, copy: bool) -> list[float]:
    """Time of a call on worlds whose episodes have ended, so that none takes a step."""
    envs = vlaps.MetaDriveVectorEnv(worlds, threads=1, autoreset_mode="Disabled", copy=copy, horizon=1)
    envs.reset(seed=0)
    still = np.zeros((worlds, 2), np.float32)
    envs.step(still)
    calls = 20_000 // worlds + 500
    return [1e6 * one / calls for one in timeit.repeat(lambda: envs.step(still), number=calls, repeat=9)]


def metadrive(seconds: float) -> float | None:
    """Steps a core-second of the real MetaDrive with a lane keeper, resets included."""
    interpreter = ROOT / "target/metadrive/bin/python"
    if not interpreter.is_file():
        print("MetaDrive left out: ./vlaps setup metadrive makes its environment", file=sys.stderr)
        return None
    world = {"sequence": "", "blocks": 3, "lanes": 3, "lane_width_m": 3.5}
    world |= {"traffic_density": 0.06, "accident_probability": 0.8, "horizon_ticks": 1500}
    scanner = {"beams": 240, "range_m": 50.0}
    task = {"world": world, "scanner": scanner, "first_seed": FIRST_SEED, "seconds": seconds}
    command: list[str | Path] = [interpreter, ROOT / "bench/metadrive_speed.py"]
    command += [ROOT / "sim/metadrive", json.dumps(task)]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    measured = json.loads(printed.splitlines()[-1])
    return float(measured["steps"] / measured["core_s"])


def spread(values: list[float]) -> dict[str, float]:
    """Median, least and most."""
    return {"median": statistics.median(values), "least": min(values), "most": max(values)}


def shown(values: dict[str, float], digits: int) -> str:
    """The same as text."""
    median, least, most = (f"{values[name]:,.{digits}f}" for name in ("median", "least", "most"))
    return f"{median} ({least} to {most})"


def measure(worlds: int, threads: int, rounds: int) -> dict[str, Way]:
    """Drives all ways by turns; checks that they drive the same."""
    actions = recorded(worlds)
    made = [rust(ALONE, worlds, 0)]
    for count in sorted({1, threads}):
        suffix = "" if count == 1 else f", {count} threads"
        made += [rust(RUST + suffix, worlds, count), python(PYTHON + suffix, worlds, count, False)]
        made += [python(COPIED + suffix, worlds, count, True)]
    ways = [way for way, _ in made] + [single()]
    for number in range(rounds + 1):
        for way in ways:
            way.begin()
        for turn in range(0, TICKS, TURN):
            # Who begins changes, so that what one leaves in the caches meets all the others.
            first = (number + turn // TURN) % len(ways)
            for way in ways[first:] + ways[:first]:
                way.turn(actions[turn : turn + TURN])
        if number == 0:
            # The first round fills the caches.
            for way in ways:
                way.core_s.clear()
                way.wall_s.clear()
    for way, observations in made[1:]:
        if not np.array_equal(observations(), made[0][1]()):
            sys.exit(f"{way.name}: drives otherwise than {ALONE}")
    return {way.name: way for way in ways}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", type=int, default=256, help="worlds of the batches")
    parser.add_argument("--threads", type=int, default=min(2, len(os.sched_getaffinity(0))))
    parser.add_argument("--rounds", type=int, default=9, help="rounds; each drives all ways")
    parser.add_argument("--json", type=Path, help="write the figures to this file, too")
    arguments = parser.parse_args()
    worlds, threads = arguments.worlds, arguments.threads
    ways = measure(worlds, threads, arguments.rounds)
    steps = {name: TICKS * (SINGLE_TICKS if name == SINGLE else worlds) for name in ways}
    core = {name: spread([steps[name] / one for one in way.core_s]) for name, way in ways.items()}
    wall = {name: spread([steps[name] / one for one in way.wall_s]) for name, way in ways.items()}
    print(f"{worlds} worlds, 240 beams, traffic, resets; {arguments.rounds} rounds of {TICKS} ticks, {len(os.sched_getaffinity(0))} cores")
    print(f"{'ego-steps a second':34} {'of one core':34} by the wall clock")
    for name in ways:
        print(f"{name:34} {shown(core[name], 0):34} {shown(wall[name], 0)}")

    def ratio(over: str, under: str, clock: str = "core_s") -> dict[str, float]:
        pairs = zip(getattr(ways[over], clock), getattr(ways[under], clock))
        return spread([steps[over] * b / (steps[under] * a) for a, b in pairs])

    bars = [
        ("Python batch over Rust batch, one thread", ratio(PYTHON, RUST), 0.95, 2),
        ("the same with copies, the default", ratio(COPIED, RUST), None, 2),
        ("Python batch over world by world in Rust", ratio(PYTHON, ALONE), 0.9, 2),
        ("Rust batch over world by world in Rust", ratio(RUST, ALONE), None, 2),
        ("Python batch, a core-second", core[PYTHON], 200_000, 0),
        ("one environment, a core-second", core[SINGLE], 100_000, 0),
    ]
    if threads > 1:
        suffix = f", {threads} threads"
        bars.insert(1, (f"the same on {threads} threads", ratio(PYTHON + suffix, RUST + suffix, "wall_s"), 0.95, 2))
        bars.append((f"{threads} threads over one", ratio(PYTHON + suffix, PYTHON, "wall_s"), 0.9 * threads, 2))
    if (rate := metadrive(10.0)) is not None:
        print(f"{METADRIVE:34} {rate:,.0f}")
        times = {name: value / rate for name, value in core[PYTHON].items()}
        bars.append(("Python batch over MetaDrive", times, 500, 0))
    for count, copy in ((1, False), (1, True), (worlds, False), (worlds, True)):
        # A call on many worlds also goes through them, which is no cost beside their steps.
        bar = 2.0 if count == 1 else None
        bars.append((f"a call, {count} worlds, copy={copy}, us", spread(call_us(count, copy)), bar, 1))
    for what, values, bar, digits in bars:
        is_time = what.endswith("us")
        met = "" if bar is None else "met" if (values["median"] <= bar) == is_time else "MISSED"
        text = "" if bar is None else f"bar {'at most' if is_time else 'at least'} {bar:,}: {met}"
        print(f"{what:42} {shown(values, digits):32} {text}")
    if arguments.json:
        rows = {what: {**values, "bar": bar} for what, values, bar, _ in bars}
        figures = {"core_second": core, "wall_second": wall, "bars": rows, "cores": os.cpu_count()}
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
