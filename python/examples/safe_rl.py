"""Safe reinforcement learning: PPO with a Lagrange multiplier on MetaDrive's cost.

    pip install torch
    python safe_rl.py --steps 15000000 --cost-limit 0.15

A step in contact or off the road costs 1, which `info["cost"]` keeps apart from the reward,
and ends a training episode: the limit is the share of episodes that may end so. The
multiplier grows while the share is larger, and shrinks below it.
"""

from __future__ import annotations

from ppo import arguments_of, train

if __name__ == "__main__":
    train(arguments_of(__doc__, "safe_rl", 0.15))
