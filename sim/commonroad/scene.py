"""A scene of CommonRoad: a car among recorded traffic, which CommonRoad's models move and judge."""

import math
from collections import deque

import numpy as np
from problem import Pose, Problem, Unusable
from vehiclemodels.vehicle_dynamics_ks import vehicle_dynamics_ks
from vehiclemodels.vehicle_parameters import VehicleParameters

from car import Car, Scanner

#: A step of the car's dynamics, s, at most.
SUB_STEP_S = 0.02
#: Time that the car has after the last instant of the goal, s.
GRACE_S = 20.0


def parameters(car: Car) -> VehicleParameters:
    """The car for CommonRoad's kinematic single-track model. A vehicle file has no limit of
    how fast the wheels turn."""
    made = VehicleParameters()
    made.l, made.w, made.a, made.b = car.length_m, car.width_m, 0.0, car.wheelbase_m
    made.steering.min, made.steering.max = -car.max_steer_rad, car.max_steer_rad
    made.steering.v_min, made.steering.v_max = -math.inf, math.inf
    made.longitudinal.v_min, made.longitudinal.v_max = 0.0, car.max_speed_mps
    made.longitudinal.v_switch = car.max_speed_mps
    # One limit for both directions; the pedal has the two of the vehicle file.
    made.longitudinal.a_max = max(car.max_accel_mps2, car.max_brake_mps2)
    return made


