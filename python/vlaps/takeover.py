"""Rules by which an expert takes over from the policy."""

from __future__ import annotations

import numbers
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_RULES = ("asked", "always", "vetoed", "differs")
_DRIVERS = np.array(["policy", "expert"])
#: Column of the veto in an assessment.
_VETO = 5

#: One flag per world.
Marks = NDArray[np.bool_]
#: One action per world, `[worlds, 2]`.
Actions = NDArray[np.float32]


def driver_names(taken: Marks) -> NDArray[np.str_]:
    """The driver of each world: "expert" where it has taken over, otherwise "policy"."""
    return _DRIVERS[taken.astype(np.intp)]


@dataclass
class Decided:
    """The decision for one step in all worlds."""

    proposal: Actions
    applied: Actions
    expert: Actions
    taken: Marks
    #: The worlds in which the step drives; false where it only begins an episode.
    driving: Marks


@dataclass(frozen=True)
class Takeover:
    """The rule by which an expert drives instead of the proposal; `method` is the expert.

    | `rule` | the expert drives |
    |---|---|
    | "asked" | only in steps with `takeover=True` |
    | "always" | in every step |
    | "vetoed" | where the safety check vetoes the proposal |
    | "differs" | where proposal and expert differ by more than `differ` in steering or pedal |

    `step(action, takeover=...)` replaces the rule for one step.
    """

    rule: str = "asked"
    method: str = "mpc"
    differ: float = 0.2

    def __post_init__(self) -> None:
        from .env import check_expert

        check_expert(self.method)
        if self.rule not in _RULES:
            raise ValueError(f"takeover {self.rule!r}: choose from {', '.join(_RULES)}")
        if not isinstance(self.differ, numbers.Real):
            raise TypeError(f"differ = {self.differ!r}: it must be a number")
        if not self.differ >= 0.0:
            raise ValueError(f"differ = {self.differ}: it must be at least 0")

    @staticmethod
    def of(takeover: Takeover | str | None) -> Takeover | None:
        """Makes a rule from its name."""
        if isinstance(takeover, str):
            return Takeover(takeover)
        if not isinstance(takeover, Takeover | None):
            raise TypeError(f"takeover = {takeover!r}: it must be a vlaps.Takeover or the name of a rule")
        return takeover

    def decide(
        self,
        proposal: Actions,
        driving: Marks,
        asked: Marks | None,
        advise: Callable[[str, Marks], Actions],
        judge: Callable[[Actions], NDArray[np.float64]],
    ) -> Decided:
        """Decides which driver drives in each world that is `driving`.

        `asked` replaces the rule; `advise` returns an expert's actions in some worlds, and
        `judge` the safety check's assessments `[worlds, numbers]` of actions.
        """
        finite = np.isfinite(proposal).all(axis=1)
        if not finite.all():
            index = int(np.argmin(finite))
            raise ValueError(f"action {index} is {proposal[index]}: both numbers must be finite")
        everywhere = asked is None and self.rule in ("always", "differs")
        if asked is None and self.rule == "vetoed":
            asked = judge(proposal)[:, _VETO] != 0.0
        if asked is None:
            asked = np.full_like(driving, everywhere)
        wanted = driving & asked
        expert = np.full_like(proposal, np.nan)
        if wanted.any():
            expert = advise(self.method, wanted)
        taken = wanted
        if everywhere and self.rule == "differs":
            # Where the expert was not asked, its action is NaN and the comparison is false.
            apart = np.abs(expert - np.clip(proposal, -1.0, 1.0)) > self.differ
            taken = np.logical_or(apart[:, 0], apart[:, 1])
        applied = np.where(taken[:, None], expert, proposal)
        return Decided(proposal, applied, expert, taken, driving)
