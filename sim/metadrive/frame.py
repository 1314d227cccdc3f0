"""Pictures of the scene from above, heading up, for the judge.

Drawn with pygame on a surface in memory: no screen and no model files are needed.
"""

import ctypes
import math
import os

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")

import numpy as np
import pygame
from metadrive.component.vehicle.base_vehicle import BaseVehicle

import wire_layout as layout
from member import monotonic_ns

# A picture a second: a vision-language model needs longer for one answer.
FRAME_PERIOD_NS = 1_000_000_000
# 60 m across at 8 pixels a metre; the car stands at three quarters of the height,
# so 45 m ahead are seen, nearly the reach of the lidar.
WIDTH = HEIGHT = 480
PIXELS_PER_M = 8.0
CENTRE_U, CENTRE_V = 240.0, 360.0
# From the car to the farthest corner, m; what is beyond is not drawn.
REACH_M = math.hypot(CENTRE_U, CENTRE_V) / PIXELS_PER_M
# An orthographic camera sees the same from any height; above everything, m.
CAMERA_HEIGHT_M = 50.0
# From corner to corner of a drawn lane edge, m.
EDGE_STEP_M = 2.0
# A picture is begun only with this many times its greatest cost as slack.
SLACK_FACTOR = 2
# What the first picture is taken to cost, ns.
FIRST_COST_NS = 20_000_000

GROUND = (60, 90, 60)
ROAD = (70, 70, 75)
SOLID = (235, 235, 235)
BROKEN = (150, 150, 150)
EGO = (240, 240, 240)
VEHICLE = (230, 160, 40)
OBJECT = (200, 60, 60)

# Row-major 3 x 4 from homogeneous body coordinates to homogeneous pixels.
PIXEL_FROM_BODY = (
    *(0.0, -PIXELS_PER_M, 0.0, CENTRE_U),
    *(-PIXELS_PER_M, 0.0, 0.0, CENTRE_V),
    *(0.0, 0.0, 0.0, 1.0),
)


class _Shape:
    """Points of the world frame that do not move, and where they are about."""

    def __init__(self, points, colour):
        self.points = np.asarray([(point[0], point[1]) for point in points])
        self.colour = colour
        self.centre = (self.points.min(axis=0) + self.points.max(axis=0)) / 2
        self.radius = float(np.hypot(*(self.points - self.centre).T).max())


class Photographer:
    """Takes a picture when one is due, somebody looks, and no tick is delayed."""

    def __init__(self, world, port, period_ns):
        self._world = world
        self._port = port
        self._surface = pygame.Surface((WIDTH, HEIGHT), depth=24)
        self._lanes, self._edges = [], []
        self._surveyed = False
        self._ticks = max(round(FRAME_PERIOD_NS / period_ns), 1)
        self._due_tick = 0
        self._cost_ns = FIRST_COST_NS
        self._frame = layout.Frame(
            width=WIDTH, height=HEIGHT, format=layout.PixelFormat.RGB8
        )
        camera = self._frame.camera
        camera.pixel_from_body[:] = PIXEL_FROM_BODY
        camera.position_body_m[2] = CAMERA_HEIGHT_M
        camera.near_m = 0.0
        camera.view = layout.View.TOP_DOWN
        camera.orthographic = 1

    def begin_episode(self):
        """The map has changed."""
        self._surveyed = False

    def take_if_due(self, header, slack_ns):
        """Publishes a picture of the observation of `header`; `slack_ns` is the
        time until the next tick, None in lockstep, which has no deadline."""
        if header.tick < self._due_tick or not self._port.has_readers():
            return
        if slack_ns is not None and slack_ns < SLACK_FACTOR * self._cost_ns:
            return
        begun_ns = monotonic_ns()
        self._draw()
        pixels = pygame.image.tobytes(self._surface, "RGB")
        ctypes.memmove(self._frame.pixels, pixels, len(pixels))
        self._frame.header = header
        self._port.send(self._frame)
        self._due_tick = header.tick + self._ticks
        self._cost_ns = max(self._cost_ns, monotonic_ns() - begun_ns)

    def _survey(self):
        """The lanes of the episode's map; done when first looked at, not at reset."""
        self._lanes, self._edges = [], []
        for lane in self._world.env.current_map.road_network.get_all_lanes():
            self._lanes.append(_Shape(lane.polygon, ROAD))
            count = max(int(lane.length / EDGE_STEP_M), 1) + 1
            alongs = np.linspace(0.0, lane.length, count)
            for kind, side in zip(lane.line_types, (-1, 1)):
                lateral = side * lane.width / 2
                points = [lane.position(along, lateral) for along in alongs]
                kind = str(kind).upper()
                if "NONE" not in kind and "UNKNOWN" not in kind:
                    self._edges.append(_Shape(points, BROKEN if "BROKEN" in kind else SOLID))
        self._surveyed = True

    def _draw(self):
        if not self._surveyed:
            self._survey()
        ego = self._world.vehicle
        origin = np.asarray((ego.position[0], ego.position[1]))
        heading = ego.heading_theta
        body_from_world = np.asarray(
            ((math.cos(heading), math.sin(heading)), (-math.sin(heading), math.cos(heading)))
        )

        def pixels(points):
            body = (points - origin) @ body_from_world.T
            u = CENTRE_U - PIXELS_PER_M * body[:, 1]
            v = CENTRE_V - PIXELS_PER_M * body[:, 0]
            return np.floor(np.column_stack((u, v))).tolist()

        self._surface.fill(GROUND)
        for shape in self._lanes:
            if np.hypot(*(shape.centre - origin)) < REACH_M + shape.radius:
                pygame.draw.polygon(self._surface, shape.colour, pixels(shape.points))
        for shape in self._edges:
            if np.hypot(*(shape.centre - origin)) < REACH_M + shape.radius:
                pygame.draw.lines(self._surface, shape.colour, False, pixels(shape.points), 2)
        for body in self._world.env.engine.get_objects().values():
            corners = _corners(body)
            if corners is not None and np.hypot(*(corners[0] - origin)) < 2 * REACH_M:
                is_vehicle = isinstance(body, BaseVehicle)
                colour = EGO if body is ego else VEHICLE if is_vehicle else OBJECT
                pygame.draw.polygon(self._surface, colour, pixels(corners))


def _corners(body):
    """The corners of a body's box in the world frame; None for what has none."""
    try:
        half_length, half_width = body.LENGTH / 2, body.WIDTH / 2
    except (AttributeError, TypeError):
        return None
    heading = body.heading_theta
    forward = np.asarray((math.cos(heading), math.sin(heading))) * half_length
    left = np.asarray((-math.sin(heading), math.cos(heading))) * half_width
    centre = np.asarray((body.position[0], body.position[1]))
    return np.asarray(
        [
            centre + forward + left,
            centre + forward - left,
            centre - forward - left,
            centre - forward + left,
        ]
    )
