"""HG-DAgger (Kelly et al. 2019): an expert takes over, and its actions are imitated.

    pip install torch
    python hg_dagger.py --steps 20000

The person who takes over is played by a rule: the expert drives where its action and the
learner's differ by more than 0.2, or where the judge of the tick vetoes the learner's.
The first steps are the expert's alone.
"""

from __future__ import annotations

import numpy as np
import torch
from imitation import Memory, arguments_of, lessons
from torch import nn
from training import network

#: Share of the steps that the expert drives alone, before the learner does.
DEMONSTRATION = 0.2
#: Steering decides; the pedal matters less.
WEIGHTS = torch.tensor([10.0, 1.0])


def main() -> None:
    arguments = arguments_of(__doc__, "hg_dagger")
    actor = network((259, 128, 2), nn.ReLU, nn.Tanh())
    optimiser = torch.optim.Adam(actor.parameters(), lr=1e-3)
    memory, random = Memory(259, 2), np.random.default_rng(0)
    for lesson in lessons(actor, "HG-DAgger", arguments, DEMONSTRATION):
        labelled = lesson.info["takeover"]
        memory.add(lesson.observations[labelled], lesson.info["expert"][labelled])
        for _ in range(arguments.updates):
            seen, wanted = memory.draw(random, 256)
            loss = (WEIGHTS * (actor(seen) - wanted) ** 2).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()


if __name__ == "__main__":
    main()
