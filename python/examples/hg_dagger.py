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
from curve import Curve
from imitation import Memory, arguments_of, examine, network
from torch import nn

import vlaps

#: Share of the steps that the expert drives alone, before the learner does.
DEMONSTRATION = 0.2
#: Steering decides; the pedal matters less.
WEIGHTS = torch.tensor([10.0, 1.0])


def main() -> None:
    arguments = arguments_of(__doc__, out="hg_dagger")
    envs = vlaps.MetaDriveVectorEnv(
        arguments.envs,
        autoreset_mode="SameStep",
        takeover=vlaps.Takeover("differs", arguments.expert),
        start_seed=100,
        num_scenarios=500,
        shuffle=True,
    )
    actor = network(259, 2, nn.Tanh())
    optimiser = torch.optim.Adam(actor.parameters(), lr=1e-3)
    memory, random = Memory(259, 2), np.random.default_rng(0)
    curve = Curve(f"{arguments.out}.svg", "HG-DAgger, 20 episodes a point")
    observations, _ = envs.reset(seed=100)
    taken, due = [], 0
    for step in range(0, arguments.steps, arguments.envs):
        if step >= due:
            share = float(np.mean(taken[-200:])) if taken else 1.0
            examine(actor, step, curve, f"{arguments.out}.onnx", takeovers=share)
            due += arguments.every
        with torch.no_grad():
            proposal = actor(torch.from_numpy(observations)).numpy()
        shown = step < DEMONSTRATION * arguments.steps
        after, _, _, _, info = envs.step(proposal, takeover=True if shown else None)
        labelled = info["takeover"]
        taken.append(labelled.mean())
        memory.add(observations[labelled], info["expert"][labelled])
        observations = after
        for _ in range(arguments.updates):
            seen, wanted = memory.draw(random, 256)
            loss = (WEIGHTS * (actor(seen) - wanted) ** 2).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
    examine(actor, arguments.steps, curve, f"{arguments.out}.onnx", takeovers=float(np.mean(taken[-200:])))


if __name__ == "__main__":
    main()
