"""A process of a run in Python: a world, a planner, a judge on libvlaps.

The messages are ctypes structures with the fields of `capi/include/vlaps.h`, made from
what the library says of itself, so no layout is written twice. The module needs no other
package; it loads the library, Linux alone has it, when a name of it is first used.
`docs/foreign.md` explains the calls.

    from vlaps import process

    run = process.Member("planner")
    while (seen := run.await_observation()) is not None:
        plan = process.Plan()
        ...
        run.answer(plan)
"""

from __future__ import annotations

import ctypes
import json
import os
import re
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

LIBRARY = "libvlaps.so"
_NONE, _ENDED = 1, 2


class Error(Exception):
    """A call that failed; `kind` is a word of the list `Kind`, such as `refused`."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


class _Struct(ctypes.Structure):
    # Without a place for other attributes: a wrong name is an error.
    __slots__ = ()


class _List:
    """A closed list: `Outcome.ARRIVED` is a code, `Outcome.word(code)` its word."""

    def __init__(self, words: dict[str, int]) -> None:
        self._words = {code: word for word, code in words.items()}
        for word, code in words.items():
            setattr(self, re.sub("[ -]", "_", word).upper(), code)

    def word(self, code: int) -> str:
        return self._words.get(code, f"unknown {code}")


_NUMBERS = {
    "f32": ctypes.c_float,
    "f64": ctypes.c_double,
    "u8": ctypes.c_uint8,
    "u32": ctypes.c_uint32,
    "u64": ctypes.c_uint64,
}


def _places() -> list[Path]:
    """Where the library may be, in this order."""
    if named := os.environ.get("VLAPS_LIBRARY"):
        return [Path(named)]
    here = Path(__file__).resolve().parent
    checkouts = [Path(root) for root in [os.environ.get("VLAPS_ROOT")] if root]
    checkouts.append(here.parent.parent)
    return [here / LIBRARY, *(root / "target" / "release" / LIBRARY for root in checkouts)]


class _Library:
    """libvlaps, and the types of its messages."""

    def __init__(self) -> None:
        places = _places()
        found = next((place for place in places if place.is_file()), None)
        if found is None:
            looked = ", ".join(map(str, places))
            raise ImportError(
                f"no {LIBRARY} at {looked}: build it with `cargo build --release -p capi`, "
                "or name it in VLAPS_LIBRARY"
            )
        self.calls = ctypes.CDLL(str(found))
        self.calls.vlaps_describe.restype = ctypes.c_char_p
        described = json.loads(self.calls.vlaps_describe())
        self.types: dict[str, Any] = {}
        for message in described["messages"]:
            self.types[message["name"]] = self._struct(message)
        for name, words in described["lists"].items():
            self.types[name] = _List(words)
        self.messages: dict[str, str] = {row["name"]: row["message"] for row in described["services"]}
        self._declare()

    def _declare(self) -> None:
        """Tells ctypes the arguments and the answer of each function of `vlaps.h`."""
        text, place, size, number = (
            ctypes.c_char_p,
            ctypes.c_void_p,
            ctypes.c_size_t,
            ctypes.c_int,
        )
        wide, signed, unsigned = ctypes.c_uint64, ctypes.c_int64, ctypes.c_uint32
        of = {name: ctypes.POINTER(self.types[name]) for name in self.messages.values()}
        tick = ctypes.POINTER(self.types["Tick"])
        functions: dict[str, list[Any]] = {
            # The answer, then the arguments.
            "last_error": [text],
            "layout": [wide],
            "join_as": [number, wide, text, number, ctypes.POINTER(text)],
            "leave": [number],
            "open": [number, text, unsigned],
            "close": [number, number],
            "newest": [number, number, place, size],
            "next": [number, number, place, size],
            "publish": [number, number, place, size],
            "admit": [number, text, place, size],
            "wait": [number, wide],
            "pid_of": [signed, text],
            "now_ns": [wide],
            "is_lockstep": [number],
            "setting": [number, text, ctypes.POINTER(ctypes.c_double)],
            "beams": [number, of["Observation"], ctypes.POINTER(ctypes.c_double), size],
            "await_tick": [number, tick],
            "finish_tick": [number, of["Observation"], of["Progress"]],
            "await_observation": [number, of["Observation"]],
            "answer": [number, of["Plan"]],
        }
        for name, (answer, *arguments) in functions.items():
            call = getattr(self.calls, f"vlaps_{name}")
            call.restype, call.argtypes = answer, arguments

    def place(self, message: Any, name: str) -> Any:
        """The memory of a message, which has to be of the type of this name."""
        if not isinstance(message, self.types[name]):
            raise TypeError(f"a {name} is needed, not a {type(message).__name__}")
        return ctypes.byref(message)

    def message_of(self, service: str) -> str:
        """The name of the type of a service's messages."""
        try:
            return self.messages[service]
        except KeyError:
            raise Error("invalid", f"no service '{service}'") from None

    def _struct(self, message: dict[str, Any]) -> Any:
        fields = [(field["name"], self._type(field["type"])) for field in message["fields"]]
        said = "\n".join(f"{field['name']}: {field['doc']}" for field in message["fields"])
        names = {"__slots__": (), "__doc__": said, "_fields_": fields}
        struct = type(message["name"], (_Struct,), names)
        offsets = [getattr(struct, name).offset for name, _ in fields]
        expected = [field["offset"] for field in message["fields"]]
        if (ctypes.sizeof(struct), offsets) != (message["bytes"], expected):
            raise ImportError(f"{message['name']}: ctypes lays it out in another way")
        return struct

    def _type(self, name: str) -> Any:
        if array := re.fullmatch(r"\[(\w+); (\d+)\]", name):
            return self._type(array[1]) * int(array[2])
        return _NUMBERS.get(name) or self.types[name]

    def check(self, answer: int) -> int:
        if answer < 0:
            kind = self.types["Kind"].word(-answer)
            raise Error(kind, self.calls.vlaps_last_error().decode(errors="replace"))
        return answer


