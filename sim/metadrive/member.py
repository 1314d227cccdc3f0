"""What every process of a run does at its start and end, and its telemetry: the
mirror of the crate `runtime`."""

import argparse
import ctypes
import datetime
import os
import queue
import resource
import signal
import sys
import threading
import time
import tomllib

import wire_layout as layout
from wire import Wire, WireError

# The exit code of a process that could not be set up; it is not restarted.
SET_UP_FAILED = 2
# How often a process publishes its health and its histograms, ns.
HEALTH_NS = 50_000_000
TIMING_NS = 500_000_000
# Log lines that may wait for a slow disk before further ones are dropped.
LOG_LINES = 1000
# How long the supervisor may take to put a process that it has started on its
# roster, ns (it publishes the roster every 5 ms while processes start), and the
# time between two reads of the roster, s.
NAMED_NS = 5_000_000_000
NAMED_LOOK_S = 0.0005
# How long the car is braked after the last message of a process that sends in the
# place of one that the run has started, ns: even a slow sender sends several
# messages in that time, so the brake holds between them.
CONTEST_NS = 1_000_000_000

_libc = ctypes.CDLL(None, use_errno=True)
_PR_SET_PDEATHSIG = 1
_PR_SET_TIMERSLACK = 29
# Current and future pages, locked as they are first touched.
_MLOCK = 1 | 2 | 4
_CLOCK_MONOTONIC = 1
_TIMER_ABSTIME = 1


class SetUpError(Exception):
    """Why the process could not be set up: what, where, what to do."""


class _Timespec(ctypes.Structure):
    _fields_ = [("tv_sec", ctypes.c_long), ("tv_nsec", ctypes.c_long)]


def sleep_until(instant_ns):
    """Sleeps until an instant of the machine's monotonic clock."""
    due = _Timespec(instant_ns // 1_000_000_000, instant_ns % 1_000_000_000)
    while _libc.clock_nanosleep(_CLOCK_MONOTONIC, _TIMER_ABSTIME, ctypes.byref(due), None):
        pass


def die_with_parent():
    """Asks the kernel to end this process when the supervisor ends, in any way."""
    parent = os.getppid()
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    # The parent may have died before the line above.
    if os.getppid() != parent:
        os._exit(0)


def parse_arguments():
    """The arguments that every process takes, and the world's own."""
    parser = argparse.ArgumentParser(
        prog="vlaps-world", description="Drives the real MetaDrive as the world of a run"
    )
    parser.add_argument("--config", required=True, help="the run's resolved configuration")
    parser.add_argument("--priority", type=int, default=0, help="SCHED_FIFO priority; 0 for none")
    parser.add_argument("--core", type=int, help="core to stay on")
    parser.add_argument(
        "--first-episode", type=int, default=0, help="episode of the run to begin with"
    )
    parser.add_argument(
        "--driven-ns", type=int, default=0, help="time that the run has driven already, ns"
    )
    return parser.parse_args()


def load_config(path):
    """The resolved configuration, which names every key."""
    try:
        with open(path, "rb") as file:
            return tomllib.load(file)
    except OSError as error:
        raise SetUpError(f"{path}: cannot read the configuration: {error.strerror}") from None
    except tomllib.TOMLDecodeError as error:
        raise SetUpError(f"{path}: {error}") from None


class Log:
    """Lines for stderr, written by a separate thread. They are dropped when the disk
    is too slow, so that no disk delays a tick."""

    def __init__(self):
        self._lines = queue.Queue(LOG_LINES)
        self._thread = threading.Thread(target=self._write, daemon=True)
        self._thread.start()

    def _write(self):
        while (line := self._lines.get()) is not None:
            # One write: two threads must not share a line.
            sys.stderr.write(line + "\n")
            sys.stderr.flush()

    def say(self, what, **values):
        when = datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="microseconds")
        words = " ".join(f"{name}={value}" for name, value in values.items())
        try:
            self._lines.put_nowait(f"{when.replace('+00:00', 'Z')}  INFO {what} {words}")
        except queue.Full:
            pass

    def close(self):
        try:
            self._lines.put(None, timeout=1.0)
        except queue.Full:
            return
        self._thread.join(timeout=1.0)


