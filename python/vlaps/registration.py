"""Names of the environments for `gymnasium.make` and `gymnasium.make_vec`."""

from __future__ import annotations

import gymnasium

#: MetaDrive's task at its commit c29cc37, which the built-in world reproduces.
ENV_ID = "vlaps/MetaDrive-c29cc37-v0"


def register() -> None:
    """Registers the environments; called once by Gymnasium or by importing `vlaps`."""
    if ENV_ID in gymnasium.registry:
        return
    gymnasium.register(
        id=ENV_ID,
        entry_point="vlaps.env:MetaDriveEnv",
        vector_entry_point="vlaps.vector:MetaDriveVectorEnv",
        # The world itself limits the steps of an episode (`horizon`).
        max_episode_steps=None,
    )