def ranges_m(origin: np.ndarray, angles_rad: np.ndarray, sides: np.ndarray, most_m: float) -> np.ndarray:
    """Distance from a place to the nearest side (n, 2, 2) in each direction."""
    ways = np.stack([np.cos(angles_rad), np.sin(angles_rad)], axis=1)[:, None]
    begins, lines = sides[:, 0] - origin, sides[:, 1] - sides[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        across = ways[..., 0] * lines[:, 1] - ways[..., 1] * lines[:, 0]
        away_m = (begins[:, 0] * lines[:, 1] - begins[:, 1] * lines[:, 0]) / across
        share = (begins[:, 0] * ways[..., 1] - begins[:, 1] * ways[..., 0]) / across
        meets = (share >= 0) & (share <= 1) & (away_m >= 0)
    return np.min(np.where(meets, away_m, most_m), axis=1, initial=most_m)


class Scene:
    """An episode: the car at the begin of a planning problem, and the traffic of it."""

    def __init__(self, problem: Problem, car: Car, scanner: Scanner, seed: int, step_s: float) -> None:
        self.problem, self.car, self.scanner, self.step_s = problem, car, scanner, step_s
        self.parameters = parameters(car)
        x_m, y_m, heading_rad = problem.pose
        back_m = car.wheelbase_m / 2
        #: Of the model: middle of the rear axle, angle of the wheels, speed, heading.
        self.state = np.array(
            [x_m - back_m * math.cos(heading_rad), y_m - back_m * math.sin(heading_rad), 0.0, problem.speed_mps, heading_rad]
        )
        self.drops = np.random.default_rng(seed)
        # The actions that are on their way, one for each step of the delay.
        self.actions = deque([(0.0, 0.0)] * round(car.delay_ms / 1e3 / step_s))
        self.steer = self.pedal = self.elapsed_s = 0.0
        self.along_m, self.left_m = problem.route.locate(x_m, y_m, problem.start_m)
        self.touched = self._touched()

    @property
    def step(self) -> int:
        """The scenario's newest step."""
        return self.problem.first_step + math.floor(self.elapsed_s / self.problem.step_s + 1e-6)

    @property
    def pose(self) -> Pose:
        """The middle of the body, and the heading."""
        x_m, y_m, _, _, heading_rad = map(float, self.state)
        ahead_m = self.car.wheelbase_m / 2
        return x_m + ahead_m * math.cos(heading_rad), y_m + ahead_m * math.sin(heading_rad), math.remainder(heading_rad, math.tau)

    @property
    def speed_mps(self) -> float:
        return float(self.state[3])

    @property
    def yaw_radps(self) -> float:
        return self.speed_mps * math.tan(self.state[2]) / self.car.wheelbase_m

    def _touched(self) -> str:
        return self.problem.touched(self.pose, self.car.length_m, self.car.width_m, self.step)

    @property
    def arrives(self) -> bool:
        """Whether the car has the goal's place and heading: at the goal's time, if it began
        there, else at any time."""
        is_time = not self.problem.begins_there or self.step >= self.problem.goal_begin
        return not self.touched and is_time and self.problem.is_there(self.pose)

    @property
    def is_whole(self) -> bool:
        """Whether all of the goal is reached: speed and time, too."""
        return self.problem.is_reached(self.pose, self.speed_mps, self.step)

    @property
    def is_over(self) -> bool:
        """Whether the goal's time has long passed."""
        return (self.step - self.problem.goal_end) * self.problem.step_s > GRACE_S

    @property
    def route_m(self) -> float:
        return self.problem.goal_m - self.problem.start_m

    @property
    def completion(self) -> float:
        """Share of the way to the goal that is driven."""
        return 1.0 if self.arrives else (self.along_m - self.problem.start_m) / self.route_m

    @property
    def place(self) -> str:
        """Where the car is, in words."""
        return f"after {self.along_m - self.problem.start_m:.1f} m of {self.problem.name}"

    def advance(self, steer: float, pedal: float, step_s: float) -> None:
        """Moves the car; ends early when it touches something or arrives."""
        for _ in range(max(1, round(step_s / self.step_s))):
            before = self.step
            self._move(max(-1.0, min(1.0, steer)), max(-1.0, min(1.0, pedal)))
            # Traffic is recorded at steps of the scenario, so contacts are looked for there.
            if self.step > before:
                self.touched = self._touched()
            if self.touched or self.arrives:
                break
        self.along_m, self.left_m = self.problem.route.locate(*self.pose[:2], self.along_m)

    def _move(self, steer: float, pedal: float) -> None:
        """One step of the model, by the midpoint rule."""
        self.actions.append((steer, pedal))
        self.steer, self.pedal = self.actions.popleft()
        most_mps2 = self.car.max_brake_mps2 if self.pedal < 0 else self.car.max_accel_mps2
        # No farther than to a stand, nor past the top speed; a car that begins faster keeps
        # its speed.
        least_mps2 = -self.speed_mps / self.step_s
        top_mps2 = max(self.car.max_speed_mps - self.speed_mps, 0.0) / self.step_s
        input_ = [0.0, min(max(self.pedal * most_mps2, least_mps2), top_mps2)]
        self.state[2] = self.steer * self.car.max_steer_rad
        half = self.state + self.step_s / 2 * np.array(vehicle_dynamics_ks(self.state, input_, self.parameters))
        self.state = self.state + self.step_s * np.array(vehicle_dynamics_ks(half, input_, self.parameters))
        self.state[3] = max(self.state[3], 0.0)
        self.elapsed_s += self.step_s

    def ranges_m(self) -> np.ndarray:
        """A scan of the obstacles' shapes; a dropped return shows the full range."""
        scanner, (x_m, y_m, heading_rad) = self.scanner, self.pose
        beams, cos, sin = int(scanner.beams), math.cos(heading_rad), math.sin(heading_rad)
        origin = np.array([x_m + cos * scanner.x_m - sin * scanner.y_m, y_m + sin * scanner.x_m + cos * scanner.y_m])
        if scanner.field_of_view_rad >= math.tau or beams == 1:
            shares = np.arange(beams) / beams
        else:
            shares = np.arange(beams) / (beams - 1) - 0.5
        angles_rad = heading_rad + math.radians(scanner.heading_deg) + shares * scanner.field_of_view_rad
        found_m = ranges_m(origin, angles_rad, self.problem.sides(self.step), scanner.range_m)
        return np.where(self.drops.random(beams) < scanner.drop_probability, scanner.range_m, found_m)


def drivable(problems: list[Problem], car: Car, scanner: Scanner) -> list[Problem]:
    """The planning problems whose begin this car can take. What it cannot is logged."""
    found, reasons = [], []
    for problem in problems:
        touched = Scene(problem, car, scanner, 0, SUB_STEP_S).touched
        if touched:
            reasons.append(f"{problem.name}: this car touches {touched} at the begin")
        elif problem.speed_mps > car.max_speed_mps:
            reasons.append(f"{problem.name}: it begins at {problem.speed_mps:.1f} m/s, faster than this car's {car.max_speed_mps:.1f}")
        else:
            found.append(problem)
    for reason in reasons:
        print(f"not used: {reason}", flush=True)
    if not found:
        raise Unusable(f"no scenario that this car can drive: {reasons[0]}")
    return found
