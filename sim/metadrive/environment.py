"""The real MetaDrive behind the interface of the built-in world.

Physical quantities are read from the simulator's objects, in the frames of the
messages: x forward, y left, headings counter-clockwise.
"""

import ctypes
import math
from collections import namedtuple

import numpy as np
from metadrive.component.lane.circular_lane import CircularLane
from metadrive.constants import DEFAULT_AGENT
from metadrive.envs.safe_metadrive_env import SafeMetaDriveEnv

import wire_layout as layout

# Number of scenarios of the simulator: each seed below this is one.
SCENARIOS = 100_000
# Length of a tick of its physics as one step: five of 0.02 s.
TICK_S = 0.1
# Failures only: other events are in the world's own log.
LOG_LEVEL = 50

Step = namedtuple("Step", "outcome touched_vehicle touched_object on_sidewalk")


class ExperimentEnv(SafeMetaDriveEnv):
    """The experiment's rules: touching a sidewalk ends an episode, too."""

    def _is_out_of_road(self, vehicle):
        return super()._is_out_of_road(vehicle) or vehicle.crash_sidewalk


def environment_config(world, scanner):
    """The experiment's configuration; `world` and `scanner` are those sections of the run's."""
    sequence = world["sequence"]
    return {
        "start_seed": 0,
        "num_scenarios": SCENARIOS,
        # A map is kept only as long as its episode: memory stays bounded.
        "store_map": False,
        # With it episodes do not depend on those before.
        "force_destroy": True,
        "map_config": {
            "type": "block_sequence" if sequence else "block_num",
            "config": sequence or world["blocks"],
            "lane_num": world["lanes"],
            "lane_width": world["lane_width_m"],
            "exit_length": 50,
            "start_position": [0, 0],
        },
        "traffic_density": world["traffic_density"],
        "accident_prob": world["accident_probability"],
        "horizon": world["horizon_ticks"],
        "crash_vehicle_done": False,
        "crash_object_done": False,
        "out_of_route_done": True,
        "vehicle_config": {
            "lidar": {"num_lasers": scanner["beams"], "distance": scanner["range_m"], "num_others": 0}
        },
        "use_render": False,
        "image_observation": False,
        "log_level": LOG_LEVEL,
    }


class World:
    """One episode after the other of the real simulator."""

    def __init__(self, world, scanner):
        self._lidar_m = scanner["range_m"]
        self._beams = scanner["beams"]
        self.env = ExperimentEnv(environment_config(world, scanner))
        self.ticks = 0
        self.driven_m = 0.0
        # The simulator's own observation, for the test that compares.
        self.features = None

    def reset(self, seed):
        """Begins the episode of a seed; ValueError when there is none."""
        if not 0 <= seed < SCENARIOS:
            raise ValueError(f"MetaDrive has the seeds 0 to {SCENARIOS - 1}")
        self.features, _ = self.env.reset(seed=seed)
        self.ticks = 0
        self.driven_m = 0.0

    @property
    def vehicle(self):
        return self.env.agents[DEFAULT_AGENT]

    @property
    def completion(self):
        return float(self.vehicle.navigation.route_completion)

    @property
    def route_m(self):
        return float(self.vehicle.navigation.total_length)

    @property
    def speed_mps(self):
        return float(self.vehicle.speed)

    def step(self, action):
        """Runs one tick of the physics; returns its result."""
        before = self.vehicle.position
        self.features, _, _, _, _ = self.env.step(action)
        self.ticks += 1
        vehicle = self.vehicle
        after = vehicle.position
        self.driven_m += math.hypot(after[0] - before[0], after[1] - before[1])
        touched = map(bool, (vehicle.crash_vehicle, vehicle.crash_object, vehicle.crash_sidewalk))
        return Step(self._outcome(vehicle), *touched)

    def _outcome(self, vehicle):
        if self.env._is_arrive_destination(vehicle):
            return layout.Outcome.ARRIVED
        if self.env._is_out_of_road(vehicle):
            return layout.Outcome.OUT_OF_ROAD
        if self.ticks >= self.env.config["horizon"]:
            return layout.Outcome.MAX_STEP
        return layout.Outcome.DRIVING

    def observe(self, observation):
        """Fills the present observation; header and instants are not changed."""
        vehicle = self.vehicle
        _fill_ego(observation.ego, vehicle)
        _fill_road(observation.road, vehicle)
        navigation = vehicle.navigation
        this = navigation.current_ref_lanes[0]
        following = navigation.next_ref_lanes
        _fill_checkpoint(observation.checkpoints[0], vehicle, this)
        _fill_checkpoint(observation.checkpoints[1], vehicle, following[0] if following else this)
        observation.lidar_max_m = self._lidar_m
        observation.beam_count = self._beams
        observation.field_of_view_rad = math.tau
        fractions = self.env.observations[DEFAULT_AGENT].cloud_points
        ranges_m = np.minimum(np.asarray(fractions) * self._lidar_m, self._lidar_m)
        ranges_m = ranges_m.astype(np.float32)
        ctypes.memmove(observation.ranges_m, ranges_m.ctypes.data, ranges_m.nbytes)

    def close(self):
        self.env.close()


def _fill_ego(ego, vehicle):
    position = vehicle.position
    forward, before = vehicle.heading, vehicle.last_heading_dir
    turned_rad = math.atan2(
        before[0] * forward[1] - before[1] * forward[0],
        before[0] * forward[0] + before[1] * forward[1],
    )
    steer, pedal = vehicle.last_current_action[-1]
    ego.x_world_m = position[0]
    ego.y_world_m = position[1]
    ego.heading_world_rad = vehicle.heading_theta
    ego.speed_mps = vehicle.speed
    ego.yaw_rate_radps = turned_rad / TICK_S
    ego.steer = steer
    ego.pedal = pedal


def _fill_road(road, vehicle):
    lane = vehicle.navigation.current_ref_lanes[-1]
    along_m, _ = lane.local_coordinates(vehicle.position)
    heading_rad = vehicle.heading_theta - lane.heading_theta_at(along_m)
    road.left_m = vehicle.dist_to_left_side
    road.right_m = vehicle.dist_to_right_side
    road.heading_rad = math.remainder(heading_rad, math.tau)
    # The simulator counts to the right of a lane.
    road.offset_m = -vehicle.lane.local_coordinates(vehicle.position)[1]
    road.lane_width_m = vehicle.navigation.get_current_lane_width()


def _fill_checkpoint(checkpoint, vehicle, lane):
    """The end of a road, at its middle, reckoned with the current road's width."""
    navigation = vehicle.navigation
    count, width_m = navigation.get_current_lane_num(), navigation.get_current_lane_width()
    middle_m = (count / 2 - 0.5) * width_m
    away = lane.position(lane.length, middle_m) - vehicle.position
    forward_m, left_m = vehicle.convert_to_local_coordinates(away, 0.0)
    checkpoint.x_body_m = forward_m
    checkpoint.y_body_m = left_m
    if isinstance(lane, CircularLane):
        checkpoint.bend_radius_m = lane.radius
        checkpoint.bend_angle_rad = lane.angle
        checkpoint.bend = layout.Bend.RIGHT if lane.is_clockwise() else layout.Bend.LEFT
    else:
        checkpoint.bend_radius_m = 0.0
        checkpoint.bend_angle_rad = 0.0
        checkpoint.bend = layout.Bend.STRAIGHT
