"""From which processes the world takes messages, and that no other hides a good one.

    python -m unittest discover -s sim/metadrive
"""

import math
import os
import shutil
import subprocess
import sys
import unittest
import unittest.mock
from types import SimpleNamespace

import wire_layout as layout
from door import admit
from member import SetUpError, join_as
from producers import Producers
from wire import FOREIGN_MAX, Port, Subscriber, Wire
from wire_layout import RefusalKind

NOW_NS = 10_000_000_000
LIMIT_NS = 250_000_000
EPISODE = 3
AUTHOR, CONTROLLER, SUCCESSOR = 100, 200, 300
# This process lives, and no roster below names it.
STRANGER = os.getpid()
# Above the kernel's largest process id.
DEAD = 0x7FFFFFFF


class Queue:
    """What the library's end of a port gives: samples in envelopes."""

    def __init__(self):
        self.sent = []
        self.lent = 0

    def put(self, sender, message, membership=None):
        """A process has one membership, unless the test names another."""
        membership = sender if membership is None else membership
        self.sent.append((sender, membership, bytes(message)))

    def receive(self):
        assert self.lent == 0, "a sample is lent at a time"
        if not self.sent:
            return None
        sender, membership, data = self.sent.pop(0)
        buffer = layout.ctypes.create_string_buffer(data, len(data))
        self.lent += 1
        node_id = SimpleNamespace(pid=lambda _service_type: sender, value=membership)
        return SimpleNamespace(
            header=SimpleNamespace(node_id=node_id),
            payload_ptr=layout.ctypes.addressof(buffer),
            buffer=buffer,
            delete=self._give_back,
        )

    def _give_back(self):
        self.lent -= 1


def roster(**pids):
    made = layout.Roster()
    for process, pid in pids.items():
        made.pids[getattr(layout.Process, process.upper())] = pid
    return made


def command(**changes):
    header = {"taken_ns": NOW_NS, "episode": EPISODE, "producer": CONTROLLER, "tick": 0}
    header.update({key: changes.pop(key) for key in header if key in changes})
    return layout.Command(layout.Header(**header), **changes)


class Fixture(unittest.TestCase):
    def setUp(self):
        self.rosters, self.queue = Queue(), Queue()
        self.producers = Producers(AUTHOR, Port(self.rosters, layout.Roster).receive)
        self.rosters.put(AUTHOR, roster(controller=CONTROLLER))

    def newest(self, service=layout.COMMAND):
        subscriber = Subscriber(Port(self.queue, service.message), service, self.producers)
        return subscriber.newest(lambda message: admit(message, NOW_NS, LIMIT_NS, EPISODE))

    def health(self):
        health = layout.Health()
        self.producers.report(health)
        return health

    def refused(self, **kinds):
        """The counts of the health message are these, and the others are 0."""
        words = layout.RefusalKind.WORDS
        found = {words[k]: n for k, n in enumerate(self.health().refused) if n > 0}
        self.assertEqual(found, kinds)


