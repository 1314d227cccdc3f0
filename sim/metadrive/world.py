"""The world process on the real MetaDrive: owns the run's clock and the car.

The mirror of `robot/src/process.rs`, tick for tick.
"""

import os
import sys
import traceback

import member
import wire_layout as layout
from door import admit, admit_answer
from grid import Grid, first_instant
from member import Contest, Member, Telemetry, SetUpError, monotonic_ns
from score import Score
from wire import WireError

# Ticks of the simulator in a second: the only rate of this world.
DECISION_HZ = 10.0
# The longest that the world sleeps between two heartbeats, ns.
NAP_NS = 20_000_000
# From look to look at requests for pictures between two ticks, ns.
LOOK_NS = 5_000_000


MASK = (1 << 64) - 1


def episode_seed(run, episode):
    """Seed of an episode of the run, as `Run::episode_seed` draws it."""
    if run["seeds"] == 0:
        return run["seed"] + episode
    if run["shuffle"] == 0:
        return run["seed"] + episode % run["seeds"]
    z = (run["shuffle"] + episode) * 0x9E3779B97F4A7C15 & MASK
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9 & MASK
    z = (z ^ z >> 27) * 0x94D049BB133111EB & MASK
    return run["seed"] + (z ^ z >> 31) % run["seeds"]


class Ports:
    """What the world reads and publishes."""

    def __init__(self, wire):
        self.bell = wire.doorbell("world")
        self.commands = wire.subscriber(layout.COMMAND)
        self.observations = wire.publisher(layout.OBSERVATION)
        self.progress = wire.publisher(layout.PROGRESS)
        self.episodes = wire.publisher(layout.EPISODE)
        self.frame_requests = wire.subscriber(layout.FRAME_REQUEST)
        self.frames = wire.publisher(layout.FRAME)

    def update_connections(self):
        """Connects to readers that came or came back, between ticks."""
        for port in (self.observations, self.progress, self.episodes, self.frames):
            port.update_connections()


