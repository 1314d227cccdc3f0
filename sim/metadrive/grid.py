"""The instants at which the world ticks: the mirror of `shm-config/src/grid.rs`,
for a world that ticks at the run's rate."""

import member
from member import monotonic_ns

# The hash FNV-1a of `shm-config/src/layout.rs`, 64 bits.
FNV_BASIS = 0xCBF29CE484222325
FNV_PRIME = 0x100000001B3
MASK = (1 << 64) - 1


def phase_ns(run_name, period_ns):
    """Where the instants of a run lie within a period: it follows from the run's
    name, so that every world of the run, a restarted one too, has the same."""
    phase = FNV_BASIS
    for byte in run_name.encode():
        phase = (phase ^ byte) * FNV_PRIME & MASK
    return phase % period_ns


def first_instant(run_name, period_ns, now_ns):
    """The first instant of the run's grid that lies at least one period ahead, so
    that every process can be there."""
    least_ns = now_ns + period_ns
    return least_ns + (phase_ns(run_name, period_ns) - least_ns) % period_ns


class Grid:
    """The instants at which the world ticks."""

    def __init__(self, lockstep, period_ns, first_ns):
        self.lockstep = lockstep
        self.period_ns = period_ns
        self._first_ns = 0 if lockstep else first_ns
        self.tick = 0
        self.skipped = 0
        # Of these, those just before the tick of now.
        self.missed = 0

    def instant_ns(self, tick):
        """When a tick is due, on the run's clock."""
        return self._first_ns + tick * self.period_ns

    def sleep(self):
        """Sleeps until the next tick is due."""
        self.missed = 0
        if not self.lockstep:
            member.sleep_until(self.instant_ns(self.tick))
            self.skip_passed()

    def skip_passed(self):
        """Skips and counts the instants that have passed."""
        if self.lockstep:
            return
        late_ns = max(monotonic_ns() - self.instant_ns(self.tick), 0)
        passed = late_ns // self.period_ns
        self.tick += passed
        self.skipped += passed
        self.missed += passed
