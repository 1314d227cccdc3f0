"""A planning problem of a CommonRoad scenario: its road, its traffic, its goal, its referee."""

import heapq
import math

import numpy as np
import shapely
from commonroad.geometry.shape import Rectangle
from commonroad.planning.planning_problem import PlanningProblem
from commonroad.scenario.lanelet import LaneletNetwork
from commonroad.scenario.scenario import Scenario
from commonroad.scenario.state import CustomState
from commonroad_dc import pycrcc
from commonroad_dc.boundary.boundary import create_road_boundary_obstacle
from commonroad_dc.collision.collision_detection.pycrcc_collision_dispatch import create_collision_checker
from route import Route, from_pose

#: A change of lanes costs as much as this way, m.
CHANGE_M = 30.0
#: A turn of one radian costs as much as this way, m: of several goals, the straight one.
TURN_M_PER_RAD = 20.0
#: The route goes on after the goal, so that the car need not brake for its end, m.
BEYOND_M = 100.0
#: Distance between two places of the middle line, m.
ROW_M = 1.0
#: The road reaches at most this far to each side, m.
SIDE_MAX_M = 20.0
#: Gaps between lanelets up to twice this are closed, m.
GAP_M = 0.05
#: Lanelets that differ more from the car's heading are not those it drives on.
ALONG_MAX_RAD = math.radians(60)
#: The route is at least so long where a goal has no place to drive to, m.
ROUTE_MIN_M = 10.0

Pose = tuple[float, float, float]


class Unusable(Exception):
    """Why a scenario cannot be driven."""


def _side_by_side(network: LaneletNetwork, number: int) -> list[int]:
    """The lanelets beside one, in its direction."""
    lane = network.find_lanelet_by_id(number)
    beside = [(lane.adj_left, lane.adj_left_same_direction), (lane.adj_right, lane.adj_right_same_direction)]
    return [other for other, is_same in beside if other is not None and is_same]


def _length_m(network: LaneletNetwork, number: int) -> float:
    return float(network.find_lanelet_by_id(number).distance[-1])


def _turn_rad(network: LaneletNetwork, number: int) -> float:
    """By how much a lanelet's end differs from its begin in heading, without sign."""
    line = network.find_lanelet_by_id(number).center_vertices
    return abs(math.remainder(_heading_rad(line[-2:]) - _heading_rad(line[:2]), math.tau))


def _heading_rad(row: np.ndarray) -> float:
    """From the first place of a polyline to its last."""
    return math.atan2(*(row[-1] - row[0])[::-1])


def easiest(network: LaneletNetwork, starts: list[int], goals: set[int]) -> list[list[int]] | None:
    """The lanelets of the way that is shortest, turns and changes of lanes counted: sections
    one after the other, in each the lanelets side by side that the car changes over. `None`
    without a way."""
    queue = [(0.0, start, ((start,),)) for start in starts]
    heapq.heapify(queue)
    done = set()
    while queue:
        cost_m, number, way = heapq.heappop(queue)
        if number in goals:
            return [list(section) for section in way]
        if number in done:
            continue
        done.add(number)
        length_m, turn_m = _length_m(network, number), TURN_M_PER_RAD * _turn_rad(network, number)
        for after in network.find_lanelet_by_id(number).successor:
            heapq.heappush(queue, (cost_m + length_m + turn_m, after, (*way, (after,))))
        for beside in _side_by_side(network, number):
            if beside not in way[-1]:
                # On a short lanelet a change of lanes would be too sharp.
                change_m = CHANGE_M * max(1.0, CHANGE_M / length_m)
                heapq.heappush(queue, (cost_m + change_m, beside, (*way[:-1], (*way[-1], beside))))
    return None


def lengthen(network: LaneletNetwork, way: list[list[int]], length_m: float) -> list[list[int]]:
    """A way and the straightest lanelets after it, up to a length."""
    way = list(way)
    while length_m > 0:
        last = network.find_lanelet_by_id(way[-1][-1])
        end_rad = _heading_rad(last.center_vertices[-2:])
        after = [network.find_lanelet_by_id(number) for number in last.successor]
        if not after:
            break
        straight = min(after, key=lambda lane: abs(math.remainder(_heading_rad(lane.center_vertices) - end_rad, math.tau)))
        way.append([straight.lanelet_id])
        length_m -= _length_m(network, straight.lanelet_id)
    return way


def _resampled(line: np.ndarray, count: int) -> np.ndarray:
    """So many places of a polyline, evenly along it."""
    along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    parts_m = np.linspace(0.0, along_m[-1], count)
    return np.stack([np.interp(parts_m, along_m, column) for column in line.T], axis=1)


def _share(network: LaneletNetwork, number: int, place: np.ndarray | None, default: float) -> float:
    """How far along a lanelet a place is, as a share of its length."""
    if place is None:
        return default
    line = shapely.LineString(network.find_lanelet_by_id(number).center_vertices)
    return float(line.project(shapely.Point(place)) / line.length)


