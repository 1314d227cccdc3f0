"""A scene of ir-sim: a course with an Ackermann car, which ir-sim moves, scans and judges."""

import contextlib
import io
import math
import os
import tempfile
from collections import deque
from pathlib import Path

# One thread: beside the set there is no core for more, and the arrays are small.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

# It reports on standard output which windows it cannot open; it opens none here.
with contextlib.redirect_stdout(io.StringIO()):
    import irsim
import matplotlib.pyplot as plt
import numpy as np
import yaml
from course import Course

from car import Car, Scanner

#: A step of ir-sim, s, at most: its step is an Euler step, and its steering takes effect
#: one step late.
SUB_STEP_S = 0.02


def lidar_of(car: Car, scanner: Scanner) -> dict:
    """The scanner for ir-sim, whose places are relative to the middle of the rear axle."""
    beams, field_rad = int(scanner.beams), scanner.field_of_view_rad
    heading_rad = math.radians(scanner.heading_deg)
    is_circle = field_rad >= math.tau
    # ir-sim spreads the beams from one end of its range to the other, which on a circle
    # would be the same direction: there the first beam looks along the heading and the
    # last is one gap before it.
    span_rad = field_rad * (beams - 1) / beams if is_circle else field_rad
    span_rad = 0.0 if beams == 1 else span_rad
    turn_rad = span_rad / 2 if is_circle else 0.0
    return {
        "name": "lidar2d",
        "number": beams,
        "range_min": 0.0,
        "range_max": scanner.range_m,
        "angle_range": span_rad,
        "offset": [car.wheelbase_m / 2 + scanner.x_m, scanner.y_m, heading_rad + turn_rad],
    }


def _shape_of(half_m: float, is_disc: bool) -> dict:
    if is_disc:
        return {"name": "circle", "radius": half_m}
    return {"name": "rectangle", "length": 2 * half_m, "width": 2 * half_m}


def world_of(course: Course, car: Car, step_s: float, robot: dict) -> dict:
    """The configuration of ir-sim for a course; `robot` adds sensors, goals, behaviour."""
    places = [place for wall in course.walls() for place in wall]
    low_m = [min(place[axis] for place in places) - course.half_width_m for axis in (0, 1)]
    high_m = [max(place[axis] for place in places) + course.half_width_m for axis in (0, 1)]
    x_m, y_m, heading_rad = course.at(course.start_m)
    back_m = car.wheelbase_m / 2
    rear = [x_m - back_m * math.cos(heading_rad), y_m - back_m * math.sin(heading_rad)]
    return {
        "world": {
            "width": high_m[0] - low_m[0],
            "height": high_m[1] - low_m[1],
            "offset": low_m,
            "step_time": step_s,
            # A car that touches something stops for good: the episode is over.
            "collision_mode": "stop",
            "control_mode": "auto",
        },
        "robot": [
            {
                "kinematics": {"name": "acker"},
                "shape": {
                    "name": "rectangle",
                    "length": car.length_m,
                    "width": car.width_m,
                    "wheelbase": car.wheelbase_m,
                },
                "state": [*rear, heading_rad, 0.0],
                "goal_threshold": course.half_width_m,
                "vel_min": [0.0, -car.max_steer_rad],
                "vel_max": [car.max_speed_mps, car.max_steer_rad],
                # ir-sim has one limit for both directions; the weaker is the world's.
                "acce": [max(car.max_accel_mps2, car.max_brake_mps2), math.inf],
                **robot,
            }
        ],
        "obstacle": [
            {
                "shape": _shape_of(obstacle.half_m, obstacle.is_disc),
                "state": [obstacle.x_m, obstacle.y_m, obstacle.heading_rad],
            }
            for obstacle in course.obstacles
        ]
        + [
            {
                "shape": {"name": "linestring", "vertices": [list(place) for place in wall]},
                "state": [0.0, 0.0, 0.0],
            }
            for wall in course.walls()
        ],
    }


def environment(world: dict, seed: int) -> irsim.EnvBase:
    """The environment of ir-sim for a configuration, which ir-sim reads from a file."""
    plt.close("all")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "course.yaml"
        path.write_text(yaml.safe_dump(world))
        options = {"display": False, "disable_all_plot": True, "log_level": "ERROR"}
        return irsim.make(str(path), seed=seed % 2**32, **options)


