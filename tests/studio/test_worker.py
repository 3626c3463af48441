import threading
from collections.abc import Callable, Iterator

import pytest

from pcore.studio.worker import Worker


@pytest.fixture
def told() -> list[str]:
    return []


@pytest.fixture
def worker(told: list[str]) -> Iterator[Worker]:
    made = Worker(lambda error: told.append(f"failed: {error}"), rest=0.02)
    made.start()
    yield made
    made.stop()


def test_commands_are_all_done_in_their_order(worker: Worker, told: list[str]) -> None:
    for number in range(50):
        worker.do(lambda number=number: told.append(str(number)))
    assert worker.wait()
    assert told == [str(number) for number in range(50)]


def test_of_drawings_only_the_newest_is_done(worker: Worker, told: list[str]) -> None:
    gate = threading.Event()
    worker.do(lambda: gate.wait(5) and None)
    for number in range(50):
        worker.draw(lambda number=number: told.append(f"quick {number}"), None)
    gate.set()
    assert worker.wait()
    assert told == ["quick 49"]


def test_a_drawing_at_rest_ends_when_something_else_is_wished(
    worker: Worker, told: list[str]
) -> None:
    begun, gate = threading.Event(), threading.Event()

    def slow(cancelled: Callable[[], bool]) -> Iterator[None]:
        told.append("first")
        begun.set()
        gate.wait(5)
        told.append(f"cancelled {cancelled()}")
        yield
        told.append("never")

    worker.draw(None, slow)
    assert begun.wait(5)
    worker.do(lambda: told.append("command"))
    gate.set()
    assert worker.wait()
    assert told == ["first", "cancelled True", "command"]


def test_a_newer_drawing_keeps_the_quick_one_that_nobody_did(
    worker: Worker, told: list[str]
) -> None:
    gate = threading.Event()
    worker.do(lambda: gate.wait(5) and None)
    worker.draw(lambda: told.append("quick"), None)
    worker.draw(None, None)
    gate.set()
    assert worker.wait()
    assert told == ["quick"]


def test_commands_come_between_the_steps_of_a_job(worker: Worker, told: list[str]) -> None:
    def job() -> Iterator[None]:
        for number in range(3):
            worker.do(lambda number=number: told.append(f"command {number}"))
            told.append(f"step {number}")
            yield

    worker.go_on(job())
    assert worker.wait()
    assert told == [f"{what} {number}" for number in range(3) for what in ("step", "command")]


def test_a_job_that_fails_is_over_and_one_that_waits_is_closed(told: list[str]) -> None:
    worker = Worker(lambda error: told.append(f"failed: {error}"), rest=0.02)

    def failing() -> Iterator[None]:
        yield
        raise ValueError("no frame")

    begun = threading.Event()

    def endless() -> Iterator[None]:
        try:
            while True:
                begun.set()
                yield
        finally:
            told.append("closed")

    worker.start()
    worker.go_on(failing())
    assert worker.wait()
    worker.go_on(endless())
    assert begun.wait(5)
    worker.stop()
    assert told == ["failed: no frame", "closed"]


def test_what_fails_ends_nothing(worker: Worker, told: list[str]) -> None:
    def fail(_: Callable[[], bool]) -> Iterator[None]:
        raise ValueError("no picture")
        yield

    worker.draw(lambda: 1 / 0, fail)
    assert worker.wait()
    worker.do(lambda: told.append("still here"))
    assert worker.wait()
    assert told == ["failed: division by zero", "failed: no picture", "still here"]
