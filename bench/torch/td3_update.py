"""Times the updates of `learner/src/algorithm` in PyTorch.

Reads lines `KIND HIDDEN BATCH THREADS SECONDS STEPS_MIN` and answers each with
`STEPS SECONDS`. `./vlaps bench learner` runs it.
"""

import sys
import time

import torch
from torch import nn

FEATURES, ACTIONS, HELD = 259, 2, 20_000
GAMMA, TAU, NOISE, CLIP, RATE, AVERAGED = 0.99, 0.005, 0.2, 0.5, 1e-4, 200.0


def net(inputs, hidden, outputs, *head):
    return nn.Sequential(
        nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, outputs), *head
    )


def copy(network, hidden, sizes, *head):
    twin = net(sizes[0], hidden, sizes[1], *head)
    twin.load_state_dict(network.state_dict())
    return twin.requires_grad_(False)


def follow(target, network, share):
    with torch.no_grad():
        torch._foreach_lerp_(list(target.parameters()), list(network.parameters()), share)


class Replay:
    """Two replay buffers in tensors; half of a batch comes from each."""

    def __init__(self):
        self.states = torch.rand(2 * HELD, FEATURES)
        self.nexts = torch.rand(2 * HELD, FEATURES)
        self.applied, self.policy, self.expert = (2 * torch.rand(2 * HELD, ACTIONS) - 1 for _ in range(3))
        self.preferred = (torch.arange(2 * HELD) < HELD).float().unsqueeze(1)
        self.goes_on = torch.ones(2 * HELD, 1)

    def sample(self, batch, *tensors):
        rows = torch.randint(0, HELD, (batch,))
        rows[batch // 2 :] += HELD
        return [tensor[rows] for tensor in tensors]


class Pvp:
    """TD3 without rewards: twin critics, proxy values, an actor update every second step."""

    def __init__(self, hidden):
        critic = [FEATURES + ACTIONS, 1]
        self.actor = net(FEATURES, hidden, ACTIONS, nn.Tanh())
        self.actor_target = copy(self.actor, hidden, [FEATURES, ACTIONS], nn.Tanh())
        self.critics = nn.ModuleList([net(critic[0], hidden, 1) for _ in range(2)])
        self.critic_targets = nn.ModuleList([copy(c, hidden, critic) for c in self.critics])
        self.actor_adam = torch.optim.Adam(self.actor.parameters(), RATE)
        self.critic_adam = torch.optim.Adam(self.critics.parameters(), RATE)
        self.updates = 0

    def update(self, replay, batch):
        states, nexts, applied, policy, preferred, goes_on = replay.sample(
            batch, replay.states, replay.nexts, replay.applied, replay.policy, replay.preferred, replay.goes_on
        )
        with torch.no_grad():
            noise = (NOISE * torch.randn(batch, ACTIONS)).clamp(-CLIP, CLIP)
            actions = (self.actor_target(nexts) + noise).clamp(-1, 1)
            inputs = torch.cat([nexts, actions], 1)
            values = torch.minimum(*(target(inputs) for target in self.critic_targets))
            values = GAMMA * goes_on * values
        # The first half of the batch is from the buffer of preferred transitions.
        half = batch // 2
        taken, refused = torch.cat([states, applied], 1), torch.cat([states[:half], policy[:half]], 1)
        loss = 0.0
        for critic in self.critics:
            value = critic(taken)
            loss = loss + ((value - values) ** 2 + preferred * (value - 1) ** 2).mean()
            loss = loss + ((critic(refused) + 1) ** 2).sum() / batch
        self.critic_adam.zero_grad()
        loss.backward()
        self.critic_adam.step()
        self.updates += 1
        if self.updates % 2 == 0:
            actions = self.actor(states)
            error = preferred * (actions - applied)
            loss = -self.critics[0](torch.cat([states, actions], 1)).mean()
            loss = loss + (error**2).sum() / (ACTIONS * (preferred.sum() + 1e-5))
            self.actor_adam.zero_grad()
            loss.backward(inputs=list(self.actor.parameters()))
            self.actor_adam.step()
            follow(self.actor_target, self.actor, TAU)
            follow(self.critic_targets, self.critics, TAU)


class Regression:
    """Minimises the squared distance to the expert's action; averages the actors."""

    def __init__(self, hidden):
        self.actor = net(FEATURES, hidden, ACTIONS, nn.Tanh())
        self.average = copy(self.actor, hidden, [FEATURES, ACTIONS], nn.Tanh())
        self.adam = torch.optim.Adam(self.actor.parameters(), RATE)
        self.weight = torch.tensor([10.0, 1.0])

    def update(self, replay, batch):
        states, expert = replay.sample(batch, replay.states, replay.expert)
        loss = (self.weight * (self.actor(states) - expert) ** 2).sum() / batch
        self.adam.zero_grad()
        loss.backward()
        self.adam.step()
        follow(self.average, self.actor, 1.0 / AVERAGED)


def main():
    print("torch", torch.__version__, flush=True)
    replay, kept, student = Replay(), None, None
    for line in sys.stdin:
        kind, hidden, batch, threads, seconds, steps_min = line.split()
        hidden, batch, seconds = int(hidden), int(batch), float(seconds)
        torch.set_num_threads(int(threads))
        if kept != (kind, hidden, batch):
            kept, student = (kind, hidden, batch), {"pvp": Pvp, "regression": Regression}[kind](hidden)
        steps, begun, taken = 0, time.perf_counter(), 0.0
        while steps < int(steps_min) or taken < seconds:
            student.update(replay, batch)
            steps += 1
            taken = time.perf_counter() - begun
        print(steps, taken, flush=True)


main()
