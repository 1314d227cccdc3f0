"""When pictures are taken, and that they show what is there.

    python -m unittest discover -s sim/metadrive
"""

import unittest
from types import SimpleNamespace

import wire_layout as layout
from frame import FIRST_COST_NS, SLACK_FACTOR, FrameServer
from wire_layout import Palette, RefusalKind

PERIOD_NS = 100_000_000
AMPLE_NS = 10 * PERIOD_NS


class Lane:
    """Straight along x, 3.5 m wide, from 10 m behind the car."""

    width, length = 3.5, 110.0
    line_types, line_colors = ("broken", "continuous"), ((1, 1, 1, 1), (1, 1, 1, 1))
    polygon = ((-10, -1.75), (100, -1.75), (100, 1.75), (-10, 1.75))

    def position(self, along, lateral):
        return along - 10.0, -lateral


class Port:
    """Both ends of a port."""

    def __init__(self):
        self.message = None
        self.refused = []

    def newest(self, admit):
        newest, self.message = self.message, None
        if newest is not None and (refusal := admit(newest)) is not None:
            self.refused.append(refusal)
            return None
        return newest

    send = lambda self, message: setattr(self, "message", message)


def scene():
    """A car on one lane, a cone ten metres ahead of it."""
    box = lambda x, length, width: SimpleNamespace(
        position=(x, 0.0), heading_theta=0.0, LENGTH=length, WIDTH=width
    )
    car, cone, ghost = box(0.0, 4.5, 1.8), box(10.0, 0.2, 0.2), SimpleNamespace()
    network = SimpleNamespace(graph={"a": {"b": [Lane()]}})
    env = SimpleNamespace(
        current_map=SimpleNamespace(blocks=[], road_network=network),
        engine=SimpleNamespace(get_objects=lambda: {1: car, 2: cone, 3: ghost}),
    )
    return SimpleNamespace(vehicle=car, env=env)


class Taking(unittest.TestCase):
    def setUp(self):
        self.requests, self.frames = Port(), Port()
        self.frame_server = FrameServer(scene(), (self.requests, self.frames), PERIOD_NS)

    def ask(self, tick, **changes):
        values = {"view": layout.View.TOP_DOWN, "width": 240, "height": 320, **changes}
        self.requests.message = layout.FrameRequest(**values)
        self.requests.message.header.tick = tick

    def tick(self, tick, slack_ns=None):
        self.frame_server.take_if_asked(layout.Header(tick=tick, taken_ns=tick), slack_ns)
        return self.frames.newest(lambda _: None)

    def test_nothing_is_drawn_without_a_request(self):
        self.assertIsNone(self.tick(0))
        self.ask(1)
        frame = self.tick(1)
        self.assertEqual((frame.header.tick, frame.width, frame.height), (1, 240, 320))
        self.assertIsNone(self.tick(2), "once for each request")

    def test_the_picture_is_of_now_and_says_so(self):
        self.ask(20)
        frame = self.tick(30)
        self.assertEqual((frame.header.tick, frame.header.taken_ns), (30, 30))
        self.ask(20)
        self.assertIsNone(self.tick(31), "over a second old")
        self.ask(20, width=10)
        self.assertIsNone(self.tick(20), "too narrow")
        self.assertEqual(self.requests.refused, [RefusalKind.STALE, RefusalKind.CONTENT])
        self.assertEqual((self.frame_server.taken, self.frame_server.declined), (1, 0))

    def test_a_bad_request_does_not_displace_a_good_one_that_waits(self):
        self.ask(1)
        self.assertIsNone(self.tick(1, 0), "no slack")
        self.ask(1, width=10)
        self.assertIsNone(self.tick(2, 0), "no slack")
        self.assertEqual(self.tick(3).width, 240)

    def test_a_request_that_waited_over_a_second_is_declined(self):
        self.ask(1)
        for tick in (1, 11):
            self.assertIsNone(self.tick(tick, 0), "no slack")
        self.assertIsNone(self.tick(12))
        self.assertEqual((self.frame_server.taken, self.frame_server.declined), (0, 1))

    def test_a_tick_without_slack_is_not_delayed(self):
        self.ask(1)
        for tick in range(1, 4):
            self.assertIsNone(self.tick(tick, SLACK_FACTOR * FIRST_COST_NS - 1))
        self.assertIsNone(self.tick(4, AMPLE_NS), "the map is looked at first")
        self.assertEqual(self.tick(5, AMPLE_NS).header.tick, 5)

    def test_one_slow_picture_is_not_the_last(self):
        self.frame_server._cost_ns = 50 * PERIOD_NS
        taken = 0
        for tick in range(100):
            self.ask(tick)
            taken += self.tick(tick, PERIOD_NS) is not None
        self.assertGreater(taken, 10)

    def test_what_is_there_has_its_colour(self):
        self.ask(1)
        frame = self.tick(1)
        scale = 240 / layout.TOP_DOWN_ACROSS_M
        rgb = bytes(frame.pixels[: 240 * 320 * 3])

        def colour(forward_m, left_m):
            u, v = int(120 - scale * left_m), int(240 - scale * forward_m)
            return tuple(rgb[(v * 240 + u) * 3 :][:3])

        self.assertEqual(colour(0.0, 0.0), Palette.EGO)
        self.assertEqual(colour(10.0, 0.0), Palette.OBJECT)
        self.assertEqual(colour(5.0, 0.0), Palette.ROAD)
        self.assertEqual(colour(20.0, 5.0), Palette.GROUND)
        self.assertEqual(colour(-15.0, 0.0), Palette.GROUND)


if __name__ == "__main__":
    unittest.main()