def middle_line(network: LaneletNetwork, way: list[list[int]], start: np.ndarray, goal: np.ndarray | None, last: int) -> np.ndarray:
    """The middle line of a way. In a section with several lanelets it goes over from the
    first to the last: from the start on, and up to the goal in section `last`."""
    rows = []
    for k, section in enumerate(way):
        lanes = [network.find_lanelet_by_id(number).center_vertices[:, :2] for number in section]
        count = max(2, math.ceil(_length_m(network, section[0]) / ROW_M) + 1)
        lanes = np.stack([_resampled(lane, count) for lane in lanes])
        begin = _share(network, section[0], start, 0.0) if k == 0 else 0.0
        end = _share(network, section[-1], goal, 1.0) if k == last else 1.0
        through = np.clip((np.linspace(0.0, 1.0, count) - begin) / max(end - begin, 1e-3), 0.0, 1.0)
        over = (len(lanes) - 1) * through**2 * (3 - 2 * through)
        before = np.minimum(over.astype(int), max(len(lanes) - 2, 0))
        part, column = (over - before)[:, None], np.arange(count)
        after = np.minimum(before + 1, len(lanes) - 1)
        rows.append((1 - part) * lanes[before, column] + part * lanes[after, column])
    line = np.vstack(rows)
    keeps = np.concatenate([[True], np.hypot(*np.diff(line, axis=0).T) > 1e-3])
    line = line[keeps]
    length_m = float(np.sum(np.hypot(*np.diff(line, axis=0).T)))
    return _resampled(line, max(3, math.ceil(length_m / ROW_M)))


