"""A scene of the F1TENTH gym: its car on the road of a map, which the gym moves and judges."""

import math

from gym_code import Integrator, ScanSimulator2D, Simulator

import numpy as np
from car import Car, Scanner
from route import Route

#: A step of the gym, s, at most: its own default.
SUB_STEP_S = 0.01
#: Laps of an episode, as in the gym's environment.
LAPS = 2
#: The gym's car where a vehicle file says nothing: tyres, mass, speed of the steering, and
#: the speed from which on its motor gives less. The defaults of `F110Env`.
GYM_CAR = {
    "mu": 1.0489,
    "C_Sf": 4.718,
    "C_Sr": 5.4562,
    "h": 0.074,
    "m": 3.74,
    "I": 0.04712,
    "sv_min": -3.2,
    "sv_max": 3.2,
    "v_switch": 7.319,
    "v_min": -5.0,
}
#: Share of the wheelbase from the front axle to the centre of gravity.
FRONT_SHARE = 0.15875 / 0.3302
#: Standard deviation of the noise of the gym's scans, m, its default.
NOISE_M = 0.01
#: A car at the begin is at most this far beside the middle line, m, and turned, rad.
ASIDE_M, TURNED_RAD = 0.3, 0.1


def parameters(car: Car) -> dict[str, float]:
    """The car for the gym, which has one limit for both accelerations."""
    return GYM_CAR | {
        "lf": FRONT_SHARE * car.wheelbase_m,
        "lr": (1 - FRONT_SHARE) * car.wheelbase_m,
        "s_min": -car.max_steer_rad,
        "s_max": car.max_steer_rad,
        "a_max": max(car.max_accel_mps2, car.max_brake_mps2),
        "v_max": car.max_speed_mps,
        "width": car.width_m,
        "length": car.length_m,
    }


def simulator(map_path: str, values: dict[str, float], step_s: float) -> Simulator:
    """The gym's simulator with one car on a map."""
    made = Simulator(values, 1, 0, time_step=step_s, integrator=Integrator.RK4)
    made.set_map(map_path, ".png")
    return made


def scan_simulator(map_path: str, scanner: Scanner) -> ScanSimulator2D:
    """The gym's scanner with the beams of a vehicle file. The scan by which the gym judges
    contacts is its own, of 1,080 beams."""
    beams, field_rad = int(scanner.beams), scanner.field_of_view_rad
    if field_rad >= math.tau:
        # On a circle the gym's last beam would look where the first one does.
        field_rad *= (beams - 1) / beams
    made = ScanSimulator2D(max(beams, 2), field_rad, max_range=scanner.range_m)
    made.set_map(map_path, ".png")
    return made


def begin(simulator: Simulator, route: Route, seed: int) -> None:
    """Puts the car on the road where the seed says."""
    chosen = np.random.default_rng(seed)
    x_m, y_m, heading_rad = route.at(chosen.uniform(0.0, route.length_m))
    aside_m, turned_rad = chosen.uniform(-ASIDE_M, ASIDE_M), chosen.uniform(-TURNED_RAD, TURNED_RAD)
    place = [x_m - aside_m * math.sin(heading_rad), y_m + aside_m * math.cos(heading_rad)]
    simulator.agents[0].seed = seed
    simulator.reset(np.array([[*place, (heading_rad + turned_rad) % math.tau]]))


class Lap:
    """How far round the road the car is."""

    def __init__(self, route: Route, x_m: float, y_m: float) -> None:
        self.route, self.driven_m, self.elapsed_s = route, 0.0, 0.0
        self.along_m, self.left_m = route.locate(x_m, y_m)
        #: Time of each lap that is finished, s.
        self.laps_s: list[float] = []

    def go(self, x_m: float, y_m: float, step_s: float) -> None:
        """The car is there after a step."""
        before_m = self.along_m
        self.along_m, self.left_m = self.route.locate(x_m, y_m, before_m)
        self.driven_m += math.remainder(self.along_m - before_m, self.route.length_m)
        self.elapsed_s += step_s
        if self.driven_m >= (len(self.laps_s) + 1) * self.route.length_m:
            self.laps_s.append(self.elapsed_s - sum(self.laps_s))


