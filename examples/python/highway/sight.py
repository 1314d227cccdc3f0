"""What a car sees in highway-env: the road to its goal, the beams, and the observation of
VLAPS that they fill.

highway-env's y axis points to the right of its x axis, so y and headings change their sign.
"""

import math
import sys
from pathlib import Path

import numpy as np
import vlaps
from vlaps import process

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "sim" / "foreign"))
from route import Route

BEAMS, RANGE_M = 240, 50.0
#: What is kept of a road, and the least distance between two places of a route, m.
ROAD_M, GAP_M = 3000.0, 0.5


def lanes_to(network, lane: tuple, goal: str | None) -> list[tuple]:
    """The lanes to a node, as highway-env chooses them for a car that keeps its lane; of a
    lap without a goal."""
    nodes = network.shortest_path(lane[1], goal or lane[0]) or [lane[1]]
    lanes = [lane]
    for start, end in zip(nodes, nodes[1:]):
        last = network.get_lane(lane)
        found, _ = network.next_lane_given_next_road(*lane, end, None, last.position(last.length, 0))
        lane = (start, end, found)
        lanes.append(lane)
    return lanes


def route_of(network, lane: tuple, goal: str | None) -> Route:
    """The middle of these lanes, a place each metre, with the distances to the road's edges."""
    rows = []
    for start, end, number in lanes_to(network, lane, goal):
        beside = network.graph[start][end]
        curve, widths_m = beside[number], [one.width for one in beside]
        # Lanes are numbered from the left.
        edges_m = (sum(widths_m[:number]) + curve.width / 2, sum(widths_m[number:]) - curve.width / 2)
        length_m = min(curve.length, ROAD_M)
        for along_m in np.linspace(0.0, length_m, math.ceil(length_m), endpoint=False):
            place, turn_rad = curve.position(along_m, 0.0), curve.heading_at(along_m)
            # A lane may begin before the end of the one before it.
            if not rows or np.dot(place - rows[-1][:2], (math.cos(turn_rad), math.sin(turn_rad))) > GAP_M:
                rows.append((*place, *edges_m))
    table = np.array(rows) * [1.0, -1.0, 1.0, 1.0]
    return Route(table[:, :2], table[:, 2], table[:, 3], is_closed=goal is None)


def ranges_m(road, ego) -> np.ndarray:
    """Distances to the vehicles and objects around, counter-clockwise from straight ahead.

    highway-env's LidarObservation has cells in fixed directions of the world, each with the
    distance to the middle of what is there where that is nearer.
    """
    others = [other for other in road.vehicles + road.objects if other is not ego and other.solid]
    if not others:
        return np.full(BEAMS, RANGE_M)
    angles_rad = ego.heading - math.tau * np.arange(BEAMS) / BEAMS
    beams = np.stack([np.cos(angles_rad), np.sin(angles_rad)], -1)
    cos, sin = (function([other.heading for other in others]) for function in (np.cos, np.sin))
    turn = np.stack([cos, sin, -sin, cos], -1).reshape(-1, 2, 2)
    halves_m = np.array([(other.LENGTH / 2, other.WIDTH / 2) for other in others])[:, None]
    # Origin and beams in the frame of each rectangle, then between its two pairs of sides.
    from_m = np.einsum("nij,nj->ni", turn, ego.position - [other.position for other in others])[:, None]
    along = np.einsum("nij,bj->nbi", turn, beams)
    along = np.where(np.abs(along) < 1e-12, 1e-12, along)
    sides = np.sort([(-halves_m - from_m) / along, (halves_m - from_m) / along], axis=0)
    near_m, far_m = sides[0].max(-1), sides[1].min(-1)
    hits_m = np.where((near_m <= far_m) & (far_m > 0.0), np.maximum(near_m, 0.0), RANGE_M)
    return np.minimum(hits_m.min(0), RANGE_M)


class Sight:
    """The observations of one episode."""

    def __init__(self, env, goal: str | None) -> None:
        self.env, self.seen = env, process.Observation()
        self.route, self.along_m = route_of(env.road.network, env.vehicle.lane_index, goal), None
        self.seen.lidar_max_m, self.seen.beam_count, self.seen.field_of_view_rad = RANGE_M, BEAMS, math.tau

    def features(self, yaw_rate_radps: float, action: tuple[float, float]) -> np.ndarray:
        """The input of a policy, by the feature map of the stack. `action` is the steering and
        the pedal last applied."""
        ego, seen = self.env.vehicle, self.seen
        pose = (ego.position[0], -ego.position[1], math.remainder(-ego.heading, math.tau))
        seen.ego = process.Ego(*pose, max(ego.speed, 0.0), yaw_rate_radps, *action)
        self.along_m, left_m = self.route.locate(*pose[:2], self.along_m)
        to_left_m, to_right_m = self.route.edges(self.along_m)
        turned_rad = math.remainder(pose[2] - self.route.at(self.along_m)[2], math.tau)
        # The lanes beside that of the route have a middle of their own.
        width_m = ego.lane.width
        lanes_left, lanes_right = (round(edge_m / width_m - 0.5) for edge_m in (to_left_m, to_right_m))
        lane = min(max(round(left_m / width_m), -lanes_right), lanes_left)
        edges_m = (to_left_m - left_m, to_right_m + left_m)
        seen.road = process.Road(*edges_m, turned_rad, left_m - lane * width_m, width_m)
        bends = {0: process.Bend.STRAIGHT, 1: process.Bend.LEFT, -1: process.Bend.RIGHT}
        for k, found in enumerate(self.route.checkpoints(pose, self.along_m)):
            shape = (found.radius_m, found.angle_rad, bends[found.side])
            seen.checkpoints[k] = process.Checkpoint(found.x_m, found.y_m, *shape)
        np.ctypeslib.as_array(seen.ranges_m)[:BEAMS] = ranges_m(self.env.road, ego)
        return vlaps._vlaps.observation_features(bytes(seen))
