"""From which processes messages are taken: the mirror of
`shm-config/src/wire/producers.rs`.

The library writes into each message's envelope which process sent it; the header
inside is the sender's own claim. The world takes state only from the processes that
the supervisor, which started it, names in its roster.
"""

import os

import wire_layout as layout

# Rosters that are read in one call: one for each possible publisher.
ROSTERS_MAX = layout.PUBLISHERS_MAX

_CODES = {word: code for code, word in layout.Process.WORDS.items()}


def _lives(pid):
    """Whether the process exists, of any user."""
    # The kernel takes other numbers for groups of processes.
    if pid <= 0:
        return False
    try:
        os.kill(pid, 0)
    except PermissionError:
        return True
    except (ProcessLookupError, OverflowError):
        return False
    return True


class Producers:
    """What a membership knows about the run's processes, and its refusals."""

    def __init__(self, author, receive):
        """Follows the rosters of the process `author`. `receive` gives the next
        (sender, roster) of the roster's queue, or None when it is empty."""
        self._author = author
        self._receive = receive
        self._pids = layout.Roster().pids
        self._refused = [0] * len(layout.RefusalKind.WORDS)
        # The last living process that sent in the place of another, and that place.
        self._foreigner = None
        # Messages of living processes that were refused because the run did not
        # start them as the producer.
        self.contests = 0

    def pid(self, process):
        """The process id that the newest roster names, 0 when it names none."""
        self._look()
        return self._pids[_CODES[process]]

    def _look(self):
        for _ in range(ROSTERS_MAX):
            received = self._receive()
            if received is None:
                return
            sender, roster = received
            if sender == self._author:
                self._pids = roster.pids

    def admits(self, sender, service):
        """Whether a message of the service from this process is taken. One that is
        not is counted, and its sender noted."""
        if service.open:
            return True
        place = _CODES[service.from_]
        # A sender without an id is on no roster: 0 stands for "not started".
        if sender > 0:
            # It may have been started since the last read of the roster.
            if self._pids[place] == sender or self.pid(service.from_) == sender:
                return True
        self.count(layout.RefusalKind.FOREIGN)
        # Unread messages of a dead predecessor are refused like others; two living
        # processes that send in one place are a contest.
        if _lives(sender):
            self.contests += 1
            self._foreigner = (sender, place)
        return False

    def compare(self, sender, membership, service, last):
        """Counts two memberships with one process id as a contest as well: a process
        of another pid namespace may have the id of one of the run. A process
        publishes a service from one membership for as long as it lives. `last` is
        what this returned for the message before, None for the first one."""
        if service.open:
            return None
        if last is not None and last[0] == sender and last[1] != membership:
            self.contests += 1
            self._foreigner = (sender, _CODES[service.from_])
        return sender, membership

    def count(self, kind):
        """Counts a message that a port refused."""
        self._refused[kind] += 1

    def report(self, health):
        """Writes the refusals to the health message. Call it once a tick, after the
        ports were read."""
        health.refused[:] = self._refused
        if self._foreigner is not None:
            health.foreign_pid, health.foreign_as = self._foreigner
