"""Which requests for pictures are answered, and where points are seen.

    python -m unittest discover -s sim/metadrive
"""

import math
import unittest

import wire_layout as layout
from lens import Lens, admit
from wire_layout import RefusalKind

PERIOD_NS = 100_000_000


def request(**changes):
    values = {"view": layout.View.TOP_DOWN, "width": 480, "height": 480}
    header = {"tick": 50, "episode": 3}
    header.update({key: changes.pop(key) for key in ("tick", "episode") if key in changes})
    made = layout.FrameRequest(**{**values, **changes})
    for key, value in header.items():
        setattr(made.header, key, value)
    return made


class Requests(unittest.TestCase):
    def refusal(self, request):
        return admit(request, layout.Header(tick=60, episode=3), PERIOD_NS)

    def test_what_a_frame_can_hold_is_a_request(self):
        for size in ((64, 64), (480, 480), (960, 720), (2048, 337)):
            self.assertIsNone(self.refusal(request(width=size[0], height=size[1])), size)
        self.assertIsNone(self.refusal(request(view=layout.View.EGO)), "answered from above")
        steered = request()
        steered.proposals[1].steer = math.nan
        for bad in (
            steered,
            request(view=7),
            request(width=0),
            request(height=63),
            request(width=2049, height=64),
            request(width=961, height=720),
            request(width=0xFFFFFFFF, height=0xFFFFFFFF),
        ):
            size = (bad.view, bad.width, bad.height)
            self.assertEqual(self.refusal(bad), RefusalKind.CONTENT, size)

    def test_a_request_is_due_for_a_second(self):
        stale, future = RefusalKind.STALE, RefusalKind.FUTURE
        for tick, why in ((60, None), (59, None), (50, None), (49, stale), (61, future)):
            self.assertEqual(self.refusal(request(tick=tick)), why, tick)
        for episode in (2, 4):
            other = request(tick=60, episode=episode)
            self.assertEqual(self.refusal(other), RefusalKind.EPISODE)


class Camera(unittest.TestCase):
    def test_the_matrix_says_where_points_are_drawn(self):
        for width, height in ((480, 480), (960, 720), (300, 640)):
            lens, camera = Lens(width, height), layout.Camera()
            lens.fill(camera)
            rows = [camera.pixel_from_body[4 * k : 4 * k + 4] for k in range(3)]
            for point in ((0.0, 0.0), (12.5, -3.0), (-8.0, 29.0)):
                u, v, w = (row[0] * point[0] + row[1] * point[1] + row[3] for row in rows)
                self.assertEqual((u / w, v / w), lens.pixel(*point))
            self.assertEqual(lens.pixel(0.0, 0.0), (width / 2, height * layout.TOP_DOWN_AHEAD))
            self.assertEqual(lens.pixel(0.0, layout.TOP_DOWN_ACROSS_M / 2)[0], 0.0)
            corner = ((height * layout.TOP_DOWN_AHEAD) ** 2 + (width / 2) ** 2) ** 0.5
            self.assertGreaterEqual(lens.reach_m * lens.px_per_m, corner - 1e-9)
            self.assertEqual((camera.view, camera.orthographic), (layout.View.TOP_DOWN, 1))


if __name__ == "__main__":
    unittest.main()