class Senders(Fixture):
    def test_the_process_that_the_roster_names_is_taken(self):
        self.queue.put(CONTROLLER, command(steer=0.5))
        self.assertEqual(self.newest().steer, 0.5)
        self.refused()
        self.assertEqual(self.producers.contests, 0)

    def test_a_foreign_process_is_refused_with_any_header(self):
        self.queue.put(CONTROLLER, command(steer=0.5))
        self.queue.put(STRANGER, command(steer=-1.0))
        self.assertEqual(self.newest().steer, 0.5)
        self.refused(foreign=1)
        self.assertEqual(self.producers.contests, 1)
        health = self.health()
        self.assertEqual(health.foreign_pid, STRANGER)
        self.assertEqual(health.foreign_as, layout.Process.CONTROLLER)

    def test_a_process_named_as_another_is_refused_too(self):
        self.rosters.put(AUTHOR, roster(controller=CONTROLLER, planner=STRANGER))
        # The roster is known from the second message on.
        for _ in range(2):
            self.queue.put(STRANGER, command())
            self.assertIsNone(self.newest())
        self.refused(foreign=2)

    def test_what_the_dead_left_is_refused_and_is_no_contest(self):
        for sender in (DEAD, 0, 0xFFFFFFFF):
            self.queue.put(sender, command())
        self.assertIsNone(self.newest())
        self.refused(foreign=3)
        self.assertEqual(self.producers.contests, 0)
        self.assertEqual(self.health().foreign_pid, 0)

    def test_two_memberships_of_one_process_id_are_a_contest(self):
        subscriber = Subscriber(Port(self.queue, layout.Command), layout.COMMAND, self.producers)
        contests = []
        for membership in (1, 1, 2, 1):
            self.queue.put(CONTROLLER, command(steer=0.5), membership)
            self.assertIsNotNone(subscriber.newest(lambda _: None))
            contests.append(self.producers.contests)
        self.assertEqual(contests, [0, 0, 1, 2])
        self.assertEqual(self.health().foreign_pid, CONTROLLER)
        self.assertEqual(self.health().foreign_as, layout.Process.CONTROLLER)
        # A successor, which the roster names, is no contest.
        self.rosters.put(AUTHOR, roster(controller=SUCCESSOR))
        self.queue.put(SUCCESSOR, command(), 3)
        self.assertIsNotNone(subscriber.newest(lambda _: None))
        self.assertEqual(self.producers.contests, 2)

    def test_memberships_of_an_open_service_are_not_compared(self):
        self.rosters.put(AUTHOR, roster(controller=CONTROLLER))
        open_service = layout.COMMAND._replace(open=True)
        subscriber = Subscriber(Port(self.queue, layout.Command), open_service, self.producers)
        for membership in (1, 2):
            self.queue.put(CONTROLLER, command(), membership)
            self.assertIsNotNone(subscriber.newest(lambda _: None))
        self.assertEqual(self.producers.contests, 0)

    def test_a_process_of_another_user_lives(self):
        self.queue.put(STRANGER, command())
        with unittest.mock.patch("os.kill", side_effect=PermissionError):
            self.assertIsNone(self.newest())
        self.assertEqual(self.producers.contests, 1)

    def test_the_roster_of_another_author_is_ignored(self):
        self.rosters.put(STRANGER, roster(controller=STRANGER))
        self.queue.put(STRANGER, command(steer=-1.0))
        self.assertIsNone(self.newest())
        self.queue.put(CONTROLLER, command(steer=0.5))
        self.assertEqual(self.newest().steer, 0.5)
        self.refused(foreign=1)

    def test_the_roster_is_read_when_an_unknown_process_sends(self):
        self.queue.put(CONTROLLER, command())
        self.assertIsNotNone(self.newest())
        self.rosters.put(AUTHOR, roster(controller=SUCCESSOR))
        self.queue.put(CONTROLLER, command())
        self.assertIsNotNone(self.newest())
        self.assertEqual(len(self.rosters.sent), 1, "nothing unknown came yet")
        self.queue.put(SUCCESSOR, command(steer=0.75))
        self.assertEqual(self.newest().steer, 0.75)
        self.queue.put(CONTROLLER, command())
        self.assertIsNone(self.newest(), "replaced by its successor")

    def test_before_the_first_roster_nothing_is_taken(self):
        self.rosters.sent.clear()
        self.queue.put(CONTROLLER, command())
        self.assertIsNone(self.newest())
        self.refused(foreign=1)

    def test_an_open_service_is_taken_from_every_process(self):
        self.assertTrue(layout.FRAME_REQUEST.open)
        self.assertFalse(layout.COMMAND.open)
        self.queue.put(STRANGER, command(steer=0.5))
        self.assertEqual(self.newest(layout.COMMAND._replace(open=True)).steer, 0.5)
        self.refused()

    def test_a_flood_of_foreign_messages_does_not_hold_the_reader(self):
        for _ in range(2 * FOREIGN_MAX):
            self.queue.put(STRANGER, command())
        self.assertIsNone(self.newest())
        self.assertEqual(len(self.queue.sent), FOREIGN_MAX)


