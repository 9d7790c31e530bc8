"""End of a check by the thread that waits for signals: due some seconds after a signal, in the same check only."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator

import pytest

from hpcinv.parallel import signals

PATIENCE = 0.2  # s
WAIT = PATIENCE + 0.3


@pytest.fixture
def receive(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[signal.Signals], None]]:
    """Gives a signal to a thread that waits for them, as Python's handler would."""
    monkeypatch.setattr(signals, "PATIENCE", PATIENCE)
    monkeypatch.setattr(signals, "_GRACE", 0.01)
    monkeypatch.setattr(signals, "_end", None)
    read_end, write_end = os.pipe()
    thread = threading.Thread(target=signals._wait_for_signals, args=(read_end,), daemon=True)
    thread.start()

    def send(number: signal.Signals) -> None:
        os.write(write_end, bytes([number]))

    yield send
    os.close(write_end)
    thread.join(5)
    os.close(read_end)


def test_a_check_is_ended_late_once(receive: Callable[[signal.Signals], None]) -> None:
    ended: list[float] = []
    begun = time.monotonic()
    with signals.ended_late(lambda: ended.append(time.monotonic() - begun)):
        receive(signal.SIGTERM)
        receive(signal.SIGUSR1)
        time.sleep(WAIT + PATIENCE)
    assert len(ended) == 1
    assert ended[0] >= PATIENCE


def test_a_signal_does_not_end_a_later_check(receive: Callable[[signal.Signals], None]) -> None:
    ended: list[str] = []
    with signals.ended_late(lambda: ended.append("first")):
        receive(signal.SIGTERM)
        time.sleep(0.1)
    with signals.ended_late(lambda: ended.append("second")):
        time.sleep(WAIT)
    assert ended == []


def test_a_signal_between_checks_ends_none(receive: Callable[[signal.Signals], None]) -> None:
    ended: list[str] = []
    receive(signal.SIGTERM)
    time.sleep(0.1)
    with signals.ended_late(lambda: ended.append("late")):
        time.sleep(WAIT)
    assert ended == []