def edges_m(network: LaneletNetwork, way: list[list[int]], line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances from the line to the left and right edge of the lanelets of a way. The drivers
    keep to the middle of the road that they are shown, so it is not all lanes of a motorway."""
    road = {number for section in way for number in section}
    shapes = [network.find_lanelet_by_id(number).polygon.shapely_object.buffer(GAP_M) for number in sorted(road)]
    edge = shapely.union_all(shapes).buffer(-GAP_M).boundary
    ways = np.gradient(line, axis=0)
    ways /= np.hypot(*ways.T)[:, None]
    left = np.stack([-ways[:, 1], ways[:, 0]], axis=1)
    found = []
    for side in (1.0, -1.0):
        rays = shapely.linestrings(np.stack([line, line + side * SIDE_MAX_M * left], axis=1))
        away_m = shapely.distance(shapely.points(line), shapely.intersection(rays, edge))
        away_m = np.where(np.isnan(away_m), SIDE_MAX_M, away_m)
        # The ends of the line are on the edge of the first and the last lanelet.
        away_m[[0, -1]] = away_m[[1, -2]]
        found.append(away_m)
    return found[0], found[1]


class Problem:
    """A planning problem that can be driven."""

    def __init__(self, name: str, scenario: Scenario, problem: PlanningProblem) -> None:
        self.name, self.scenario, self.step_s = name, scenario, float(scenario.dt)
        self.goal, start = problem.goal, problem.initial_state
        try:
            self.pose: Pose = (*map(float, start.position), float(start.orientation))
            self.speed_mps, self.first_step = float(start.velocity), int(start.time_step)
        except (AttributeError, TypeError):  # An interval or an area.
            raise Unusable("its initial state is not exact") from None
        if not scenario.lanelet_network.lanelets:
            raise Unusable("it has no lanelet")
        times = [state.time_step for state in self.goal.state_list]
        #: The goal's time, in steps of the scenario.
        self.goal_begin = min(int(getattr(time, "start", time)) for time in times)
        self.goal_end = max(int(getattr(time, "end", time)) for time in times)
        #: Whether the goal demands only the time, and perhaps a speed, of a car that goes on.
        self.begins_there = self.is_there(self.pose)
        self.route = self._route()
        self.start_m = self.route.locate(*self.pose[:2])[0]
        self.goal_m = self._goal_m()
        # The drivability checker of CommonRoad.
        self.checker = create_collision_checker(scenario)
        self._obstacles: dict[int, list[tuple[str, shapely.Polygon]]] = {}
        self._sides: dict[int, np.ndarray] = {}
        self.edge = create_road_boundary_obstacle(scenario, return_scenario_obstacle=False)

    def is_there(self, pose: Pose) -> bool:
        """Whether a pose has the place and the heading of the goal."""
        for state in self.goal.state_list:
            has_place = not state.has_value("position") or state.position.contains_point(np.array(pose[:2]))
            if has_place and (not state.has_value("orientation") or state.orientation.contains(pose[2])):
                return True
        return False

    def is_reached(self, pose: Pose, speed_mps: float, step: int) -> bool:
        """Whether all of the goal is reached: place, heading, speed and time."""
        state = CustomState(position=np.array(pose[:2]), orientation=pose[2], velocity=speed_mps, time_step=step)
        return bool(self.goal.is_reached(state))

    def _starts(self) -> list[int]:
        network = self.scenario.lanelet_network
        found = []
        for number in network.find_lanelet_by_position([np.array(self.pose[:2])])[0]:
            along_rad = network.find_lanelet_by_id(number).orientation_by_position(np.array(self.pose[:2]))
            if abs(math.remainder(along_rad - self.pose[2], math.tau)) < ALONG_MAX_RAD:
                found.append(number)
        if not found:
            raise Unusable("the car does not begin on a lanelet of its direction")
        return sorted(found)

    def _goals(self) -> tuple[set[int], np.ndarray | None]:
        """The lanelets of the goal, and its place, if it is not that of whole lanelets."""
        network, lanelets = self.scenario.lanelet_network, self.goal.lanelets_of_goal_position
        numbers = {number for group in (lanelets or {}).values() for number in group}
        if numbers:
            return numbers, None
        shapes = [state.position for state in self.goal.state_list if state.has_value("position")]
        for shape in [part for shape in shapes for part in getattr(shape, "shapes", [shape])]:
            place = np.array(shape.shapely_object.centroid.coords[0])
            numbers = set(network.find_lanelet_by_position([place])[0])
            if numbers:
                return numbers, place
        return set(), None

    def _route(self) -> Route:
        network, starts = self.scenario.lanelet_network, self._starts()
        goals, place = (set(starts), None) if self.begins_there else self._goals()
        way = easiest(network, starts, goals)
        if way is None:
            raise Unusable("no way over its lanelets leads to the goal")
        last = len(way) - 1
        begins_m = self.speed_mps * self.goal_end * self.step_s if self.begins_there else 0.0
        way = lengthen(network, way, BEYOND_M + begins_m)
        line = middle_line(network, way, np.array(self.pose[:2]), place, last)
        return Route(line, *edges_m(network, way, line), is_closed=False)

    def _goal_m(self) -> float:
        """Where on the route the goal is: where the car would be at its speed, if it is
        there from the start on."""
        route = self.route
        if self.begins_there:
            way_m = max(self.speed_mps * (self.goal_begin - self.first_step) * self.step_s, ROUTE_MIN_M)
            return min(self.start_m + way_m, route.length_m)
        for along_m in np.arange(self.start_m, route.length_m, ROW_M / 2):
            if self.is_there(route.at(along_m)):
                if along_m - self.start_m < ROUTE_MIN_M:
                    raise Unusable("the middle of its lanelets begins in the goal, and the car does not")
                return float(along_m)
        raise Unusable("the middle of its lanelets does not lead through the goal in the goal's direction")

    def obstacles(self, step: int) -> list[tuple[str, shapely.Polygon]]:
        """Kind and shape of each obstacle at a step."""
        return [(kind, shape) for _, kind, shape in self.numbered(step)]

    def numbered(self, step: int) -> list[tuple[tuple[int, int], str, shapely.Polygon]]:
        """Each obstacle at a step: its number and that of the shape in it, its kind and its shape."""
        if step not in self._obstacles:
            found = []
            for obstacle in self.scenario.dynamic_obstacles + self.scenario.static_obstacles:
                occupied = obstacle.occupancy_at_time(step)
                shapes = [] if occupied is None else getattr(occupied.shape, "shapes", [occupied.shape])
                kind, number = obstacle.obstacle_type.value, obstacle.obstacle_id
                found += [((number, k), kind, shape.shapely_object) for k, shape in enumerate(shapes)]
            self._obstacles[step] = found
        return self._obstacles[step]

    def sides(self, step: int) -> np.ndarray:
        """The sides (n, 2, 2) of all obstacles at a step."""
        if step not in self._sides:
            found = [np.zeros((0, 2, 2))]
            for _, shape in self.obstacles(step):
                corners = np.array(shape.exterior.coords)[:, :2]
                found.append(np.stack([corners[:-1], corners[1:]], axis=1))
            self._sides[step] = np.concatenate(found)
        return self._sides[step]

    def touched(self, pose: Pose, length_m: float, width_m: float, step: int) -> str:
        """What a car touches at a step, in words, as the drivability checker says."""
        body = pycrcc.RectOBB(length_m / 2, width_m / 2, pose[2], pose[0], pose[1])
        if self.checker.time_slice(step).collide(body):
            return self._nearest(pose, length_m, width_m, step)
        return "the edge of the road" if self.edge.collide(body) else ""

    def _nearest(self, pose: Pose, length_m: float, width_m: float, step: int) -> str:
        """The obstacle nearest to a car, and on which side of the car it is, in words."""
        body = Rectangle(length_m, width_m, np.array(pose[:2]), pose[2]).shapely_object
        kind, shape = min(self.obstacles(step), key=lambda found: found[1].distance(body))
        ahead_m, _ = from_pose(pose, shape.centroid.x, shape.centroid.y)
        where = "beside" if abs(ahead_m) < length_m / 2 else "ahead" if ahead_m > 0 else "behind"
        return f"an obstacle ({kind}) {where}"
