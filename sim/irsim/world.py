"""The world process on ir-sim: `./vlaps up --world ir-sim`.

ir-sim moves the car, scans, and says what it touches and where it arrives. The course
comes from the episode's seed, the car from the run's settings.
"""

import math
from typing import Any

# Loading ir-sim takes seconds, in which a process that has joined would count as silent.
from course import Piece, draw

from car import Car, Scanner
from episodes import drive, period_s, process, show_scan, sub_step_s
from route import from_pose
from scene import SUB_STEP_S, Scene


class Episode(Scene):
    """A scene that is driven in a run."""

    # ir-sim knows no end of time.
    is_over = False

    def checkpoint(self, piece: Piece) -> "process.Checkpoint":
        """The end of a piece, seen from the car."""
        end = piece.at(piece.length_m)
        found = process.Checkpoint(*from_pose(self.pose, *end[:2]))
        if piece.turn_rad != 0:
            # The bend is that of the left edge, since the road has no lanes.
            left_m = math.copysign(self.course.half_width_m, piece.turn_rad)
            found.bend_radius_m = 1 / abs(piece.curvature_per_m) - left_m
            found.bend_angle_rad = abs(piece.turn_rad)
            found.bend = process.Bend.LEFT if piece.turn_rad > 0 else process.Bend.RIGHT
        return found

    def observe(self, seen: Any) -> None:
        """What the car perceives, into an observation."""
        moves = (self.speed_mps, self.yaw_radps, self.steer, self.pedal)
        seen.ego = process.Ego(*self.pose, *moves)
        course, half_m, left_m = self.course, self.course.half_width_m, self.left_m
        road_rad = course.at(self.along_m)[2]
        turned_rad = math.remainder(self.pose[2] - road_rad, math.tau)
        seen.road = process.Road(half_m - left_m, half_m + left_m, turned_rad, left_m)
        for k in range(len(seen.checkpoints)):
            piece = course.pieces[min(self.piece + k, len(course.pieces) - 1)]
            seen.checkpoints[k] = self.checkpoint(piece)
        show_scan(seen, self.scanner, self.ranges_m())


def main() -> None:
    run = process.Member("world")
    car, scanner = Car.of(run.setting), Scanner.of(run.setting)
    step_s = sub_step_s(period_s(run), SUB_STEP_S)
    drive(run, lambda seed: Episode(draw(seed, car), car, scanner, seed, step_s))


if __name__ == "__main__":
    process.run(main)
