"""The episodes of a world in Python: a simulator gives scenes, this drives them in a run."""

import math
import os
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from car import ROOT, Scanner

# The module alone: the compiled part of the package is not needed.
_package = types.ModuleType("vlaps")
_package.__path__ = [str(ROOT / "python" / "vlaps")]
sys.modules["vlaps"] = _package
# The library that `./vlaps setup` has built, beside the environment of Python.
_built = Path(sys.prefix).parent / "release" / "libvlaps.so"
if _built.is_file():
    os.environ.setdefault("VLAPS_LIBRARY", str(_built))

import numpy as np
from route import Route
from vlaps import process

Pose = tuple[float, float, float]


class Scene(Protocol):
    """One episode in a simulator."""

    #: Length of what is to be driven, m.
    route_m: float
    speed_mps: float
    #: What the car touches, in words; empty for nothing. A contact ends the episode.
    touched: str
    #: Where the car is, in words, for the log.
    place: str
    arrives: bool
    #: Whether the simulator's own time for the episode is over.
    is_over: bool
    #: Share of the route that is driven.
    completion: float

    def advance(self, steer: float, pedal: float, step_s: float) -> None:
        """Moves the car; ends early when it touches something or arrives."""

    def observe(self, seen: Any) -> None:
        """What the car perceives, into an observation."""


def sub_step_s(period_s: float, longest_s: float) -> float:
    """The longest step up to `longest_s` that divides a period."""
    return period_s / math.ceil(period_s / longest_s - 1e-9)


def show_scan(seen: Any, scanner: Scanner, ranges_m: np.ndarray) -> None:
    """A scan, into an observation."""
    beams = int(scanner.beams)
    seen.lidar_max_m, seen.beam_count = scanner.range_m, beams
    seen.field_of_view_rad = scanner.field_of_view_rad
    seen.scanner_heading_rad = math.radians(scanner.heading_deg)
    seen.scanner_x_body_m, seen.scanner_y_body_m = scanner.x_m, scanner.y_m
    np.ctypeslib.as_array(seen.ranges_m)[:beams] = ranges_m


def show_road(seen: Any, route: Route, pose: Pose, along_m: float, left_m: float) -> None:
    """The road beside a place of a route, `left_m` to the left of its line, and the next
    checkpoints, into an observation."""
    to_left_m, to_right_m = route.edges(along_m)
    turned_rad = math.remainder(pose[2] - route.at(along_m)[2], math.tau)
    seen.road = process.Road(to_left_m - left_m, to_right_m + left_m, turned_rad, left_m)
    bends = {0: process.Bend.STRAIGHT, 1: process.Bend.LEFT, -1: process.Bend.RIGHT}
    for k, found in enumerate(route.checkpoints(pose, along_m)):
        shape = (found.radius_m, found.angle_rad, bends[found.side])
        seen.checkpoints[k] = process.Checkpoint(found.x_m, found.y_m, *shape)


def _outcome(scene: Scene, is_late: bool) -> int:
    """How the episode ends at this instant, if it does."""
    ends = process.Outcome
    if scene.touched:
        return ends.OUT_OF_ROAD
    if scene.arrives:
        return ends.ARRIVED
    return ends.MAX_STEP if is_late or scene.is_over else ends.DRIVING


def drive(run: "process.Member", begin: Callable[[int], Scene]) -> None:
    """Drives the episodes of a run; `begin` gives the scene of a seed."""
    run_hz = run.setting("run.rate_hz")
    horizon_s = run.setting("world.horizon_ticks") / run_hz
    seen, progress, elapsed_s = process.Observation(), process.Progress(), 0.0
    while tick := run.await_tick():
        if tick.begins:
            scene = begin(tick.seed)
            progress = process.Progress(route_m=scene.route_m)
            elapsed_s = 0.0
        else:
            scene.advance(tick.steer, tick.pedal, tick.step_s)
            elapsed_s += tick.step_s
            # Half a tick, since the sum is rounded.
            progress.outcome = _outcome(scene, elapsed_s > horizon_s - 0.5 / run_hz)
        if scene.touched:
            progress.object_contacts += 1
            print(f"seed {tick.seed}: touches {scene.touched} {scene.place}", flush=True)
        progress.completion = max(0.0, min(scene.completion, 1.0))
        progress.speed_mps = max(0.0, scene.speed_mps)
        scene.observe(seen)
        run.finish_tick(seen, progress)


def period_s(run: "process.Member") -> float:
    """Time between two instants of the world, s."""
    return 1 / (run.setting("world.rate_hz") or run.setting("run.rate_hz"))
