"""The world process on ir-sim: `./vlaps up --world ir-sim`.

ir-sim moves the car, scans, and says what it touches and where it arrives. The course
comes from the episode's seed, the car from the run's settings.
"""

import math
import os
import sys
import types
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# The module alone: the compiled part of the package is not needed.
package = types.ModuleType("vlaps")
package.__path__ = [str(ROOT / "python" / "vlaps")]
sys.modules["vlaps"] = package
# The library that `./vlaps setup ir-sim` has built, beside the environment of Python.
built = Path(sys.prefix).parent / "release" / "libvlaps.so"
if built.is_file():
    os.environ.setdefault("VLAPS_LIBRARY", str(built))

# Loading ir-sim takes seconds, in which a process that has joined would count as silent.
import numpy as np
from car import Car, Scanner
from course import Piece, draw
from scene import Scene, sub_step_s
from vlaps import process


def checkpoint(scene: Scene, piece: Piece) -> "process.Checkpoint":
    """The end of a piece, seen from the car."""
    x_m, y_m, heading_rad = scene.pose
    end_x_m, end_y_m, _ = piece.at(piece.length_m)
    dx_m, dy_m = end_x_m - x_m, end_y_m - y_m
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    found = process.Checkpoint(cos * dx_m + sin * dy_m, cos * dy_m - sin * dx_m)
    if piece.turn_rad != 0:
        # The bend is that of the left edge, since the road has no lanes.
        left_m = math.copysign(scene.course.half_width_m, piece.turn_rad)
        found.bend_radius_m = 1 / abs(piece.curvature_per_m) - left_m
        found.bend_angle_rad = abs(piece.turn_rad)
        found.bend = process.Bend.LEFT if piece.turn_rad > 0 else process.Bend.RIGHT
    return found


def observe(scene: Scene, seen: "process.Observation") -> None:
    """What the car perceives, into a message."""
    x_m, y_m, heading_rad = scene.pose
    moves = (scene.speed_mps, scene.yaw_radps, scene.steer, scene.pedal)
    seen.ego = process.Ego(x_m, y_m, heading_rad, *moves)
    course, scanner = scene.course, scene.scanner
    half_m, left_m = course.half_width_m, scene.left_m
    road_rad = course.at(scene.along_m)[2]
    turned_rad = math.remainder(heading_rad - road_rad, math.tau)
    seen.road = process.Road(half_m - left_m, half_m + left_m, turned_rad, left_m)
    for k in range(len(seen.checkpoints)):
        piece = course.pieces[min(scene.piece + k, len(course.pieces) - 1)]
        seen.checkpoints[k] = checkpoint(scene, piece)
    beams = int(scanner.beams)
    seen.lidar_max_m, seen.beam_count = scanner.range_m, beams
    seen.field_of_view_rad = scanner.field_of_view_rad
    seen.scanner_heading_rad = math.radians(scanner.heading_deg)
    seen.scanner_x_body_m, seen.scanner_y_body_m = scanner.x_m, scanner.y_m
    np.ctypeslib.as_array(seen.ranges_m)[:beams] = scene.ranges_m()


def outcome(scene: Scene, is_late: bool) -> int:
    """How the episode ends at this instant, if it does."""
    ends = process.Outcome
    # ir-sim holds what touches a wall or an obstacle for good.
    if scene.touches:
        return ends.OUT_OF_ROAD
    if scene.arrives:
        return ends.ARRIVED
    return ends.MAX_STEP if is_late else ends.DRIVING


def main() -> None:
    run = process.Member("world")
    car, scanner = Car.of(run.setting), Scanner.of(run.setting)
    run_hz = run.setting("run.rate_hz")
    step_s = sub_step_s(1 / (run.setting("world.rate_hz") or run_hz))
    horizon_s = run.setting("world.horizon_ticks") / run_hz
    seen, progress, elapsed_s = process.Observation(), process.Progress(), 0.0
    while tick := run.await_tick():
        if tick.begins:
            course = draw(tick.seed, car)
            scene = Scene(course, car, scanner, tick.seed, step_s)
            progress = process.Progress(route_m=course.goal_m - course.start_m)
            elapsed_s = 0.0
        else:
            scene.advance(tick.steer, tick.pedal, tick.step_s)
            elapsed_s += tick.step_s
            # Half a tick, since the sum is rounded.
            is_late = elapsed_s > horizon_s - 0.5 / run_hz
            progress.outcome = outcome(scene, is_late)
        if scene.touches:
            progress.object_contacts += 1
            print(f"seed {tick.seed}: touches {scene.touched} at {scene.along_m:.1f} m", flush=True)
        progress.completion = max(0.0, min(scene.completion, 1.0))
        progress.speed_mps = scene.speed_mps
        observe(scene, seen)
        run.finish_tick(seen, progress)


if __name__ == "__main__":
    process.run(main)
