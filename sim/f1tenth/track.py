"""Tracks: the middle line and the edges of a closed road, found in the image of a map."""

import math
import os
from pathlib import Path

from gym_code import CHECKOUT, ScanSimulator2D

import numpy as np
from route import Route
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

#: Names the image description of another map.
MAP_VARIABLE = "VLAPS_F1TENTH_MAP"
#: The map of the gym's example.
EXAMPLE_MAP = CHECKOUT / "examples" / "example_map.yaml"
#: Distance between two cells that the middle line is searched in, m.
CELL_M = 0.2
#: The middle line keeps at least this from what is occupied, m.
CLEARANCE_M = 0.3
#: Distance between two rows of the middle line, m, and over how much of it each is smoothed.
ROW_M, SMOOTH_M = 0.2, 0.8
#: The road reaches at most this far to each side, m.
SIDE_MAX_M = 4.0


def chosen_map() -> Path:
    """The map of the environment variable, or that of the gym's example."""
    return Path(os.environ.get(MAP_VARIABLE) or EXAMPLE_MAP).resolve()


class Walls:
    """What is occupied on a map, as the gym's scan simulator reads it."""

    def __init__(self, path: Path) -> None:
        image = path.with_suffix(".png")
        for needed in (path, image):
            if not needed.is_file():
                raise ImportError(f"{needed}: no such file; {MAP_VARIABLE} names a map's .yaml, with its .png beside it")
        reader = ScanSimulator2D(2, 1.0)
        reader.set_map(str(path), ".png")
        #: Distance of each cell to what is occupied, m; rows go along y.
        self.clear_m, self.cell_m = reader.dt, float(reader.map_resolution)
        if self.clear_m.ndim != 2:
            raise ImportError(f"{image}: the gym reads images of grey values alone")
        self.origin = np.array(reader.origin[:2], dtype=float)
        if reader.origin[2] != 0:
            raise ImportError(f"{path}: a map that is turned is not supported")

    def clearance_m(self, places: np.ndarray) -> np.ndarray:
        """Distance of places (n, 2) to what is occupied, m; 0 beyond the map."""
        column, row = np.floor((places - self.origin) / self.cell_m).astype(int).T
        height, width = self.clear_m.shape
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        return np.where(inside, self.clear_m[row.clip(0, height - 1), column.clip(0, width - 1)], 0.0)

    def free_m(self, places: np.ndarray, ways: np.ndarray) -> np.ndarray:
        """How far it is free from places in directions, m, up to `SIDE_MAX_M`."""
        gone_m = np.zeros(len(places))
        for _ in range(100):
            step_m = self.clearance_m(places + ways * gone_m[:, None])
            gone_m = np.minimum(gone_m + np.where(step_m > self.cell_m / 2, step_m, 0.0), SIDE_MAX_M)
        return gone_m


