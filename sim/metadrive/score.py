"""The account of one episode: applied commands, contacts, and the outcome.

The mirror of `sim/src/score.rs`: the same bits enter the digest.
"""

import hashlib
import struct

import wire_layout as layout

# Applied when no command is young enough: no steering, full brake.
BRAKE = (0.0, -1.0)


class Score:
    """The account of the running episode."""

    def __init__(self, seed):
        self.seed = seed
        self.vehicle_contacts = 0
        self.object_contacts = 0
        self.crash_last_step = False
        self.braked = 0
        self._command_age_max_ns = 0
        self._commands = hashlib.sha256()

    def obey(self, command, now_ns):
        """The action of a command, or the brake when there is none young enough;
        its bits enter the digest either way."""
        if command is None:
            self.braked += 1
            steer, pedal = BRAKE
            driver, reason = layout.Driver.BRAKE, layout.Reason.BLIND
        else:
            age_ns = max(now_ns - command.header.taken_ns, 0)
            self._command_age_max_ns = max(self._command_age_max_ns, age_ns)
            steer, pedal = command.steer, command.pedal
            driver, reason = command.driver, command.reason
        self._commands.update(struct.pack("<ddII", steer, pedal, driver, reason))
        return steer, pedal

    def count(self, step):
        """Counts what a tick touched."""
        self.vehicle_contacts += step.touched_vehicle
        self.object_contacts += step.touched_object
        # MetaDrive's flag counts a sidewalk, too, as the built-in world's does.
        self.crash_last_step = step.touched_vehicle or step.touched_object or step.on_sidewalk

    def episode(self, world, outcome):
        """The finished episode, without its header and the skipped ticks."""
        digest = (layout.ctypes.c_uint8 * 32).from_buffer_copy(self._commands.digest())
        return layout.Episode(
            seed=self.seed,
            ticks=world.ticks,
            completion=world.completion,
            driven_m=world.driven_m,
            vehicle_contacts=self.vehicle_contacts,
            object_contacts=self.object_contacts,
            braked=self.braked,
            outcome=outcome,
            crash_last_step=int(self.crash_last_step),
            command_digest=digest,
        )

    def progress(self, world, outcome):
        """The progress of the episode, without its header and the skipped ticks."""
        return layout.Progress(
            seed=self.seed,
            completion=world.completion,
            route_m=world.route_m,
            speed_mps=world.speed_mps,
            episode_ticks=world.ticks,
            vehicle_contacts=self.vehicle_contacts,
            object_contacts=self.object_contacts,
            braked=self.braked,
            command_age_max_ns=self._command_age_max_ns,
            outcome=outcome,
        )
