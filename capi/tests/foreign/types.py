"""A planner that gives messages of another type: each is a TypeError, and nothing is read."""

from vlaps import process


def refused(call, *messages):
    try:
        call(*messages)
    except TypeError as error:
        assert "not a Tick" in str(error), error
    else:
        raise AssertionError(f"{call} takes {messages}")


def main():
    run = process.Member("planner")
    tick, writer = process.Tick(), run.writer("plan")
    refused(writer.publish, tick)
    refused(lambda message: run.admit("plan", message), tick)
    refused(run.answer, tick)
    refused(run.finish_tick, tick, process.Progress())
    refused(run.finish_tick, process.Observation(), tick)
    writer.close()
    run.writer("plan").close()
    reader = run.reader("observation")
    assert reader.newest() is None
    reader.close()


process.run(main)
