"""highway-env with the actions of a policy of VLAPS: `evaluate.py` drives in it.

A policy's steering and pedal become the action [throttle, steering] of highway-env's
ContinuousAction. highway-env's steering is positive to the right.
"""

import math
import sys

import numpy as np

try:
    import gymnasium
    from highway_env.vehicle.behavior import IDMVehicle
    from highway_env.vehicle.kinematics import Vehicle
except ImportError as error:
    sys.exit(f"{error}: run `pip install highway-env==1.12.1`")
from sight import Sight

# After `sight`, which adds their folder to the path.
from car import DEFAULT_FILE, Car, settings_of

#: The car that policies are trained with.
CAR = Car.of(settings_of(DEFAULT_FILE))
#: Decisions and simulation, Hz; the end of an episode, s.
HZ, DURATION_S = 10, 40.0
#: The largest steering of highway-env's own drivers, rad, and the sine of its slip angle.
STEER_RAD = math.pi / 3
SLIP_MAX = math.sin(math.atan(math.tan(STEER_RAD) / 2))
#: The newest version of each environment, and the end of the route in it; None: laps. The
#: roundabout in two: in the older one highway-env's driver arrives more often.
GOALS = {
    "highway-fast-v0": "1",
    "merge-v1": "d",
    "roundabout-v0": "nxr",
    "roundabout-v1": "nxr",
    "racetrack-v1": None,
}
#: Those without a goal that ends the episode.
ENDLESS = ("highway-fast-v0", "racetrack-v1")
ENDS = ("arrived", "crashed", "off road", "late")


class Ego(IDMVehicle):
    """highway-env's driver in the ego's place; it does what the action says."""

    def act(self, action=None):
        Vehicle.act(self, action)

    def decide(self) -> tuple[float, float]:
        """Its decision as an action of highway-env."""
        IDMVehicle.act(self)
        return self.action["acceleration"] / CAR.max_brake_mps2, self.action["steering"] / STEER_RAD


class World:
    """One environment of highway-env, by a name of `GOALS`."""

    def __init__(self, name: str) -> None:
        self.name, self.goal = name, GOALS[name]
        self.env = gymnasium.make(name, disable_env_checker=True).unwrapped
        # Not by the constructor: those of merge and roundabout fail with this action, since
        # their rewards ask `action in [0, 2]`, which an array refuses.
        brake_mps2 = CAR.max_brake_mps2
        ranges = {"acceleration_range": [-brake_mps2, brake_mps2], "steering_range": [-STEER_RAD, STEER_RAD]}
        config = {"action": {"type": "ContinuousAction", **ranges}, "observation": {"type": "Kinematics"}}
        config |= {"simulation_frequency": HZ, "policy_frequency": HZ, "duration": DURATION_S}
        self.env.configure(config)
        rewards = self.env._rewards
        self.env._rewards = lambda action: rewards(tuple(action))

    def reset(self, seed: int) -> None:
        """Begins the episode of a seed."""
        self.env.reset(seed=seed)
        self.sight = Sight(self.env, self.goal)
        self.heading_rad, self.action = self.env.vehicle.heading, (0.0, 0.0)

    def put_own_driver(self) -> None:
        """Puts highway-env's driver in the ego's place. It keeps the speed that it begins
        with where the traffic and the lane's limit let it."""
        env, old = self.env, self.env.vehicle
        env.vehicle = Ego(env.road, old.position, old.heading, old.speed)
        env.road.vehicles[env.road.vehicles.index(old)] = env.vehicle
        if self.goal:
            env.vehicle.plan_route_to(self.goal)

    def features(self) -> np.ndarray:
        """The input of a policy."""
        turned_rad = math.remainder(self.heading_rad - self.env.vehicle.heading, math.tau)
        return self.sight.features(turned_rad * HZ, self.action)

    def control(self, steer: float, pedal: float) -> tuple[float, float]:
        """The action of highway-env with the acceleration and the curvature that a policy's
        action has in the car of its training."""
        ego = self.env.vehicle
        accel_mps2 = pedal * (CAR.max_accel_mps2 if pedal > 0.0 else CAR.max_brake_mps2)
        # The brake does not reverse.
        accel_mps2 = max(accel_mps2, -ego.speed * HZ)
        slip = math.tan(steer * CAR.max_steer_rad) / CAR.wheelbase_m * ego.LENGTH / 2
        slip_rad = math.asin(min(max(slip, -SLIP_MAX), SLIP_MAX))
        return accel_mps2 / CAR.max_brake_mps2, -math.atan(2 * math.tan(slip_rad)) / STEER_RAD

    def policy_action(self, action: tuple[float, float]) -> tuple[float, float]:
        """The opposite of `control`: steering and pedal of an action of highway-env."""
        accel_mps2, steer_rad = action[0] * CAR.max_brake_mps2, -action[1] * STEER_RAD
        curvature_per_m = math.sin(math.atan(math.tan(steer_rad) / 2)) / (self.env.vehicle.LENGTH / 2)
        steer = math.atan(curvature_per_m * CAR.wheelbase_m) / CAR.max_steer_rad
        pedal = accel_mps2 / (CAR.max_accel_mps2 if accel_mps2 > 0.0 else CAR.max_brake_mps2)
        return min(max(steer, -1.0), 1.0), min(max(pedal, -1.0), 1.0)

    def step(self, action: tuple[float, float]) -> tuple[float, str]:
        """Obeys an action of highway-env: the reward, and one of `ENDS`, or "" while driving."""
        env = self.env
        self.heading_rad, self.action = env.vehicle.heading, self.policy_action(action)
        _, reward, terminated, _, _ = env.step(np.array(action))
        ego, is_late = env.vehicle, env.time > DURATION_S - 0.5 / HZ
        if ego.crashed:
            return reward, "crashed"
        if not ego.on_road:
            return reward, "off road"
        # The merge ends itself, the roundabout does not.
        if terminated or self.name.startswith("roundabout") and ego.lane_index[1] == self.goal:
            return reward, "arrived"
        if is_late:
            return reward, "arrived" if self.name in ENDLESS else "late"
        return reward, ""