class Newest(Fixture):
    BAD = {
        "episode": {"episode": EPISODE + 1},
        "stale": {"taken_ns": NOW_NS - LIMIT_NS - 1},
        "future": {"taken_ns": NOW_NS + layout.FUTURE_TOLERANCE_NS + 1},
        "content": {"pedal": math.nan},
    }

    def test_a_refused_command_hides_no_good_one_and_is_counted_by_reason(self):
        for reason, changes in self.BAD.items():
            for is_first in (True, False):
                with self.subTest(reason, is_first=is_first):
                    self.setUp()
                    both = [command(**{"steer": -1.0, **changes}), command(steer=0.5)]
                    for message in both if is_first else reversed(both):
                        self.queue.put(CONTROLLER, message)
                    self.assertEqual(self.newest().steer, 0.5)
                    self.refused(**{reason: 1})

    def test_of_two_good_ones_the_newest_is_taken(self):
        for steer in (0.25, 0.75):
            self.queue.put(CONTROLLER, command(steer=steer))
        self.assertEqual(self.newest().steer, 0.75)
        self.assertIsNone(self.newest())


# Sends a command in a run under the header of the process that it is told.
INTRUDER = """
import sys
import wire_layout as layout
from wire import Wire
wire = Wire(sys.argv[1], "controller", 0)
port = wire.publisher(layout.COMMAND)
port._pid = int(sys.argv[2])
port.send(layout.Command(steer=-1.0))
print("sent", flush=True)
sys.stdin.read()
"""


class SharedMemory(unittest.TestCase):
    """The same over real ports: this process is the author and the controller."""

    RUN = f"test-wire-{os.getpid()}"

    def setUp(self):
        self.wire = Wire(self.RUN, "world", os.getpid())
        self.addCleanup(self.remove, self.wire.dir, self.wire.prefix)
        self.rosters = self.wire.publisher(layout.ROSTER)

    def tearDown(self):
        self.wire = self.rosters = None

    def remove(self, folder, prefix):
        shutil.rmtree(folder)
        for name in os.listdir(layout.SHARED_MEMORY_DIR):
            if name.startswith(prefix):
                os.remove(os.path.join(layout.SHARED_MEMORY_DIR, name))

    def test_the_sender_is_the_process_that_the_library_names(self):
        self.rosters.send(roster(world=os.getpid(), controller=os.getpid()))
        commands = self.wire.subscriber(layout.COMMAND)
        own = self.wire.publisher(layout.COMMAND)
        own.send(layout.Command(steer=0.5))
        intruder = subprocess.Popen(
            [sys.executable, "-c", INTRUDER, self.RUN, str(os.getpid())],
            cwd=os.path.dirname(os.path.abspath(__file__)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            self.assertEqual(intruder.stdout.readline(), "sent\n")
            newest = commands.newest(lambda _: None)
            health = layout.Health()
            self.wire.producers.report(health)
            self.assertEqual(newest.steer, 0.5)
            self.assertEqual(health.refused[RefusalKind.FOREIGN], 1)
            self.assertEqual(health.foreign_pid, intruder.pid)
            self.assertEqual(health.foreign_as, layout.Process.CONTROLLER)
        finally:
            intruder.communicate("")

    def test_a_process_that_its_starter_does_not_name_is_not_set_up(self):
        # Named by itself, which did not start it.
        self.rosters.send(roster(world=os.getpid()))
        # The supervisor passes its roster on to late joiners every few milliseconds.
        passing_on = unittest.mock.patch("time.sleep", lambda _: self.rosters.update_connections())
        soon = unittest.mock.patch("member.NAMED_NS", 50_000_000)
        with passing_on, soon, self.assertRaises(SetUpError) as refused:
            join_as(self.RUN, "world")
        self.assertIn("does not name it as its world", str(refused.exception))
        with passing_on, unittest.mock.patch("os.getppid", os.getpid):
            self.assertEqual(join_as(self.RUN, "world").producers.pid("world"), os.getpid())


if __name__ == "__main__":
    unittest.main()