class Scene:
    """An episode: the course of a seed, and the car on it."""

    def __init__(self, course: Course, car: Car, scanner: Scanner, seed: int, step_s: float) -> None:
        self.course, self.car, self.scanner, self.step_s = course, car, scanner, step_s
        goal = list(course.at(course.goal_m))
        robot = {"sensors": [lidar_of(car, scanner)], "goal": goal}
        self.environment = environment(world_of(course, car, step_s, robot), seed)
        self.robot = self.environment.robot
        self.drops = np.random.default_rng(seed)
        # The actions that are on their way, one for each step of the delay. That of the
        # wheels is one step shorter, because ir-sim turns them a step late.
        steps = round(car.delay_ms / 1e3 / step_s)
        self.pedals = deque([0.0] * steps)
        self.steers = deque([0.0] * max(steps - 1, 0))
        self.speed_mps = self.yaw_radps = self.steer = self.pedal = 0.0
        self.piece, self.along_m, self.left_m = 0, course.start_m, 0.0
        self.robot.sensor_step()

    @property
    def touches(self) -> bool:
        """Whether the car touches a wall or an obstacle, as ir-sim says."""
        return bool(self.robot.collision_flag)

    @property
    def touched(self) -> str:
        """What it touches, in words; empty for nothing."""
        if not self.touches:
            return ""
        shapes = [touched.shape for touched in self.robot.collision_obj]
        return "a wall" if "linestring" in shapes else "an obstacle"

    @property
    def arrives(self) -> bool:
        """Whether the car is at the goal, as ir-sim says."""
        return bool(self.robot.arrive_flag)

    @property
    def pose(self) -> tuple[float, float, float]:
        """The middle of the body, and the heading."""
        x_m, y_m, heading_rad = (float(number) for number in self.robot.state[:3, 0])
        ahead_m = self.car.wheelbase_m / 2
        return x_m + ahead_m * math.cos(heading_rad), y_m + ahead_m * math.sin(heading_rad), heading_rad

    def advance(self, steer: float, pedal: float, step_s: float) -> None:
        """Moves the car; ends early when it touches something or arrives."""
        heading_rad = self.pose[2]
        count = max(1, round(step_s / self.step_s))
        for k in range(count):
            velocity = self._velocity(steer, pedal)
            if k + 1 == count:
                # The whole of ir-sim: car, scan, flags.
                self.environment.step(velocity)
            else:
                # What stands on the course does not move, so its tree stays.
                self.robot.step(velocity, sensor_step=False)
                self.robot.check_status()
            if self.touches or self.arrives:
                break
        x_m, y_m, after_rad = self.pose
        turn_rad = math.remainder(after_rad - heading_rad, math.tau)
        self.yaw_radps = turn_rad / (count * self.step_s)
        self.piece, self.along_m, self.left_m = self.course.locate(x_m, y_m, self.piece)

    def _velocity(self, steer: float, pedal: float) -> np.ndarray:
        """The speed and the angle of the wheels that ir-sim is given for its next step."""
        car = self.car
        self.steers.append(max(-1.0, min(1.0, steer)))
        self.pedals.append(max(-1.0, min(1.0, pedal)))
        self.steer, self.pedal = self.steers.popleft(), self.pedals.popleft()
        most_mps2 = car.max_brake_mps2 if self.pedal < 0 else car.max_accel_mps2
        speed_mps = self.speed_mps + self.pedal * most_mps2 * self.step_s
        self.speed_mps = max(0.0, min(car.max_speed_mps, speed_mps))
        return np.array([[self.speed_mps], [self.steer * car.max_steer_rad]])

    def ranges_m(self) -> np.ndarray:
        """ir-sim's scan; a dropped return shows the full range."""
        ranges_m = np.array(self.robot.get_lidar_scan()["ranges"])
        lost = self.drops.random(len(ranges_m)) < self.scanner.drop_probability
        return np.where(lost, self.scanner.range_m, ranges_m)

    @property
    def route_m(self) -> float:
        """Length of the course from start to goal, m."""
        return self.course.goal_m - self.course.start_m

    @property
    def place(self) -> str:
        """Where the car is, in words."""
        return f"at {self.along_m:.1f} m"

    @property
    def completion(self) -> float:
        """Share of the course that is driven."""
        return (self.along_m - self.course.start_m) / self.route_m
