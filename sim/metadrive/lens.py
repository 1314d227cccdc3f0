"""Which pictures can be asked for, and the camera that takes them."""

import math

import wire_layout as layout
from door import is_normalised
from wire_layout import RefusalKind

# What is asked for may be older than what is drawn, which is always now, ns.
REQUEST_AGE_NS = 1_000_000_000


def admit(request, header, period_ns):
    """The door for requests, which any process may make: what a frame can hold, of
    the observation of `header` or of one shortly before it. The RefusalKind of one
    that is refused, else None."""
    if not _is_well_formed(request):
        return RefusalKind.CONTENT
    if request.header.episode != header.episode:
        return RefusalKind.EPISODE
    age_ns = (header.tick - request.header.tick) * period_ns
    if age_ns < 0:
        return RefusalKind.FUTURE
    return RefusalKind.STALE if age_ns > REQUEST_AGE_NS else None


def _is_well_formed(request):
    sides = range(layout.FRAME_SIDE_MIN_PX, layout.FRAME_SIDE_MAX_PX + 1)
    return (
        all(is_normalised(p.steer) and is_normalised(p.pedal) for p in request.proposals)
        and request.view in layout.View.WORDS
        and request.width in sides
        and request.height in sides
        and request.width * request.height * 3 <= layout.FRAME_BYTES_MAX
    )


class Lens:
    """The camera over the car: body coordinates to pixels."""

    def __init__(self, width, height):
        self.size = (width, height)
        self.px_per_m = width / layout.TOP_DOWN_ACROSS_M
        self.centre_u = width / 2
        self.centre_v = height * layout.TOP_DOWN_AHEAD
        # From the car to the farthest corner, m; what is beyond is not drawn.
        farthest_v = max(self.centre_v, height - self.centre_v)
        self.reach_m = math.hypot(self.centre_u, farthest_v) / self.px_per_m

    def fill(self, camera):
        """Writes itself down, row by row of its 3 x 4 matrix."""
        camera.pixel_from_body[:] = (
            *(0.0, -self.px_per_m, 0.0, self.centre_u),
            *(-self.px_per_m, 0.0, 0.0, self.centre_v),
            *(0.0, 0.0, 0.0, 1.0),
        )
        camera.position_body_m[:] = (0.0, 0.0, layout.TOP_DOWN_HEIGHT_M)
        camera.near_m = 0.0
        camera.view = layout.View.TOP_DOWN
        camera.orthographic = 1

    def pixel(self, forward_m, left_m):
        """Pixel of a point, or of arrays of them, in the frame of the car."""
        return self.centre_u - self.px_per_m * left_m, self.centre_v - self.px_per_m * forward_m