class _Cells:
    """The free cells of a map as a graph, coarser than the map."""

    def __init__(self, walls: Walls) -> None:
        every = max(1, round(CELL_M / walls.cell_m))
        clear_m = walls.clear_m[every // 2 :: every, every // 2 :: every]
        self.is_free = clear_m > CLEARANCE_M
        self.step_m = every * walls.cell_m
        first = walls.origin + (every // 2 + 0.5) * walls.cell_m
        rows, columns = np.indices(clear_m.shape)
        self.places = first + np.stack([columns, rows], axis=-1).reshape(-1, 2) * self.step_m
        self.clear_m = clear_m.ravel()

    def graph(self, closed: np.ndarray) -> coo_matrix:
        """Costs between neighbours, high near walls; cells that are `closed` have none."""
        numbers = np.arange(self.is_free.size).reshape(self.is_free.shape)
        is_open = self.is_free & ~closed.reshape(self.is_free.shape)
        starts, ends, costs = [], [], []
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
            here = (slice(0, -1 if down else None), slice(max(0, -right), -right if right > 0 else None))
            there = (slice(down, None), slice(max(0, right), right if right < 0 else None))
            both = is_open[here] & is_open[there]
            a, b = numbers[here][both], numbers[there][both]
            nearest_m = np.minimum(self.clear_m[a], self.clear_m[b])
            starts.append(a)
            ends.append(b)
            costs.append(math.hypot(down, right) * self.step_m / nearest_m**2)
        columns = [np.concatenate(part) for part in (costs, starts, ends)]
        size = self.is_free.size
        return coo_matrix((columns[0], (columns[1], columns[2])), shape=(size, size)).tocsr()


def _start(cells: _Cells, walls: Walls) -> tuple[np.ndarray, np.ndarray]:
    """A place on the road near the map's origin, and the direction in which it is open."""
    far_m = np.where(cells.is_free.ravel(), np.hypot(*cells.places.T), np.inf)
    if not np.isfinite(far_m.min()):
        raise ImportError("the map has no free place")
    near = cells.places[np.argmin(far_m)]
    around = np.hypot(*(cells.places - near).T) < 1.0
    place = cells.places[np.argmax(np.where(around, cells.clear_m, 0.0))]
    angles_rad = np.linspace(0.0, math.pi, 90, endpoint=False)
    ways = np.stack([np.cos(angles_rad), np.sin(angles_rad)], axis=1)
    places = np.repeat(place[None], len(ways), axis=0)
    # Across the road both walls are near.
    across = ways[np.argmin(walls.free_m(places, ways) + walls.free_m(places, -ways))]
    return place, np.array([across[1], -across[0]])


def _ring(cells: _Cells, walls: Walls) -> np.ndarray:
    """The cells of a way round, from one side of a cut across the road to the other."""
    start, way = _start(cells, walls)
    across = np.array([-way[1], way[0]])
    beside = cells.places - start
    ahead_m, left_m = beside @ way, beside @ across
    sides_m = walls.free_m(np.array([start, start]), np.array([across, -across]))
    is_cut = (np.abs(ahead_m) < cells.step_m) & (left_m < sides_m[0] + 0.2) & (left_m > -sides_m[1] - 0.2)
    ends = [np.argmin(np.hypot(ahead_m - side * 2.5 * cells.step_m, left_m)) for side in (1, -1)]
    costs, before = dijkstra(cells.graph(is_cut), directed=False, indices=ends[0], return_predecessors=True)
    if not np.isfinite(costs[ends[1]]):
        raise ImportError("the road of the map does not lead back to its start")
    found = [ends[1]]
    while found[-1] != ends[0]:
        found.append(before[found[-1]])
    return cells.places[found]


def _even(places: np.ndarray) -> np.ndarray:
    """A closed line with rows at even distances, smoothed."""
    closed = np.vstack([places, places[:1]])
    along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    count = round(along_m[-1] / ROW_M)
    parts_m = np.linspace(0.0, along_m[-1], count, endpoint=False)
    rows = np.stack([np.interp(parts_m, along_m, closed[:, axis]) for axis in (0, 1)], axis=1)
    return gaussian_filter1d(rows, SMOOTH_M / ROW_M, axis=0, mode="wrap")


def _sides(places: np.ndarray, walls: Walls) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """To the left of each row: the direction; and how far the road reaches to both sides."""
    ahead = np.roll(places, -1, axis=0) - np.roll(places, 1, axis=0)
    ahead /= np.hypot(*ahead.T)[:, None]
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    return left, walls.free_m(places, left), walls.free_m(places, -left)


def track(path: Path) -> Route:
    """The road of a map, counter-clockwise."""
    walls = Walls(path)
    places = _even(_ring(_Cells(walls), walls))
    x_m, y_m = places.T
    if np.sum(x_m * np.roll(y_m, -1) - np.roll(x_m, -1) * y_m) < 0:
        places = places[::-1]
    # To the middle between both walls.
    left, left_m, right_m = _sides(places, walls)
    places = _even(places + left * np.clip((left_m - right_m) / 2, -0.5, 0.5)[:, None])
    _, left_m, right_m = _sides(places, walls)
    return Route(places, left_m, right_m, is_closed=True)
