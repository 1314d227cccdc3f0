"""Which commands the world's tick obeys.

    python -m unittest discover -s sim/metadrive
"""

import math
import unittest
from types import SimpleNamespace

import test_wire
import wire_layout as layout
from grid import Grid
from member import CONTEST_NS, Contest
from score import BRAKE, Score
from test_wire import CONTROLLER, EPISODE, STRANGER, command
from wire import Port, Subscriber
from world import Session

PERIOD_NS = 100_000_000


class Simulator:
    """Stands for MetaDrive: an endless road on which nothing is touched."""

    def __init__(self):
        self.action = None

    def step(self, action):
        self.action = action
        return SimpleNamespace(
            outcome=layout.Outcome.DRIVING,
            touched_vehicle=False,
            touched_object=False,
            on_sidewalk=False,
        )


class Obeying(test_wire.Fixture):
    """In lockstep, so that the test owns the clock."""

    def setUp(self):
        super().setUp()
        port = Port(self.queue, layout.Command)
        session = self.session = Session.__new__(Session)
        session.grid = Grid(True, PERIOD_NS, 0)
        session.ports = SimpleNamespace(
            commands=Subscriber(port, layout.COMMAND, self.producers),
            update_connections=lambda: None,
        )
        session.member = SimpleNamespace(
            wire=SimpleNamespace(producers=self.producers),
            config={"run": {"duration_s": 0, "episodes": 0}},
            is_stopping=False,
        )
        session.telemetry = SimpleNamespace(health=layout.Health(), heartbeat=lambda _: None)
        session.contest, session.score, session.world = Contest(), Score(7), Simulator()
        session.episode, session.command = EPISODE, None
        session.command_age_ns, session.driven_ns, session.wait_ns = 250_000_000, 0, 0

    def obeyed(self, now_ns):
        """The action of the tick at that instant."""
        self.session._advance(now_ns)
        return self.session.world.action

    def send(self, sender, now_ns, **changes):
        self.queue.put(sender, command(taken_ns=now_ns, **changes))

    def refusals(self):
        return list(self.session.telemetry.health.refused)

    def test_a_good_command_is_obeyed_until_it_is_old(self):
        self.send(CONTROLLER, 0, steer=0.5)
        limit_ns = self.session.command_age_ns
        self.assertEqual(self.obeyed(0), (0.5, 0.0))
        self.assertEqual(self.obeyed(limit_ns), (0.5, 0.0))
        self.assertEqual(self.obeyed(limit_ns + 1), BRAKE)

    def test_a_refused_command_does_not_displace_the_one_that_is_obeyed(self):
        self.send(CONTROLLER, 0, steer=0.5)
        self.send(CONTROLLER, 0, steer=math.nan)
        self.assertEqual(self.obeyed(0), (0.5, 0.0))
        self.send(CONTROLLER, PERIOD_NS, episode=EPISODE - 1)
        self.assertEqual(self.obeyed(PERIOD_NS), (0.5, 0.0))
        counts = [0] * len(layout.RefusalKind.WORDS)
        counts[layout.RefusalKind.CONTENT] = counts[layout.RefusalKind.EPISODE] = 1
        self.assertEqual(self.refusals(), counts)

    def test_the_car_is_braked_while_two_processes_send_commands_and_a_second_longer(self):
        for now_ns in range(0, CONTEST_NS, PERIOD_NS):
            self.send(CONTROLLER, now_ns, steer=0.5)
            self.send(STRANGER, now_ns, steer=-1.0)
            self.assertEqual(self.obeyed(now_ns), BRAKE, now_ns)
        health = self.session.telemetry.health
        self.assertEqual(health.foreign_pid, STRANGER)
        self.assertEqual(health.foreign_as, layout.Process.CONTROLLER)
        last_ns = now_ns
        for now_ns in range(last_ns + PERIOD_NS, last_ns + CONTEST_NS, PERIOD_NS):
            self.send(CONTROLLER, now_ns, steer=0.5)
            self.assertEqual(self.obeyed(now_ns), BRAKE, now_ns)
        self.send(CONTROLLER, last_ns + CONTEST_NS, steer=0.5)
        self.assertEqual(self.obeyed(last_ns + CONTEST_NS), (0.5, 0.0))

    def test_in_lockstep_the_answer_to_the_asked_tick_is_awaited(self):
        self.session.grid.tick = 11
        self.send(CONTROLLER, 0, tick=10, steer=0.5)
        self.send(CONTROLLER, 0, tick=11, steer=-0.5)
        self.session._await_command()
        self.assertEqual(self.session.command.steer, 0.5)
        self.send(STRANGER, 0, tick=10, steer=-1.0)
        self.send(CONTROLLER, 0, tick=9, steer=-0.5)
        self.session._await_command()
        self.assertEqual(self.session.command.steer, 0.5)
        self.refused(future=1, stale=1, foreign=1)


if __name__ == "__main__":
    unittest.main()
