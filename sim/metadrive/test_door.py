"""What the world refuses, and what enters the digest.

    python -m unittest discover -s sim/metadrive
"""

import hashlib
import math
import struct
import unittest

import wire_layout as layout
from door import admit, admit_answer
from grid import Grid, first_instant, phase_ns
from member import CONTEST_NS, Contest, record
from score import Score
from wire_layout import RefusalKind

LIMIT_NS = 250_000_000
NOW_NS = 10_000_000_000
PERIOD_NS = 100_000_000
EPISODE = 3
ASKED = 40


def command(**changes):
    values = {"steer": 0.25, "pedal": -0.5, "driver": layout.Driver.EXPERT, "reason": 2}
    header = {"taken_ns": NOW_NS, "episode": EPISODE, "tick": ASKED}
    header.update({key: changes.pop(key) for key in header if key in changes})
    return layout.Command(layout.Header(**header), **{**values, **changes})


MALFORMED = [
    command(steer=math.nan),
    command(pedal=math.inf),
    command(steer=1.0 + 1e-12),
    command(pedal=-1.5),
    command(driver=3),
    command(reason=99),
]


class Door(unittest.TestCase):
    def refusal(self, command):
        return admit(command, NOW_NS, LIMIT_NS, EPISODE)

    def answer(self, command):
        return admit_answer(command, ASKED, EPISODE)

    def test_a_good_command_passes(self):
        for taken_ns in (NOW_NS, NOW_NS - LIMIT_NS, NOW_NS + layout.FUTURE_TOLERANCE_NS):
            self.assertIsNone(self.refusal(command(taken_ns=taken_ns)))
        self.assertIsNone(self.answer(command()))

    def test_a_refused_command_is_refused_with_its_reason(self):
        old, ahead = NOW_NS - LIMIT_NS - 1, NOW_NS + layout.FUTURE_TOLERANCE_NS + 1
        self.assertEqual(self.refusal(command(taken_ns=old)), RefusalKind.STALE)
        self.assertEqual(self.refusal(command(taken_ns=ahead)), RefusalKind.FUTURE)
        for episode in (EPISODE - 1, EPISODE + 1):
            self.assertEqual(self.refusal(command(episode=episode)), RefusalKind.EPISODE)
        for malformed in MALFORMED:
            self.assertEqual(self.refusal(malformed), RefusalKind.CONTENT)

    def test_in_lockstep_only_the_answer_to_the_asked_tick_passes(self):
        self.assertIsNone(self.answer(command(taken_ns=0)), "time is counted in ticks")
        self.assertEqual(self.answer(command(tick=ASKED - 1)), RefusalKind.STALE)
        self.assertEqual(self.answer(command(tick=ASKED + 1)), RefusalKind.FUTURE)
        self.assertEqual(self.answer(command(episode=EPISODE - 1)), RefusalKind.EPISODE)
        for malformed in MALFORMED:
            self.assertEqual(self.answer(malformed), RefusalKind.CONTENT)


class Brake(unittest.TestCase):
    def test_it_holds_while_foreign_messages_come_and_a_second_longer(self):
        contest = Contest()
        self.assertFalse(contest.look(0, 5))
        self.assertTrue(contest.look(1, 10))
        self.assertTrue(contest.look(1, 10 + CONTEST_NS - 1))
        self.assertTrue(contest.look(2, 10 + CONTEST_NS), "another one came")
        self.assertFalse(contest.look(2, 10 + 2 * CONTEST_NS))


class Instants(unittest.TestCase):
    def test_the_phase_of_a_run_is_the_hash_of_its_name(self):
        # Of the authors of FNV-1a, 64 bits; and their remainders.
        self.assertEqual(phase_ns("a", 1 << 64), 0xAF63DC4C8601EC8C)
        self.assertEqual(phase_ns("foobar", 1 << 64), 0x85944171F73967E8)
        self.assertEqual(phase_ns("a", PERIOD_NS), 55_641_996)
        self.assertEqual(phase_ns("foobar", PERIOD_NS), 32_436_968)

    def test_every_world_of_a_run_ticks_on_its_grid(self):
        # As `RunGrid::first_instant` gives for the same name, period and now.
        self.assertEqual(first_instant("a", PERIOD_NS, 5_123_456_789), 5_255_641_996)
        self.assertEqual(first_instant("foobar", PERIOD_NS, 5_123_456_789), 5_232_436_968)
        for name in ("a", "foobar"):
            for passed_ns in (0, 1, PERIOD_NS // 3, PERIOD_NS, 7 * PERIOD_NS + 12_345):
                now_ns = 5_123_456_789 + passed_ns
                grid = Grid(False, PERIOD_NS, first_instant(name, PERIOD_NS, now_ns))
                self.assertIn(grid.instant_ns(0) - now_ns, range(PERIOD_NS, 2 * PERIOD_NS))
                for tick in (0, 1, 1000):
                    off_ns = grid.instant_ns(tick) - phase_ns(name, PERIOD_NS)
                    self.assertEqual(off_ns % PERIOD_NS, 0, (name, passed_ns, tick))


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
