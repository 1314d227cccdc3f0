"""A run's shared memory: the mirror of `shm-config/src/run.rs` and `wire/`.

Every name, limit and layout comes from `wire_layout.py`, which is generated.
"""

import ctypes
import fcntl
import os
import stat

import iceoryx2

import wire_layout as layout
from producers import Producers

# Messages of foreign processes that one read skips, so that a flood on a queue
# cannot block the reader.
FOREIGN_MAX = 64
# Publishers that have gone and left something unread, of one service and reader, as
# in `shm-config/src/wire/mod.rs`.
GONE_MAX = 2 * layout.PUBLISHERS_MAX


class WireError(Exception):
    """What is wrong with the run or its shared memory, and what to do."""


def _private_folder(path):
    """Makes a folder that only this user enters, or refuses one that others can."""
    try:
        os.mkdir(path, 0o700)
    except FileExistsError:
        pass
    found = os.lstat(path)
    mode = stat.S_IMODE(found.st_mode)
    if found.st_uid != os.getuid() or not stat.S_ISDIR(found.st_mode) or mode & 0o077:
        raise WireError(
            f"{path}: belongs to user {found.st_uid} with mode {mode:o}, so it is not safe to use; "
            "remove it or ask its owner"
        )


def _is_file_of_ours(found):
    return found.st_uid == os.getuid() and stat.S_ISREG(found.st_mode)


def _close_to_others(path):
    """Removes other users' rights to a file of this user; other files are unchanged.

    Every user may make such a name: a link is not followed, a pipe not waited for,
    and what was opened is asked again what it is.
    """
    try:
        found = os.lstat(path)
        if not _is_file_of_ours(found) or not found.st_mode & 0o077:
            return
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        return
    try:
        found = os.fstat(file)
        if _is_file_of_ours(found):
            # The owner's bits are kept: the library encodes the file's state in them.
            os.fchmod(file, stat.S_IMODE(found.st_mode) & 0o700)
    finally:
        os.close(file)


class Wire:
    """A process's membership in a run, making the run if it does not exist. It takes
    state only from the processes that the process `author` names in its rosters."""

    def __init__(self, run_name, process, author):
        user = str(os.getuid())
        user_dir = layout.USER_DIR.replace("{user}", user)
        self.dir = os.path.join(user_dir, run_name)
        self.prefix = layout.PREFIX.replace("{user}", user).replace("{run}", run_name)
        try:
            _private_folder(user_dir)
            _private_folder(self.dir)
            self._alive = self._hold_alive()
        except OSError as error:
            raise WireError(f"{error.filename or self.dir}: {error.strerror}") from None
        iceoryx2.set_log_level(iceoryx2.LogLevel.Fatal)
        self._node = self._join(run_name, process)
        self._make_private()
        self.producers = Producers(author, self._port(layout.ROSTER).receive)

    def _hold_alive(self):
        """The shared lock by which the run is provably alive; the kernel drops it."""
        path = os.path.join(self.dir, layout.ALIVE_FILE)
        # Neither a link nor a pipe is followed or waited for.
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
        file = os.open(path, flags, 0o600)
        if not _is_file_of_ours(os.fstat(file)):
            os.close(file)
            raise WireError(f"{path}: is no regular file of this user; remove it")
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            raise WireError(f"{path}: the run is being cleaned up; try again") from None
        return file

    def _join(self, run_name, process):
        config = iceoryx2.config.default()
        config.global_cfg.root_path = iceoryx2.Path.new(self.dir)
        config.global_cfg.prefix = iceoryx2.FileName.new(self.prefix)
        config.defaults.publish_subscribe.subscriber_expired_connection_buffer = GONE_MAX
        try:
            return (
                iceoryx2.NodeBuilder.new()
                .name(iceoryx2.NodeName.new(process))
                .config(config)
                .signal_handling_mode(iceoryx2.SignalHandlingMode.Disabled)
                .create(iceoryx2.ServiceType.Ipc)
            )
        except iceoryx2.NodeCreationFailure as error:
            raise WireError(f"cannot join run '{run_name}': {error}") from None

    def _make_private(self):
        """Closes what the library leaves open to every user (a counter, 16 bytes)."""
        for name in os.listdir(layout.SHARED_MEMORY_DIR):
            if name.startswith(self.prefix):
                _close_to_others(os.path.join(layout.SHARED_MEMORY_DIR, name))

    def publisher(self, service):
        """Opens the publishing end of a service, with its readers' doorbells."""
        try:
            topic = self._topic(service)
            port = (
                topic.publisher_builder()
                .max_loaned_samples(1)
                .backpressure_strategy(iceoryx2.BackpressureStrategy.DiscardData)
                .create()
            )
            bells = [self._bell(process).notifier_builder().create() for process in service.to]
        except (iceoryx2.PublisherCreateError, iceoryx2.NotifierCreateError) as error:
            raise self._refused(service.name, error) from None
        return Publisher(port, bells, topic)

    def subscriber(self, service):
        """Opens the reading end of a service."""
        return Subscriber(self._port(service), service, self.producers)

    def _port(self, service):
        try:
            port = self._topic(service).subscriber_builder().buffer_size(service.depth).create()
        except iceoryx2.SubscriberCreateError as error:
            raise self._refused(service.name, error) from None
        return Port(port, service.message)

    def doorbell(self, process):
        """Opens the process's own doorbell."""
        try:
            return Doorbell(self._bell(process).listener_builder().create())
        except iceoryx2.ListenerCreateError as error:
            raise self._refused(f"doorbell/{process}", error) from None

    def _bell(self, process):
        name = f"doorbell/{process}"
        try:
            return (
                self._node.service_builder(iceoryx2.ServiceName.new(name))
                .event()
                .max_nodes(layout.NODES_MAX)
                .max_listeners(layout.PUBLISHERS_MAX)
                .max_notifiers(layout.NODES_MAX)
                .event_id_max_value(1)
                .open_or_create()
            )
        except iceoryx2.EventOpenOrCreateError as error:
            raise self._refused(name, error) from None

    def _topic(self, service):
        key = iceoryx2.AttributeKey.new(layout.LAYOUT_KEY)
        ours = iceoryx2.AttributeValue.new(service.message.LAYOUT)
        try:
            return (
                self._node.service_builder(iceoryx2.ServiceName.new(service.name))
                .publish_subscribe(service.message)
                .enable_safe_overflow(True)
                .subscriber_max_buffer_size(service.most)
                .subscriber_max_borrowed_samples(1)
                .history_size(service.history)
                .max_publishers(layout.PUBLISHERS_MAX)
                .max_subscribers(layout.SUBSCRIBERS_MAX)
                .max_nodes(layout.NODES_MAX)
                .open_or_create_with_attributes(iceoryx2.AttributeVerifier.new().require(key, ours))
            )
        except iceoryx2.PublishSubscribeOpenOrCreateError as error:
            raise self._layout_error(service, error) from None

    def _layout_error(self, service, error):
        """Says so when it is the layout or the type that differs."""
        if "Attributes" in str(error) or "Types" in str(error):
            return WireError(
                f"service '{service.name}': the running side uses another message layout than "
                f"sim/metadrive/wire_layout.py ({service.message.LAYOUT}); stop the run "
                "(./vlaps down), renew that file as its first lines say, and rebuild"
            )
        return self._refused(service.name, error)

    @staticmethod
    def _refused(service, error):
        return WireError(
            f"service '{service}': {error}; check free space in {layout.SHARED_MEMORY_DIR} "
            "and that the run is yours"
        )