_loaded: _Library | None = None


def _library() -> _Library:
    global _loaded
    if _loaded is None:
        _loaded = _Library()
    return _loaded


def __getattr__(name: str) -> Any:
    """The messages and lists of the library, such as `Observation` and `Outcome`."""
    if not name[:1].isupper():
        raise AttributeError(name)
    try:
        return _library().types[name]
    except KeyError:
        raise AttributeError(f"libvlaps has no message or list {name}") from None


class _Port:
    def __init__(self, service: str, how: str) -> None:
        library = _library()
        code = getattr(library.types["Use"], how)
        self._number = library.check(library.calls.vlaps_open(service.encode(), code))
        self._message = library.messages[service]

    def close(self) -> None:
        """Closes the port; a call of it is an `Error` then."""
        library = _library()
        library.check(library.calls.vlaps_close(self._number))


class Reader(_Port):
    """Reads the newest message of a service, or each of a queue, once it is admitted."""

    def _read(self, call: Any) -> Any:
        message = _library().types[self._message]()
        size = ctypes.sizeof(message)
        if _library().check(call(self._number, ctypes.byref(message), size)) == _NONE:
            return None
        return message

    def newest(self) -> Any:
        """The newest message since the last read; None when none came."""
        return self._read(_library().calls.vlaps_newest)

    def next(self) -> Any:
        """The next message of the queue; None when there is none."""
        return self._read(_library().calls.vlaps_next)


class Writer(_Port):
    """Publishes a service."""

    def __init__(self, service: str) -> None:
        super().__init__(service, "WRITE")

    def publish(self, message: Any) -> None:
        """Sends a message; `Error` names the field that its check refuses."""
        library = _library()
        place = library.place(message, self._message)
        size = ctypes.sizeof(message)
        library.check(library.calls.vlaps_publish(self._number, place, size))


