"""What the world refuses, and what enters the digest.

    python -m unittest discover -s sim/metadrive
"""

import hashlib
import math
import struct
import unittest

import wire_layout as layout
from member import record
from score import Score, is_admitted

LIMIT_NS = 250_000_000
NOW_NS = 10_000_000_000


def command(**changes):
    values = {"steer": 0.25, "pedal": -0.5, "driver": layout.Driver.EXPERT, "reason": 2}
    taken_ns = changes.pop("taken_ns", NOW_NS)
    made = layout.Command(**{**values, **changes})
    made.header.taken_ns = taken_ns
    return made


class Door(unittest.TestCase):
    def test_a_good_command_passes(self):
        for taken_ns in (NOW_NS, NOW_NS - LIMIT_NS, NOW_NS + layout.FUTURE_TOLERANCE_NS):
            self.assertTrue(is_admitted(command(taken_ns=taken_ns), NOW_NS, LIMIT_NS))

    def test_what_is_old_from_the_future_or_no_number_in_range_is_refused(self):
        bad = [
            command(taken_ns=NOW_NS - LIMIT_NS - 1),
            command(taken_ns=NOW_NS + layout.FUTURE_TOLERANCE_NS + 1),
            command(steer=math.nan),
            command(pedal=math.inf),
            command(steer=1.0 + 1e-12),
            command(pedal=-1.5),
            command(driver=3),
            command(reason=99),
        ]
        for refused in bad:
            self.assertFalse(is_admitted(refused, NOW_NS, LIMIT_NS), refused)


class Account(unittest.TestCase):
    def test_every_command_obeyed_enters_the_digest_and_silence_brakes(self):
        class World:
            ticks, completion, driven_m = 2, 0.5, 3.0

        score = Score(7)
        self.assertEqual(score.obey(command(), NOW_NS), (0.25, -0.5))
        self.assertEqual(score.obey(None, NOW_NS), (0.0, -1.0))
        episode = score.episode(World, layout.Outcome.STOPPED)
        bits = struct.pack("<ddIIddII", 0.25, -0.5, 0, 2, 0.0, -1.0, 2, 10)
        self.assertEqual(bytes(episode.command_digest), hashlib.sha256(bits).digest())
        self.assertEqual(episode.braked, 1)

    def test_durations_fall_into_the_buckets_of_the_wire(self):
        # From 16384 ns on, 128 buckets to each doubling.
        for ns, bucket in ((0, 0), (63, 0), (64, 1), (16_383, 255), (16_384, 256), (1 << 63, -1)):
            histogram = layout.Histogram()
            record(histogram, ns)
            self.assertEqual(histogram.buckets[bucket % layout.HISTOGRAM_BUCKETS], 1, ns)
            self.assertEqual((histogram.count, histogram.max_ns), (1, ns))


if __name__ == "__main__":
    unittest.main()
