"""Roads with a middle line: where the car is on one, and the next two checkpoints.

As `robot::route` does for robots in Rust. A checkpoint here is as far ahead as one arc
follows the line, so a straight has a far one and a tight corner a near one.
"""

import math
from dataclasses import dataclass

import numpy as np

#: Distances at which a checkpoint may be, m: each 1.4 times the one before it, from more
#: than the 1 m within which the planner counts one as passed to farther than it looks.
REACHES_M = [1.5 * 1.4**k for k in range(12)]
#: An arc may leave the line by this share of half the road's width.
LEAVES = 0.1
#: A piece of road turns by less: its end has to be ahead.
TURN_MAX_RAD = math.radians(120)
#: Roads that turn by less are straight.
STRAIGHT_RAD = 0.02
#: A bend whose inner edge is a corner has this radius, m.
RADIUS_MIN_M = 0.1
#: How far from its last place along the route a car is looked for, m: a route may come
#: near to itself.
NEAR_M = 20.0


@dataclass(frozen=True)
class Checkpoint:
    """The end of a piece of the road, seen from the car."""

    x_m: float
    y_m: float
    #: Of the left edge.
    radius_m: float
    angle_rad: float
    #: 1 for a bend to the left, -1 for one to the right, 0 for a straight.
    side: int


def from_pose(pose: tuple, x_m: float | np.ndarray, y_m: float | np.ndarray) -> tuple:
    """A place, or several, in the frame of a pose."""
    dx_m, dy_m = x_m - pose[0], y_m - pose[1]
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    return cos * dx_m + sin * dy_m, cos * dy_m - sin * dx_m