class Session:
    """A run of the world, from its first episode to its last."""

    def __init__(self, arguments, log):
        self.member = Member(arguments, log)
        config = self.member.config
        run_hz = config["run"]["rate_hz"]
        rate_hz = config["world"].get("rate_hz") or run_hz
        if rate_hz != DECISION_HZ or run_hz != DECISION_HZ:
            raise SetUpError(
                f"world.rate_hz = {rate_hz}, run.rate_hz = {run_hz}: "
                f"MetaDrive steps at {DECISION_HZ} Hz; leave both keys out"
            )
        self.ports = Ports(self.member.wire)
        self.telemetry = Telemetry(self.member.wire)
        # Only now: the run's own errors need not wait for the simulator.
        from environment import World
        from frame import FrameServer

        try:
            self.world = World(config["world"], config["scanner"])
        except (AssertionError, KeyError, ValueError) as error:
            raise SetUpError(f"MetaDrive refuses this configuration: {error!r}") from None
        ports = (self.ports.frame_requests, self.ports.frames)
        self.frame_server = FrameServer(self.world, ports, self.member.period_ns)
        self.command_age_ns = int(config["limits"]["command_age_ms"] * 1e6)
        # Where the controller may be waiting for the learner, that comes on top.
        wait_s = config["limits"]["lockstep_wait_s"]
        if config["learner"]["enabled"]:
            wait_s += config["limits"]["learner_wait_s"]
        self.wait_ns = int(wait_s * 1e9)
        self.observation = layout.Observation()
        self.command = None
        self.contest = Contest()
        self.episode = arguments.first_episode
        self.episode_skipped = 0
        # The counts of earlier worlds of this run.
        self.driven_ns = arguments.driven_ns
        self._reset()
        self.member.apply_privileges()
        self.member.privileges.report(self.telemetry.health)
        self.telemetry.enter(layout.HealthState.READY, monotonic_ns())
        period_ns = self.member.period_ns
        first_ns = first_instant(config["run"]["name"], period_ns, monotonic_ns())
        self.grid = Grid(self.member.lockstep, period_ns, first_ns)

    def _reset(self):
        seed = episode_seed(self.member.config["run"], self.episode)
        try:
            self.world.reset(seed)
        except ValueError as error:
            raise SetUpError(f"seed {seed}: {error}") from None
        self.frame_server.begin_episode()
        self.score = Score(seed)

    def leave(self):
        """Closes what the world holds of the run, in this order."""
        self.frame_server = self.ports = self.telemetry = self.member.wire = None

    def drive(self):
        """Ticks until the run is done."""
        grid, health = self.grid, self.telemetry.health
        health.first_scheduled_ns = grid.instant_ns(0)
        health.state = layout.HealthState.RUNNING
        while True:
            grid.sleep()
            released_ns = monotonic_ns()
            now_ns = grid.instant_ns(grid.tick) if grid.lockstep else released_ns
            moved_ns = released_ns
            if grid.tick > 0:
                episode = self.episode
                if self._advance(now_ns):
                    self._record_missed(released_ns)
                    break
                if self.episode != episode and not grid.lockstep:
                    # A reset takes longer than a period: its first observation
                    # is taken now, on the newest instant of the grid.
                    grid.skip_passed()
                    released_ns = now_ns = monotonic_ns()
                moved_ns = monotonic_ns()
            self._publish(released_ns, now_ns)
            self._finish_tick(released_ns, moved_ns)
            if grid.lockstep:
                self._await_command()
        self._account()
        # The last health message; the simulator needs no orderly end.
        self.telemetry.enter(layout.HealthState.FINISHED, monotonic_ns())

    def _finish_tick(self, released_ns, moved_ns):
        grid = self.grid
        done_ns = monotonic_ns()
        lateness_ns = 0 if grid.lockstep else max(released_ns - grid.instant_ns(grid.tick), 0)
        self._record_missed(released_ns)
        if not grid.lockstep:
            first_ns = grid.instant_ns(grid.tick + 1) - grid.missed * grid.period_ns
            parts = {
                layout.Part.MOVE: moved_ns - released_ns,
                layout.Part.OBSERVE: done_ns - moved_ns,
            }
            self.telemetry.note_deadline(grid.tick, done_ns - first_ns, grid.missed, parts)
        grid.tick += 1
        # In lockstep a command releases it, not the timer.
        wake_up_ns = None if grid.lockstep else lateness_ns
        self.telemetry.count_tick(lateness_ns, done_ns - released_ns, wake_up_ns)
        self._account()
        self.telemetry.heartbeat(done_ns)
        self.ports.update_connections()
        self._take_pictures()

    def _record_missed(self, released_ns):
        grid = self.grid
        newest_ns = released_ns - grid.instant_ns(grid.tick - 1)
        self.telemetry.record_skipped(newest_ns, grid.period_ns, grid.missed)

    def _take_pictures(self):
        """Answers requests until the next tick is near: a picture can only be of
        what stands there now, so most are of the very tick that is asked for. In
        lockstep, one look."""
        grid, frame_server = self.grid, self.frame_server
        while True:
            slack_ns = None if grid.lockstep else grid.instant_ns(grid.tick) - monotonic_ns()
            frame_server.take_if_asked(self.observation.header, slack_ns)
            if slack_ns is None or slack_ns < frame_server.needed_ns + LOOK_NS:
                return
            member.sleep_until(monotonic_ns() + LOOK_NS)

    def _account(self):
        health = self.telemetry.health
        health.header.tick = max(self.grid.tick - 1, 0)
        health.skipped = health.late = self.grid.skipped
        health.next_scheduled_ns = self.grid.instant_ns(self.grid.tick)

    def _advance(self, begun_ns):
        """Applies the newest command for one tick of the physics; returns whether the
        run is done."""
        # The clock is read after the command, which otherwise would seem to come from
        # the future.
        clock = lambda: begun_ns if self.grid.lockstep else monotonic_ns()
        newest = self.ports.commands.newest(lambda command: self._refusal(command, clock()))
        if newest is not None:
            self.command = newest
        now_ns = clock()
        producers = self.member.wire.producers
        is_contested = self.contest.look(producers.contests, now_ns)
        producers.report(self.telemetry.health)
        young = self.command
        if young is not None and (is_contested or self._refusal(young, now_ns) is not None):
            young = None
        step = self.world.step(self.score.obey(young, now_ns))
        self.score.count(step)
        if step.outcome != layout.Outcome.DRIVING:
            self._close_episode(step.outcome, now_ns)
            episodes = self.member.config["run"]["episodes"]
            if 0 < episodes <= self.episode + 1:
                return True
            self._open_episode()
            return self.member.is_stopping
        return self._ends(now_ns)

    def _ends(self, now_ns):
        """Whether the world was asked to stop, or the time is up."""
        duration_s = self.member.config["run"]["duration_s"]
        elapsed_ns = self.driven_ns + now_ns - self.grid.instant_ns(0)
        if (duration_s > 0 and elapsed_ns >= duration_s * 1e9) or self.member.is_stopping:
            self._close_episode(layout.Outcome.STOPPED, now_ns)
            return True
        return False

    def _refusal(self, command, now_ns):
        """Why a command is refused now; None when it is admitted."""
        return admit(command, now_ns, self.command_age_ns, self.episode)

    def _close_episode(self, outcome, now_ns):
        episode = self.score.episode(self.world, outcome)
        self._fill_header(episode.header, now_ns)
        episode.skipped = self.grid.skipped - self.episode_skipped
        self.ports.episodes.send(episode)
        self.member.log.say(
            "episode",
            seed=episode.seed,
            outcome=layout.Outcome.WORDS[outcome],
            ticks=episode.ticks,
            completion=episode.completion,
            contacts=episode.vehicle_contacts + episode.object_contacts,
            braked=episode.braked,
        )
        self._publish_progress(now_ns, outcome)

    def _open_episode(self):
        # A reset is the longest the world is silent.
        self.telemetry.heartbeat(monotonic_ns())
        self.episode += 1
        self._reset()
        self.episode_skipped = self.grid.skipped
        self.command = None

    def _fill_header(self, header, now_ns):
        header.tick = self.grid.tick
        header.taken_ns = now_ns
        header.episode = self.episode

    def _publish(self, released_ns, now_ns):
        observation, grid = self.observation, self.grid
        self.world.observe(observation)
        self._fill_header(observation.header, now_ns)
        observation.scheduled_ns = released_ns if grid.lockstep else grid.instant_ns(grid.tick)
        observation.released_ns = released_ns
        observation.published_ns = monotonic_ns()
        self.ports.observations.send(observation)
        self._publish_progress(now_ns, layout.Outcome.DRIVING)

    def _publish_progress(self, now_ns, outcome):
        progress = self.score.progress(self.world, outcome)
        self._fill_header(progress.header, now_ns)
        progress.skipped = self.grid.skipped
        self.ports.progress.send(progress)

    def _await_command(self):
        """In lockstep the next tick begins when the command for this one has arrived.
        The wait has a limit; after it the car brakes."""
        asked = self.grid.tick - 1
        door = lambda command: admit_answer(command, asked, self.episode)
        until_ns = monotonic_ns() + self.wait_ns
        while True:
            command = self.ports.commands.newest(door)
            if command is not None:
                self.command = command
                return
            now_ns = monotonic_ns()
            if now_ns >= until_ns or self.member.is_stopping:
                return
            self.telemetry.heartbeat(now_ns)
            self.ports.update_connections()
            self.ports.bell.wait(min(NAP_NS, until_ns - now_ns))


def drive(arguments, log):
    """Joins the run and drives it to its end."""
    session = Session(arguments, log)
    session.drive()
    session.leave()


def main():
    member.die_with_parent()
    arguments = member.parse_arguments()
    log = member.Log()
    code, last_words = 0, ""
    try:
        drive(arguments, log)
    except (SetUpError, WireError) as error:
        code, last_words = member.SET_UP_FAILED, f"vlaps-world: {error}\n"
    except ImportError as error:
        remedy = "this Python lacks what the world needs; run ./vlaps setup metadrive"
        code, last_words = member.SET_UP_FAILED, f"vlaps-world: {error}: {remedy}\n"
    except Exception:
        code, last_words = 1, traceback.format_exc()
    # The supervisor shows the last line.
    log.close()
    sys.stderr.write(last_words)
    sys.stderr.flush()
    return code


if __name__ == "__main__":
    # The interpreter's own end would first take the simulator apart, which can
    # take longer than the supervisor waits for a silent process.
    os._exit(main())
