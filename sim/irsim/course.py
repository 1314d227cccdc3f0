"""Courses: a road of straights and bends between two walls, with static obstacles.

A course is drawn from the seed of an episode and fits a car: its width grows with the
car's width, its bends with the turning radius. Standard library alone.
"""

import math
import sys
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

# The modules of all worlds in Python; so programs import this one first.
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "foreign"))
from car import Car

#: Half of the road's width: this, and this many times the width of the car. A car of
#: 1:10 gets 3.3 m, as on tracks for such cars; the default car 10 m, as three lanes have.
HALF_WIDTH_M, HALF_WIDTHS = 1.0, 2.2
#: Radius of the tightest bend of the middle line, in turning radii and in half widths.
TURNING_RADII, BEND_HALF_WIDTHS = 3.0, 2.5
#: Bends of a course.
BENDS = 5
#: The road never turns farther than this from its first direction, so that it cannot
#: cross itself.
HEADING_MAX_RAD = math.radians(75)
#: Angles of the bends.
BEND_MIN_RAD, BEND_MAX_RAD = math.radians(25), math.radians(90)
#: The end of one chord of a wall in a bend, and of the next, are this far apart.
CHORD_RAD = math.radians(6)


@dataclass(frozen=True)
class Piece:
    """A straight, or an arc of less than half a turn, of the middle line."""

    x_m: float
    y_m: float
    heading_rad: float
    length_m: float
    #: Counter-clockwise.
    curvature_per_m: float

    @property
    def turn_rad(self) -> float:
        return self.curvature_per_m * self.length_m

    def at(self, along_m: float, left_m: float = 0.0) -> tuple[float, float, float]:
        """Position and heading so far along the piece, and so far to its left."""
        turn_rad = self.curvature_per_m * along_m
        half_rad = turn_rad / 2
        chord_m = along_m if turn_rad == 0 else along_m * math.sin(half_rad) / half_rad
        heading_rad = self.heading_rad + turn_rad
        x_m = self.x_m + chord_m * math.cos(self.heading_rad + half_rad)
        y_m = self.y_m + chord_m * math.sin(self.heading_rad + half_rad)
        return x_m - left_m * math.sin(heading_rad), y_m + left_m * math.cos(heading_rad), heading_rad

    def locate(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Distance along the piece, also before its begin and after its end, and offset
        to its left."""
        cos, sin = math.cos(self.heading_rad), math.sin(self.heading_rad)
        dx_m, dy_m = x_m - self.x_m, y_m - self.y_m
        ahead_m, left_m = cos * dx_m + sin * dy_m, cos * dy_m - sin * dx_m
        if self.curvature_per_m == 0:
            return ahead_m, left_m
        radius_m = 1 / abs(self.curvature_per_m)
        side = math.copysign(1, self.curvature_per_m)
        inwards_m = radius_m - side * left_m
        along_m = radius_m * math.atan2(ahead_m, inwards_m)
        return along_m, side * (radius_m - math.hypot(ahead_m, inwards_m))


@dataclass(frozen=True)
class Obstacle:
    """A static obstacle: a disc, or a square, of this half size."""

    x_m: float
    y_m: float
    heading_rad: float
    half_m: float
    is_disc: bool


@dataclass
class Course:
    """A road from `start_m` to `goal_m` along its pieces, and what stands on it."""

    pieces: list[Piece]
    half_width_m: float
    start_m: float
    goal_m: float = 0.0
    obstacles: list[Obstacle] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.begins_m = [0.0]
        for piece in self.pieces:
            self.begins_m.append(self.begins_m[-1] + piece.length_m)

    def at(self, along_m: float, left_m: float = 0.0) -> tuple[float, float, float]:
        """Position and heading so far along the road, and so far to its left."""
        k = max(k for k, begin_m in enumerate(self.begins_m[:-1]) if begin_m <= max(along_m, 0))
        return self.pieces[k].at(along_m - self.begins_m[k], left_m)

    def locate(self, x_m: float, y_m: float, near: int) -> tuple[int, float, float]:
        """The piece beside a place, of the piece `near` and its neighbours, and on the
        road the distance along it and the offset to its left."""
        best = (math.inf, near, 0.0, 0.0)
        for k in range(max(near - 1, 0), min(near + 2, len(self.pieces))):
            piece = self.pieces[k]
            along_m, left_m = piece.locate(x_m, y_m)
            within_m = min(max(along_m, 0.0), piece.length_m)
            beyond_m = abs(along_m - within_m)
            if beyond_m < best[0]:
                best = (beyond_m, k, self.begins_m[k] + within_m, left_m)
        return best[1:]

    def walls(self) -> list[list[tuple[float, float]]]:
        """The walls as polylines: left and right of each piece, so that a scan looks at
        the near ones alone."""
        found = []
        for piece in self.pieces:
            count = max(1, math.ceil(abs(piece.turn_rad) / CHORD_RAD))
            along_m = [piece.length_m * k / count for k in range(count + 1)]
            for left_m in (self.half_width_m, -self.half_width_m):
                found.append([piece.at(part_m, left_m)[:2] for part_m in along_m])
        return found


class _Road:
    """Pieces, one after the other."""

    def __init__(self) -> None:
        self.pieces: list[Piece] = []
        self.at = (0.0, 0.0, 0.0)

    def go(self, length_m: float, curvature_per_m: float = 0.0) -> None:
        piece = Piece(*self.at, length_m, curvature_per_m)
        self.pieces.append(piece)
        self.at = piece.at(length_m)


def _pieces(random: Random, radius_m: float) -> list[Piece]:
    """A straight, the bends with a straight after every other one, and a straight."""
    road = _Road()
    road.go(2.0 * radius_m)
    for bend in range(BENDS):
        turn_rad = random.uniform(BEND_MIN_RAD, BEND_MAX_RAD)
        side = 1.0 if random.random() < 0.5 else -1.0
        if abs(road.at[2] + side * turn_rad) > HEADING_MAX_RAD:
            side = -math.copysign(1.0, road.at[2])
        turn_rad = min(turn_rad, HEADING_MAX_RAD - side * road.at[2])
        bend_m = radius_m * random.uniform(1.0, 2.0)
        road.go(bend_m * turn_rad, side / bend_m)
        if bend % 2 == 0:
            road.go(radius_m * random.uniform(1.0, 2.5))
    road.go(5.0 * radius_m)
    return road.pieces


def draw(seed: int, car: Car) -> Course:
    """The course of a seed for a car."""
    random = Random(seed)
    half_m = HALF_WIDTH_M + HALF_WIDTHS * car.width_m
    radius_m = max(TURNING_RADII * car.turning_radius_m, BEND_HALF_WIDTHS * half_m)
    course = Course(_pieces(random, radius_m), half_m, start_m=car.length_m)
    # The road goes on after the goal, so that the car need not brake for its end.
    course.goal_m = course.begins_m[-1] - 2.5 * radius_m
    along_m = course.start_m + 2.0 * radius_m
    while along_m < course.goal_m - radius_m:
        side = 1.0 if random.random() < 0.5 else -1.0
        # Some stand in the middle, some beside it; there is always room for the car on
        # the other side: 0.88 of half the road at least.
        left_m = side * half_m * random.uniform(0.1, 0.5)
        size_m = half_m * random.uniform(0.12, 0.22)
        x_m, y_m, heading_rad = course.at(along_m, left_m)
        is_disc = random.random() < 0.5
        course.obstacles.append(Obstacle(x_m, y_m, heading_rad, size_m, is_disc))
        along_m += radius_m * random.uniform(2.0, 3.5)
    return course