class Scene:
    """An episode: the car on a road, from the place of a seed."""

    def __init__(self, made: Simulator, scans: ScanSimulator2D, route: Route, car: Car, scanner: Scanner, seed: int) -> None:
        self.simulator, self.scans, self.route, self.car, self.scanner = made, scans, route, car, scanner
        begin(made, route, seed)
        self.agent = made.agents[0]
        self.noise = np.random.default_rng(seed)
        self.route_m = LAPS * route.length_m
        self.steer = self.pedal = 0.0
        #: What it touches, as the gym says; empty for nothing. The gym forgets it a step later.
        self.touched = ""
        self.lap = Lap(route, *self.agent.state[:2])

    @property
    def pose(self) -> tuple[float, float, float]:
        """The middle of the body, and the heading."""
        x_m, y_m, heading_rad = (float(self.agent.state[k]) for k in (0, 1, 4))
        return x_m, y_m, heading_rad

    @property
    def speed_mps(self) -> float:
        return float(self.agent.state[3])

    @property
    def yaw_radps(self) -> float:
        return float(self.agent.state[5])

    @property
    def place(self) -> str:
        """Where the car is, in words."""
        return f"at {self.lap.along_m:.1f} m in lap {len(self.lap.laps_s) + 1}"

    @property
    def arrives(self) -> bool:
        return len(self.lap.laps_s) >= LAPS

    @property
    def completion(self) -> float:
        return self.lap.driven_m / self.route_m

    def advance(self, steer: float, pedal: float, step_s: float) -> None:
        """Moves the car; ends early when it touches something or has driven its laps."""
        self.steer, self.pedal = max(-1.0, min(1.0, steer)), max(-1.0, min(1.0, pedal))
        sub_s = self.simulator.time_step
        for _ in range(max(1, round(step_s / sub_s))):
            wanted = [self.steer * self.car.max_steer_rad, self._wanted_mps(sub_s)]
            self.simulator.step(np.array([wanted]))
            self.lap.go(*self.agent.state[:2], sub_s)
            if self.simulator.collisions[0]:
                self.touched = "a wall"
            if self.touched or self.arrives:
                break

    def _wanted_mps(self, sub_s: float) -> float:
        """The speed that makes the gym accelerate as the pedal says: the gym takes speeds,
        and accelerates in proportion to what is missing (`pid` of its dynamic_models)."""
        most_mps2 = self.car.max_brake_mps2 if self.pedal < 0 else self.car.max_accel_mps2
        speed_mps, values = self.speed_mps, self.agent.params
        accel_mps2 = self.pedal * most_mps2
        if speed_mps <= 0:
            accel_mps2 = max(accel_mps2, 0.0)
            return speed_mps + accel_mps2 * values["v_max"] / (2 * values["a_max"]) if accel_mps2 else 0.0
        # No farther than to a stand.
        accel_mps2 = max(accel_mps2, -speed_mps / sub_s)
        limit_mps = values["v_max"] if accel_mps2 > 0 else -values["v_min"]
        return speed_mps + accel_mps2 * limit_mps / (10 * values["a_max"])

    def ranges_m(self) -> np.ndarray:
        """The gym's scan from where the scanner is, with the gym's noise; a dropped return
        shows the full range."""
        scanner, (x_m, y_m, heading_rad) = self.scanner, self.pose
        beams, cos, sin = int(scanner.beams), math.cos(heading_rad), math.sin(heading_rad)
        x_m, y_m = x_m + cos * scanner.x_m - sin * scanner.y_m, y_m + sin * scanner.x_m + cos * scanner.y_m
        looks_rad = heading_rad + math.radians(scanner.heading_deg)
        if scanner.field_of_view_rad >= math.tau or beams == 1:
            # The gym's first beam is half a field to the right.
            looks_rad += self.scans.fov / 2
        ranges_m = self.scans.scan(np.array([x_m, y_m, looks_rad]), self.noise, NOISE_M)[:beams]
        lost = self.noise.random(beams) < scanner.drop_probability
        return np.where(lost, scanner.range_m, np.clip(ranges_m, 0.0, scanner.range_m))