class Member:
    """The membership of this process in the run that started it. One for each process, and
    only on the thread that made it."""

    def __init__(self, process: str, arguments: list[str] | None = None) -> None:
        library = _library()
        words = [word.encode() for word in (sys.argv if arguments is None else arguments)]
        argv = (ctypes.c_char_p * (len(words) + 1))(*words, None)
        # The library takes the signal as a request to stop, and not as an exception. Only
        # the main thread may say so.
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        layout = library.calls.vlaps_layout()
        joined = library.calls.vlaps_join_as(layout, process.encode(), len(words), argv)
        library.check(joined)
        self._library = library
        self._calls = library.calls

    def leave(self) -> None:
        """Leaves the run; its ports are closed."""
        self._library.check(self._calls.vlaps_leave())

    def reader(self, service: str, *, every: bool = False) -> Reader:
        """A reader of the newest message, or with `every` of each of a queue."""
        return Reader(service, "EVERY" if every else "NEWEST")

    def writer(self, service: str) -> Writer:
        """A publisher of a service of this process."""
        return Writer(service)

    def admit(self, service: str, message: Any) -> None:
        """The check of a service alone; `Error` names the field."""
        place = self._library.place(message, self._library.message_of(service))
        size = ctypes.sizeof(message)
        self._library.check(self._calls.vlaps_admit(service.encode(), place, size))

    def wait(self, limit_ns: int = 1_000_000_000) -> bool:
        """Sleeps until a message comes, at most `limit_ns` and 20 ms. False: exit with 0."""
        answer = self._calls.vlaps_wait(limit_ns)
        return self._library.check(answer) != _ENDED

    def beams(self, observation: Any) -> list[float]:
        """For a world: writes the run's scanner into an observation. Returns where each beam
        looks, rad counter-clockwise from the heading of the body; the beams begin at
        `scanner_x_body_m`, `scanner_y_body_m`."""
        place = self._library.place(observation, "Observation")
        directions = (ctypes.c_double * len(observation.ranges_m))()
        self._library.check(self._calls.vlaps_beams(place, directions, len(directions)))
        return directions[: observation.beam_count]

    def await_tick(self) -> Any:
        """A world's next tick; None: exit with 0."""
        tick = self._library.types["Tick"]()
        answer = self._library.check(self._calls.vlaps_await_tick(ctypes.byref(tick)))
        return None if answer == _ENDED else tick

    def finish_tick(self, observation: Any, progress: Any) -> bool:
        """The world's answer to its tick. False: exit with 0."""
        place = self._library.place
        places = (place(observation, "Observation"), place(progress, "Progress"))
        return self._library.check(self._calls.vlaps_finish_tick(*places)) != _ENDED

    def await_observation(self) -> Any:
        """A planner's next observation; None: exit with 0."""
        seen = self._library.types["Observation"]()
        answer = self._library.check(self._calls.vlaps_await_observation(ctypes.byref(seen)))
        return None if answer == _ENDED else seen

    def answer(self, plan: Any) -> None:
        """The plan for the observation awaited last."""
        self._library.check(self._calls.vlaps_answer(self._library.place(plan, "Plan")))

    def setting(self, key: str) -> float:
        """A number of the run's configuration, such as `scanner.range_m`."""
        number = ctypes.c_double()
        self._library.check(self._calls.vlaps_setting(key.encode(), ctypes.byref(number)))
        return number.value

    def pid_of(self, process: str) -> int:
        """The process id that the run names for a process; 0 for none."""
        return self._library.check(self._calls.vlaps_pid_of(process.encode()))

    def now_ns(self) -> int:
        """The machine's monotonic clock, ns."""
        return int(self._calls.vlaps_now_ns())

    @property
    def is_lockstep(self) -> bool:
        """Whether the run's clock is simulated."""
        return self._library.check(self._calls.vlaps_is_lockstep()) == 1


def run(main: Callable[[], None]) -> None:
    """Runs a program's main and leaves the run after it. An error of the library becomes
    one line and exit code 2, which the supervisor reads as a set-up that would fail again."""
    try:
        main()
        _library().check(_library().calls.vlaps_leave())
    except (Error, ImportError) as error:
        print(f"{Path(sys.argv[0]).name}: {error}", file=sys.stderr)
        sys.exit(2)
