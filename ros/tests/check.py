"""Reads each message with a library of others, writes it again, and compares the bytes.

    check.py rosbags|mcap|cyclonedds MESSAGES.json
"""

import json
import sys


def with_rosbags(messages):
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    # Without the types that it has: all definitions are those of the messages.
    for message in messages:
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(message["definition"], message["name"]))
        found = store.hash_rihs01(message["name"])
        assert found == message["hash"], (message["name"], found, message["hash"])
        read = store.deserialize_cdr(message["cdr"], message["name"])
        yield message, bytes(store.serialize_cdr(read, message["name"]))


def with_mcap(messages):
    from mcap_ros2 import _dynamic

    for message in messages:
        name, definition = message["name"], message["definition"]
        read = _dynamic.generate_dynamic(name, definition)[name](message["cdr"])
        yield message, bytes(_dynamic.serialize_dynamic(name, definition)[name](read))


def with_cyclonedds(messages):
    """The bytes through a writer and a reader of Cyclone DDS, under the names of ROS 2."""
    import time

    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.idl import make_idl_struct, types
    from cyclonedds.pub import DataWriter
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic

    words = {
        "bool": bool, "byte": types.byte, "string": str,
        "uint8": types.uint8, "int32": types.int32, "uint32": types.uint32,
        "uint64": types.uint64, "float32": types.float32, "float64": types.float64,
    }

    def structs(message):
        """The class of each type of a definition; nested ones are defined last in it."""
        parts = message["definition"].split("=" * 80 + "\nMSG: ")
        texts = {message["name"]: parts[0]}
        for part in parts[1:]:
            name, _, text = part.partition("\n")
            texts[name.replace("/", "/msg/")] = text
        made = {}

        def make(name):
            if name not in made:
                fields = []
                for line in texts[name].splitlines():
                    kind, _, field = line.partition(" ")
                    kind, _, length = kind.partition("[")
                    of = words[kind] if kind in words else make(kind.replace("/", "/msg/"))
                    if length == "]":
                        of = types.sequence[of]
                    elif length:
                        of = types.array[of, int(length[:-1])]
                    fields.append((field, of))
                package, _, short = name.rpartition("/")
                dds = package.replace("/", ".") + ".dds_." + short + "_"
                made[name] = make_idl_struct(short + "_", dds, dict(fields))
            return made[name]

        return make(message["name"])

    participant = DomainParticipant(77)
    qos = Qos(Policy.Reliability.Reliable(10**10), Policy.History.KeepLast(4))
    for message in messages:
        struct = structs(message)
        sent = struct.deserialize(message["cdr"])
        topic = Topic(participant, "rt/" + message["name"].replace("/", "_"), struct)
        reader, writer = DataReader(participant, topic, qos), DataWriter(participant, topic, qos)
        writer.write(sent)
        until = time.monotonic() + 20
        taken = []
        while not taken and time.monotonic() < until:
            taken = reader.take()
        assert taken, message["name"]
        yield message, bytes(taken[0].serialize())


def main():
    library, path = sys.argv[1:]
    with open(path) as file:
        messages = json.load(file)
    for message in messages:
        message["cdr"] = bytes.fromhex(message["cdr"])
    checks = {"rosbags": with_rosbags, "mcap": with_mcap, "cyclonedds": with_cyclonedds}
    try:
        count = 0
        for message, again in checks[library](messages):
            assert again == message["cdr"], (message["name"], len(again), len(message["cdr"]))
            count += 1
    except ImportError as error:
        print(f"skipped: {library}: {error}")
        return
    print(f"{library}: {count} types, each with the same bytes again")


if __name__ == "__main__":
    main()