class Privileges:
    """The real-time privileges that the main thread asks for, and those it got."""

    def __init__(self, priority, core):
        self._priority_asked = priority
        self._core_asked = core
        self._priority = self._core = self._memory = layout.Grant.NOT_ASKED

    def apply(self):
        """Call it when everything is allocated; a refusal is logged."""
        if self._core_asked is not None:
            self._core = _granted(lambda: os.sched_setaffinity(0, {self._core_asked}))
        if self._priority_asked == 0:
            return
        # Threads started later do not inherit the priority.
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        wish = os.sched_param(self._priority_asked)
        self._priority = _granted(lambda: os.sched_setscheduler(0, policy, wish))
        locked = _libc.mlockall(_MLOCK) == 0
        self._memory = layout.Grant.GRANTED if locked else layout.Grant.REFUSED
        # Absolute sleeps of real-time threads have no slack; of others, 50 us.
        _libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)

    def report(self, health):
        health.priority = self._priority
        health.core = self._core
        health.memory = self._memory
        health.priority_asked = self._priority_asked
        got = self._priority == layout.Grant.GRANTED
        health.priority_got = self._priority_asked if got else 0
        scheduling = layout.Scheduling
        health.scheduling_asked = scheduling.FIFO if self._priority_asked else scheduling.ORDINARY
        health.scheduling_got = scheduling.FIFO if got else scheduling.ORDINARY

    def words(self):
        word = layout.Grant.WORDS
        return {
            "priority": word[self._priority],
            "core": word[self._core],
            "memory": word[self._memory],
        }


def _granted(ask):
    try:
        ask()
    except OSError:
        return layout.Grant.REFUSED
    return layout.Grant.GRANTED


# Longer durations share the last bucket.
LONGEST_NS = 1 << (
    layout.HISTOGRAM_UNIT_SHIFT
    + layout.HISTOGRAM_HALF_SHIFT
    + (layout.HISTOGRAM_BUCKETS >> layout.HISTOGRAM_HALF_SHIFT)
    - 1
)


def record(histogram, ns):
    """Counts one duration in the buckets of `shm-config/src/histogram.rs`."""
    units = ns >> layout.HISTOGRAM_UNIT_SHIFT
    doublings = (units >> (layout.HISTOGRAM_HALF_SHIFT + 1)).bit_length()
    bucket = (doublings << layout.HISTOGRAM_HALF_SHIFT) + (units >> doublings)
    histogram.buckets[min(bucket, layout.HISTOGRAM_BUCKETS - 1)] += 1
    histogram.count += 1
    histogram.max_ns = max(histogram.max_ns, ns)