class Publisher:
    """Publishes one service and wakes its readers. Never waits for a reader."""

    def __init__(self, port, bells, topic):
        self._port = port
        self._topic = topic
        self._bells = bells
        self._sequence = 0
        self._pid = os.getpid()

    def send(self, message):
        """Numbers and publishes the message; whether it went out."""
        self._sequence += 1
        message.header.sequence = self._sequence
        message.header.producer = self._pid
        try:
            self._port.send_copy(message)
            sent = True
        except (iceoryx2.LoanError, iceoryx2.SendError):
            # Only exhausted shared memory; the next message tries again.
            sent = False
        for bell in self._bells:
            try:
                bell.notify()
            except iceoryx2.NotifierNotifyError:
                # A full bell is already ringing; a dead one is swept by others.
                pass
        return sent

    def has_readers(self):
        """Whether a process reads the service."""
        return self._topic.dynamic_config.number_of_subscribers > 0

    def update_connections(self):
        """Connects to readers that came since the last message, between ticks."""
        try:
            self._port.update_connections()
        except iceoryx2.ConnectionFailure:
            # It shows again at the next send.
            pass


class Port:
    """The queue of one service, with the sender of each message."""

    def __init__(self, port, message):
        self._port = port
        self._message = message

    def receive(self, is_taken=lambda _sender, _membership: True):
        """The next (sender, message) of the queue, None when it is empty. The sender
        is the process id that the library wrote into the envelope, not the header's
        own claim. A message that is not taken is None, and never copied."""
        try:
            sample = self._port.receive()
        except iceoryx2.ReceiveError:
            return None
        if sample is None:
            return None
        # No process has the id 0: it is on no roster.
        node_id = sample.header.node_id
        sender = node_id.pid(iceoryx2.ServiceType.Ipc) or 0
        message = None
        if is_taken(sender, node_id.value):
            size = ctypes.sizeof(self._message)
            message = self._message.from_buffer_copy(ctypes.string_at(sample.payload_ptr, size))
        sample.delete()
        return sender, message


class Subscriber:
    """Reads one service; looks for new publishers by itself. Messages of processes
    that the run did not start as the service's producer are refused, counted, and
    never seen here."""

    def __init__(self, port, service, producers):
        self._port = port
        self._service = service
        self._producers = producers
        # The process and the membership that sent the last message that was taken.
        self._last = None

    def _next(self):
        """The next message of the queue that is from a known producer."""
        for _ in range(FOREIGN_MAX):
            received = self._port.receive(self._is_taken)
            if received is None:
                return None
            _, message = received
            if message is not None:
                return message
        return None

    def _is_taken(self, sender, membership):
        if not self._producers.admits(sender, self._service):
            return False
        self._last = self._producers.compare(sender, membership, self._service, self._last)
        return True

    def newest(self, admit):
        """A copy of the newest admissible message since the last look, or None.

        `admit` returns the RefusalKind of a message that it refuses, else None. It is
        asked before the newest is chosen, so a message that it refuses never hides
        one that it admits. Refusals are counted by kind."""
        newest = None
        # Bounded: a hostile publisher cannot hold a tick.
        for _ in range(layout.PUBLISHERS_MAX):
            message = self._next()
            if message is None:
                break
            refusal = admit(message)
            if refusal is None:
                newest = message
            else:
                self._producers.count(refusal)
        return newest


class Doorbell:
    """Wakes the process when one of its services has a new message."""

    def __init__(self, listener):
        self._listener = listener

    def wait(self, timeout_ns):
        """Returns when it rings or the time is up; may return early."""
        try:
            self._listener.timed_wait(iceoryx2.Duration.from_nanos(max(int(timeout_ns), 1)))
        except iceoryx2.ListenerWaitError:
            # A signal; the caller looks at the clock and at the signal.
            pass
