"""The check of commands: content, age, episode. The mirror of `admit` and
`admit_answer` in `robot/src/door.rs`.

Both return the RefusalKind of a command that is refused, None for one that is admitted.
"""

import math

import wire_layout as layout
from wire_layout import RefusalKind


def is_normalised(value):
    """A number in [-1, 1]."""
    return math.isfinite(value) and -1.0 <= value <= 1.0


def admit(command, now_ns, limit_ns, episode):
    """Refuses what is from the future, too old, malformed, or of another episode."""
    age_ns = now_ns - command.header.taken_ns
    if -age_ns > layout.FUTURE_TOLERANCE_NS:
        return RefusalKind.FUTURE
    if age_ns > limit_ns:
        return RefusalKind.STALE
    return _admit_timeless(command, episode)


def admit_answer(command, asked, episode):
    """In lockstep time advances with the ticks: only the answer to the last published
    tick is accepted."""
    refusal = _admit_timeless(command, episode)
    if refusal is not None or command.header.tick == asked:
        return refusal
    return RefusalKind.STALE if command.header.tick < asked else RefusalKind.FUTURE


def _admit_timeless(command, episode):
    """Everything that does not depend on time."""
    is_well_formed = (
        is_normalised(command.steer)
        and is_normalised(command.pedal)
        and command.driver in layout.Driver.WORDS
        and command.reason in layout.Reason.WORDS
    )
    if not is_well_formed:
        return RefusalKind.CONTENT
    return None if command.header.episode == episode else RefusalKind.EPISODE