def record_series(histogram, first_ns, step_ns, count):
    """Counts `count` durations, each `step_ns` longer than the one before."""
    apart = min(count, LONGEST_NS // step_ns + 1)
    for k in range(apart):
        record(histogram, first_ns + k * step_ns)
    # The rest is beyond the range of the histogram.
    if count > apart:
        record(histogram, first_ns + (count - 1) * step_ns)
        histogram.buckets[layout.HISTOGRAM_BUCKETS - 1] += count - apart - 1
        histogram.count += count - apart - 1


class Telemetry:
    """What a process reports about itself: health and histograms."""

    def __init__(self, wire):
        self.health = layout.Health()
        self.timing = layout.Timing()
        self._health_port = wire.publisher(layout.HEALTH_WORLD)
        self._timing_port = wire.publisher(layout.TIMING_WORLD)
        self._health_due = 0
        self._timing_due = 0
        # Ticks no later than this are not among the latest.
        self._late_bar_ns = 0
        self._usage_before = resource.getrusage(resource.RUSAGE_THREAD)

    def enter(self, state, now_ns):
        """Publishes a new state immediately."""
        if state == layout.HealthState.READY:
            self._usage_before = resource.getrusage(resource.RUSAGE_THREAD)
        self.health.state = state
        self._health_due = self._timing_due = now_ns
        self.heartbeat(now_ns)

    def heartbeat(self, now_ns):
        """Publishes what is due, between ticks."""
        if now_ns >= self._health_due:
            usage, before = resource.getrusage(resource.RUSAGE_THREAD), self._usage_before
            self.health.minor_faults = usage.ru_minflt - before.ru_minflt
            self.health.major_faults = usage.ru_majflt - before.ru_majflt
            self.health.involuntary_switches = usage.ru_nivcsw - before.ru_nivcsw
            self.health.header.taken_ns = now_ns
            self._health_port.send(self.health)
            self._health_port.update_connections()
            self._health_due = now_ns + HEALTH_NS
        if now_ns >= self._timing_due:
            self.timing.header.taken_ns = now_ns
            self._timing_port.send(self.timing)
            self._timing_port.update_connections()
            self._timing_due = now_ns + TIMING_NS

    def count_tick(self, lateness_ns, execution_ns, wake_up_ns):
        self.health.ticks += 1
        record(self.timing.release_lateness, lateness_ns)
        if wake_up_ns is not None:
            record(self.timing.wake_up, wake_up_ns)
        record(self.timing.execution, execution_ns)

    def note_deadline(self, tick, late_ns, skipped, parts):
        """Keeps the tick if it is one of the latest since the start: `late_ns` after
        its deadline, or after that of the first of the ticks skipped before it.
        `parts` says how long each part of it took, ns."""
        if late_ns <= self._late_bar_ns:
            return
        timing = self.timing
        part, part_ns = max(parts.items(), key=lambda entry: entry[1])
        if timing.late_count < layout.LATE_TICKS:
            place = timing.late_count
            timing.late_count += 1
        else:
            place = min(range(layout.LATE_TICKS), key=lambda k: timing.late[k].late_ns)
        timing.late[place] = layout.LateTick(
            tick=tick, late_ns=late_ns, part_ns=part_ns, skipped=skipped, part=part
        )
        if timing.late_count == layout.LATE_TICKS:
            self._late_bar_ns = min(late.late_ns for late in timing.late)

    def record_skipped(self, newest_ns, period_ns, count):
        """Records each skipped instant with its full lateness: from the instant until
        the next tick began. `newest_ns` is the newest of them."""
        for lateness in (self.timing.release_lateness, self.timing.wake_up):
            record_series(lateness, newest_ns, period_ns, count)


class Contest:
    """Detects that two living processes send the same state. Then no received message
    can be trusted to be the run's own, and the car is braked."""

    def __init__(self):
        self._seen = 0
        self._until_ns = None

    def look(self, contests, now_ns):
        """Reads the number of refused messages, after the ports were read; returns
        whether the car must brake."""
        if contests != self._seen:
            self._seen = contests
            self._until_ns = now_ns + CONTEST_NS
        return self._until_ns is not None and now_ns < self._until_ns


def join_as(run_name, process):
    """Joins a run as the process that the supervisor has started. It takes state only
    from processes on the supervisor's roster, and waits until the roster names it."""
    # Only the parent's roster counts: any other process could publish one.
    wire = Wire(run_name, process, os.getppid())
    until_ns = monotonic_ns() + NAMED_NS
    while wire.producers.pid(process) != os.getpid():
        if monotonic_ns() > until_ns:
            raise SetUpError(
                f"run '{run_name}': the process that started this one does not name it as its "
                f"{process}; `./vlaps up` starts all processes of a run"
            )
        time.sleep(NAMED_LOOK_S)
    return wire


class Member:
    """A process that has joined its run."""

    def __init__(self, arguments, log):
        self._stop = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._ask_to_stop)
        self.log = log
        self.config = load_config(arguments.config)
        try:
            self.lockstep = self.config["run"]["clock"] == "lockstep"
            self.period_ns = round(1e9 / self.config["run"]["rate_hz"])
            self.wire = join_as(self.config["run"]["name"], "world")
        except KeyError as error:
            raise SetUpError(
                f"{arguments.config}: key {error} is missing; start the world with ./vlaps up"
            ) from None
        except WireError as error:
            raise SetUpError(str(error)) from None
        # In lockstep every process runs without a pause; real-time priority would
        # starve the machine.
        self.privileges = Privileges(0 if self.lockstep else arguments.priority, arguments.core)

    def _ask_to_stop(self, _number, _frame):
        self._stop = True

    @property
    def is_stopping(self):
        return self._stop

    def apply_privileges(self):
        self.privileges.apply()
        self.log.say("real-time privileges", **self.privileges.words())


def monotonic_ns():
    """The machine's monotonic clock, the same for every process."""
    return time.monotonic_ns()
