"""Pictures of the scene from above, heading up, for the judge: on request.

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
from lens import Lens, admit
from member import monotonic_ns
from wire_layout import Palette

# From corner to corner of a drawn lane edge, and dash and gap of a broken line, m.
EDGE_STEP_M = 2.0
GAP_M = 4.0
# Width of a drawn line, m.
LINE_M = 0.2
# Nothing is drawn thinner than this, pixels: a cone would not be seen.
LEAST_PX = 5.0
# A picture is begun only with this many times its greatest cost as slack.
SLACK_FACTOR = 2
# The assumed cost of the first picture, ns.
FIRST_COST_NS = 20_000_000
# Share of the greatest cost that is remembered when a tick had no slack for it:
# one slow picture must not be the last one.
REMEMBERED = 0.9


class _Shape:
    """Points of the world frame that do not move, and where they are about."""

    def __init__(self, points, colour):
        self.points = np.asarray([(point[0], point[1]) for point in points])
        self.colour = colour
        self.centre = (self.points.min(axis=0) + self.points.max(axis=0)) / 2
        self.radius = float(np.hypot(*(self.points - self.centre).T).max())


class FrameServer:
    """Takes a picture when one is asked for and no tick is delayed by it."""

    def __init__(self, world, ports, period_ns):
        self._world = world
        self._requests, self._port = ports
        self._period_ns = period_ns
        self._request = None
        self._surface = None
        self._areas, self._lines, self._dashes = [], [], []
        self._surveyed = False
        self._cost_ns = FIRST_COST_NS
        self._frame = layout.Frame(format=layout.PixelFormat.RGB8)
        self.taken = 0
        self.declined = 0

    def begin_episode(self):
        """The map has changed."""
        self._surveyed = False

    @property
    def needed_ns(self):
        """Time until the next tick without which no picture is begun."""
        return SLACK_FACTOR * self._cost_ns

    def take_if_asked(self, header, slack_ns):
        """Publishes a picture of the observation of `header`, from above for any
        requested view: there is no other here, and the frame's camera says so.
        `slack_ns` is the time until the next tick, None in lockstep, which has no
        deadline. A request waits for slack until it is too old."""
        door = lambda request: admit(request, header, self._period_ns)
        request = self._requests.newest(door)
        if request is not None:
            self.declined += self._request is not None
            self._request = request
        request = self._request
        if request is None:
            return
        # It may have waited for slack since it was admitted.
        if door(request) is not None:
            self._request = None
            self.declined += 1
            return
        if slack_ns is not None and slack_ns < self.needed_ns:
            self._cost_ns = max(self._cost_ns * REMEMBERED, FIRST_COST_NS)
            return
        if not self._surveyed:
            self._survey()
            if slack_ns is not None:
                # That was enough for one tick.
                return
        begun_ns = monotonic_ns()
        self._request = None
        self._publish(header, Lens(request.width, request.height))
        self.taken += 1
        self._cost_ns = max(self._cost_ns, monotonic_ns() - begun_ns)

    def _publish(self, header, lens):
        if self._surface is None or self._surface.get_size() != lens.size:
            self._surface = pygame.Surface(lens.size, depth=24)
        self._draw(lens)
        pixels = pygame.image.tobytes(self._surface, "RGB")
        ctypes.memmove(self._frame.pixels, pixels, len(pixels))
        self._frame.width, self._frame.height = lens.size
        lens.fill(self._frame.camera)
        self._frame.header = header
        self._port.send(self._frame)

    def _survey(self):
        """The ground of the episode's map; done when first looked at, not at reset."""
        current = self._world.env.current_map
        blocks = current.blocks
        self._areas = [
            _Shape(sidewalk["polygon"], Palette.SIDEWALK)
            for block in blocks
            for sidewalk in block.sidewalks.values()
        ]
        self._lines, self._dashes = [], []
        for roads in current.road_network.graph.values():
            for lanes in roads.values():
                self._areas += [_Shape(lane.polygon, Palette.ROAD) for lane in lanes]
                for lane in lanes:
                    # A line on the right is only painted for a road's last lane.
                    sides = (-1, 1) if lane is lanes[-1] else (-1,)
                    for kind, colour, side in zip(lane.line_types, lane.line_colors, sides):
                        self._survey_line(lane, str(kind).upper(), colour, side)
        self._surveyed = True

    def _survey_line(self, lane, kind, colour, side):
        lateral = side * lane.width / 2
        if "NONE" in kind or "UNKNOWN" in kind:
            return
        if "BROKEN" in kind:
            begins = np.arange(GAP_M / 2, lane.length, EDGE_STEP_M + GAP_M)
            ends = np.minimum(begins + EDGE_STEP_M, lane.length)
            alongs = np.column_stack((begins, ends)).ravel()
        else:
            count = max(int(lane.length / EDGE_STEP_M), 1) + 1
            alongs = np.linspace(0.0, lane.length, count)
        points = [lane.position(along, lateral) for along in alongs]
        if "BROKEN" in kind:
            if points:
                self._dashes.append(_Shape(points, Palette.LINE_BROKEN))
            return
        # Between the two directions lines are yellow: they lack blue.
        is_centre = len(colour) > 2 and colour[2] < 0.5
        paint = Palette.LINE_CENTRE if is_centre else Palette.LINE_SOLID
        self._lines.append(_Shape(points, paint))

    def _draw(self, lens):
        ego = self._world.vehicle
        origin = np.asarray((ego.position[0], ego.position[1]))
        heading = ego.heading_theta
        body_from_world = np.asarray(
            ((math.cos(heading), math.sin(heading)), (-math.sin(heading), math.cos(heading)))
        )

        def pixels(points):
            forward, left = ((points - origin) @ body_from_world.T).T
            return np.floor(np.column_stack(lens.pixel(forward, left))).tolist()

        def near(shapes):
            return (
                shape
                for shape in shapes
                if np.hypot(*(shape.centre - origin)) < lens.reach_m + shape.radius
            )

        width = max(round(LINE_M * lens.px_per_m), 1)
        self._surface.fill(Palette.GROUND)
        for shape in near(self._areas):
            pygame.draw.polygon(self._surface, shape.colour, pixels(shape.points))
        for shape in near(self._dashes):
            ends = pixels(shape.points)
            for begin, end in zip(ends[::2], ends[1::2]):
                pygame.draw.line(self._surface, shape.colour, begin, end, width)
        for shape in near(self._lines):
            pygame.draw.lines(self._surface, shape.colour, False, pixels(shape.points), width)
        least_m = LEAST_PX / lens.px_per_m
        for body in self._world.env.engine.get_objects().values():
            corners = _corners(body, least_m)
            if corners is not None and np.hypot(*(corners[0] - origin)) < 2 * lens.reach_m:
                colour = Palette.VEHICLE if isinstance(body, BaseVehicle) else Palette.OBJECT
                colour = Palette.EGO if body is ego else colour
                outline = pixels(corners)
                pygame.draw.polygon(self._surface, colour, outline)
                pygame.draw.polygon(self._surface, Palette.RIM, outline, 1)


def _corners(body, least_m):
    """The corners of a body's box in the world frame, at least so thick;
    None for what has none."""
    try:
        half_length, half_width = body.LENGTH / 2, body.WIDTH / 2
    except (AttributeError, TypeError):
        return None
    if not half_length > 0 or not half_width > 0:
        return None
    half_length, half_width = max(half_length, least_m / 2), max(half_width, least_m / 2)
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
