"""PPL, Predictive Preference Learning (Cai et al. 2025): a takeover teaches what comes next.

    pip install torch
    python ppl.py --steps 20000

Where the expert takes over, the rejected action is held for some steps in a copy of the
world (`get_state`, `set_state`). In every state that this leads to, the expert's action is
preferred to the learner's, by the loss of direct preference optimisation.
"""

from __future__ import annotations

import numpy as np
import torch
from imitation import Memory, arguments_of, lessons
from torch import nn
from torch.nn.functional import logsigmoid
from training import MAPS, network

import vlaps

#: Steps for which the rejected action is held, and how many of their states are asked about.
HORIZON, ASKED = 12, 3
#: Scale of the preference, and its weight beside the imitation of the applied actions.
BETA, WEIGHT = 4.0, 0.5
DEMONSTRATION = 0.1


class Imagination:
    """A world beside the others, in which rejected actions are tried."""

    def __init__(self, expert: str, random: np.random.Generator) -> None:
        self.env, self.expert, self.random = vlaps.MetaDriveEnv(**MAPS), expert, random

    def scenes(self, state: vlaps.State, rejected: np.ndarray) -> list[tuple[np.ndarray, ...]]:
        """States that a rejected action leads to: observation, expert's action, rejected."""
        self.env.set_state(state)
        asked = set(self.random.choice(HORIZON, ASKED, replace=False).tolist())
        scenes = []
        for step in range(HORIZON):
            observation, _, terminated, truncated, _ = self.env.step(rejected)
            if terminated or truncated:
                break
            if step in asked:
                scenes.append((observation, self.env.expert(self.expert), rejected))
        return scenes


def loss_of(actor: nn.Module, shown: list[torch.Tensor], preferred: list[torch.Tensor]) -> torch.Tensor:
    """Imitation of what was driven, and preference in what was imagined."""
    weights = torch.tensor([10.0, 1.0])
    seen, applied = shown
    imitation = (weights * (actor(seen) - applied) ** 2).mean()
    seen, wanted, rejected = preferred
    action = actor(seen)
    # Logarithms of probabilities of a Gaussian around the action, up to a constant.
    better, worse = ((weights * (action - one) ** 2).sum(1) for one in (wanted, rejected))
    return imitation + WEIGHT * (-logsigmoid(BETA * (worse - better)).mean() + better.mean())


def main() -> None:
    arguments = arguments_of(__doc__, "ppl")
    random = np.random.default_rng(0)
    imagination = Imagination(arguments.expert, random)
    actor = network((259, 128, 2), nn.ReLU, nn.Tanh())
    optimiser = torch.optim.Adam(actor.parameters(), lr=1e-3)
    driven, imagined = Memory(259, 2), Memory(259, 2, 2)
    for lesson in lessons(actor, "PPL", arguments, DEMONSTRATION):
        labelled = lesson.info["takeover"]
        if labelled.any():
            driven.add(lesson.observations[labelled], lesson.info["applied"][labelled])
            world = int(random.choice(np.flatnonzero(labelled)))
            for scene in imagination.scenes(lesson.states[world], lesson.proposal[world]):
                imagined.add(*(one[None] for one in scene))
        for _ in range(arguments.updates if imagined.count else 0):
            loss = loss_of(actor, driven.draw(random, 256), imagined.draw(random, 256))
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()


if __name__ == "__main__":
    main()