class Route:
    """A road along rows of places (n, 2), with the distances to its edges there, m."""

    def __init__(self, places: np.ndarray, left_m: np.ndarray, right_m: np.ndarray, is_closed: bool) -> None:
        if is_closed:
            places = np.vstack([places, places[:1]])
            left_m, right_m = np.append(left_m, left_m[0]), np.append(right_m, right_m[0])
        self.places, self.left_m, self.right_m, self.is_closed = places, left_m, right_m, is_closed
        ways = np.diff(places, axis=0)
        self.gaps_m = np.hypot(*ways.T)
        self.along_m = np.concatenate([[0.0], np.cumsum(self.gaps_m)])
        self.length_m = float(self.along_m[-1])
        self.ways = ways / self.gaps_m[:, None]
        headings_rad = np.unwrap(np.arctan2(ways[:, 1], ways[:, 0]))
        # At a row, between those of its two segments.
        before, after = headings_rad[:1], headings_rad[-1:]
        if is_closed:
            turns = round((headings_rad[-1] - headings_rad[0]) / math.tau) * math.tau
            before, after = headings_rad[-1:] - turns, headings_rad[:1] + turns
        self.headings_rad = (np.concatenate([before, headings_rad]) + np.concatenate([headings_rad, after])) / 2

    def within(self, along_m: np.ndarray | float) -> np.ndarray | float:
        """A distance along the route within its length."""
        return along_m % self.length_m if self.is_closed else np.clip(along_m, 0.0, self.length_m)

    def at(self, along_m: float) -> tuple[float, float, float]:
        """Place and heading of the line so far along it."""
        along_m = self.within(along_m)
        columns = (self.places[:, 0], self.places[:, 1], self.headings_rad)
        x_m, y_m, heading_rad = (float(np.interp(along_m, self.along_m, column)) for column in columns)
        return x_m, y_m, heading_rad

    def edges(self, along_m: float) -> tuple[float, float]:
        """Distances from the line to the left and the right edge, m."""
        along_m = self.within(along_m)
        columns = (self.left_m, self.right_m)
        left_m, right_m = (float(np.interp(along_m, self.along_m, column)) for column in columns)
        return left_m, right_m

    def locate(self, x_m: float, y_m: float, last_m: float | None = None) -> tuple[float, float]:
        """The nearest place of the route: distance along it, and offset to the left. With
        the distance along it of a moment ago only the road near that is looked at."""
        beside = np.array([x_m, y_m]) - self.places[:-1]
        ahead_m = np.clip(np.sum(beside * self.ways, axis=1), 0.0, self.gaps_m)
        away_m = np.hypot(*(beside - self.ways * ahead_m[:, None]).T)
        along_m = self.along_m[:-1] + ahead_m
        if last_m is not None:
            far_m = np.abs(along_m - last_m)
            if self.is_closed:
                far_m = np.minimum(far_m, self.length_m - far_m)
            if np.any(far_m < NEAR_M):
                away_m = np.where(far_m < NEAR_M, away_m, np.inf)
        k = int(np.argmin(away_m))
        left_m = self.ways[k, 0] * beside[k, 1] - self.ways[k, 1] * beside[k, 0]
        return float(along_m[k]), math.copysign(float(away_m[k]), left_m)

    def _follows(self, along_m: float, reach_m: float) -> bool:
        """Whether one arc from a place on the line to one farther on stays beside the line."""
        start = self.at(along_m)
        parts_m = along_m + np.linspace(0.0, reach_m, max(4, math.ceil(reach_m)))
        parts_m = self.within(parts_m)
        x_m = np.interp(parts_m, self.along_m, self.places[:, 0])
        y_m = np.interp(parts_m, self.along_m, self.places[:, 1])
        ahead_m, left_m = from_pose(start, x_m, y_m)
        if 2 * abs(math.atan2(left_m[-1], ahead_m[-1])) > TURN_MAX_RAD:
            return False
        curvature_per_m = 2 * left_m[-1] / (ahead_m[-1] ** 2 + left_m[-1] ** 2)
        if abs(curvature_per_m) < 1e-6:
            leaves_m = np.abs(left_m)
        else:
            radius_m = 1 / curvature_per_m
            leaves_m = np.abs(np.hypot(ahead_m, left_m - radius_m) - abs(radius_m))
        return bool(leaves_m.max() <= LEAVES * sum(self.edges(along_m)) / 2)

    def reach_m(self, along_m: float) -> float:
        """How far ahead the next checkpoint of a place on the line is."""
        left_m = math.inf if self.is_closed else self.length_m - self.within(along_m)
        reaches_m = [reach_m for reach_m in REACHES_M if reach_m < left_m]
        if left_m < REACHES_M[-1]:
            reaches_m.append(left_m)
        for reach_m in reversed(reaches_m):
            if reach_m > REACHES_M[0] and self._follows(along_m, reach_m):
                return reach_m
        return min(REACHES_M[0], left_m)

    def checkpoints(self, pose: tuple[float, float, float], along_m: float) -> list[Checkpoint]:
        """The next two, seen from a pose beside this place of the line."""
        found, left_m = [], self.edges(along_m)[0]
        for _ in range(2):
            start = self.at(along_m)
            along_m += self.reach_m(along_m)
            x_m, y_m, _ = self.at(along_m)
            found.append(_checkpoint(start, pose, (x_m, y_m), left_m))
        return found


def _checkpoint(start: tuple, pose: tuple, place: tuple, left_m: float) -> Checkpoint:
    """The end of the arc from a pose of the line to a place, seen from the car."""
    ahead_m, beside_m = from_pose(start, *place)
    x_m, y_m = from_pose(pose, *place)
    turn_rad = 2 * math.atan2(beside_m, ahead_m)
    # At the end of a road the place is the pose, and the sign of its zeros says nothing.
    if abs(turn_rad) < STRAIGHT_RAD or start[:2] == place:
        return Checkpoint(x_m, y_m, 0.0, 0.0, 0)
    side = 1 if beside_m > 0 else -1
    middle_m = (ahead_m**2 + beside_m**2) / (2 * abs(beside_m))
    return Checkpoint(x_m, y_m, max(middle_m - side * left_m, RADIUS_MIN_M), abs(turn_rad), side)
