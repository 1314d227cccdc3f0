"""PVP, Proxy Value Propagation (Peng et al. 2023): values from takeovers, without a reward.

    pip install torch
    python pvp.py --steps 20000

Where the expert took over, its action is worth +1 and the learner's -1; TD learning
without a reward carries both to the other steps, and the actor climbs the value.
"""

from __future__ import annotations

import copy

import numpy as np
import torch
from imitation import Memory, arguments_of, lessons
from torch import nn
from training import network

GAMMA, TAU, NOISE = 0.99, 0.005, 0.1
#: Steering decides; the pedal matters less.
WEIGHTS = torch.tensor([10.0, 1.0])
#: The expert drives alone in this share of the steps, so that its action is known.
DEMONSTRATION = 0.1


class Critics(nn.Module):
    """Two values of an action (TD3); the smaller one counts in targets."""

    def __init__(self) -> None:
        super().__init__()
        self.nets = nn.ModuleList([network((261, 128, 1), nn.ReLU), network((261, 128, 1), nn.ReLU)])

    def forward(self, seen: torch.Tensor, action: torch.Tensor) -> list[torch.Tensor]:
        return [net(torch.cat([seen, action], 1)) for net in self.nets]


class Learner:
    """Actor, critics, their slow copies, and one update of them."""

    def __init__(self) -> None:
        self.actor, self.critics = network((259, 128, 2), nn.ReLU, nn.Tanh()), Critics()
        self.slow = copy.deepcopy(nn.ModuleList([self.actor, self.critics]))
        self.actor_steps = torch.optim.Adam(self.actor.parameters(), lr=3e-4)
        self.critic_steps = torch.optim.Adam(self.critics.parameters(), lr=3e-4)

    def update(self, batch: list[torch.Tensor]) -> None:
        """One step of the critics and of the actor."""
        seen, proposal, applied, taken, after, ended = batch
        with torch.no_grad():
            noise = (NOISE * torch.randn_like(applied)).clamp(-0.2, 0.2)
            next_action = (self.slow[0](after) + noise).clamp(-1.0, 1.0)
            target = GAMMA * (1.0 - ended) * torch.min(*self.slow[1](after, next_action))
        proxy, temporal = torch.zeros(()), torch.zeros(())
        for value, of_proposal in zip(self.critics(seen, applied), self.critics(seen, proposal)):
            proxy = proxy + (taken * ((value - 1.0) ** 2 + (of_proposal + 1.0) ** 2)).mean()
            temporal = temporal + ((value - target) ** 2).mean()
        self.critic_steps.zero_grad()
        (proxy + temporal).backward()
        self.critic_steps.step()
        action = self.actor(seen)
        imitation = (taken * WEIGHTS * (action - applied) ** 2).sum() / (2.0 * taken.sum() + 1.0)
        loss = -self.critics(seen, action)[0].mean() + imitation
        self.actor_steps.zero_grad()
        loss.backward()
        self.actor_steps.step()
        with torch.no_grad():
            for slow, fast in zip(self.slow.parameters(), nn.ModuleList([self.actor, self.critics]).parameters()):
                slow.lerp_(fast, TAU)


def main() -> None:
    arguments = arguments_of(__doc__, "pvp")
    learner, random = Learner(), np.random.default_rng(0)
    # As in the paper half of a batch is the expert's, however seldom it still takes over.
    experts, learners = (Memory(259, 2, 2, 1, 259, 1) for _ in range(2))
    for lesson in lessons(learner.actor, "PVP", arguments, DEMONSTRATION):
        applied, taken = lesson.info["applied"], lesson.info["takeover"]
        # An episode's last observation counts for nothing: its end is the target's.
        rows = (lesson.observations, lesson.proposal, applied, taken, lesson.after, lesson.ended)
        for memory, mine in ((experts, taken), (learners, ~taken)):
            memory.add(*(column[mine] for column in rows))
        for _ in range(arguments.updates):
            halves = [memory.draw(random, 128) for memory in (experts, learners) if memory.count]
            learner.update([torch.cat(columns) for columns in zip(*halves)])


if __name__ == "__main__":
    main()
