"""Ends by the thread that waits for signals: of a call of a library, and of a check some seconds after a signal."""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from typing import NoReturn

import pytest

from hpcinv.base.parallel import signals

PATIENCE = 0.2  # s
WAIT = PATIENCE + 0.3


@pytest.fixture
def receive(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[signal.Signals], None]]:
    """Gives a signal to a thread that waits for them, as Python's handler would."""
    monkeypatch.setattr(signals, "PATIENCE", PATIENCE)
    monkeypatch.setattr(signals, "_GRACE", 0.01)
    monkeypatch.setattr(signals, "_end", None)
    monkeypatch.setattr(signals, "_stop_requests", [])
    read_end, write_end = os.pipe()
    os.set_blocking(read_end, False)
    monkeypatch.setattr(signals, "_arrived", read_end)
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


def begin_command(end: Callable[[], NoReturn]) -> None:
    signals.StopRequest().set_end_in_library(end)


def test_a_signal_ends_a_call_of_a_library_of_its_own_command(receive: Callable[[signal.Signals], None]) -> None:
    ended: list[str] = []
    begin_command(lambda: ended.append("own"))  # type: ignore[arg-type, return-value]
    with signals.ended_by_signals():
        receive(signal.SIGTERM)
        time.sleep(WAIT)
    assert ended == ["own"]


@pytest.mark.parametrize("noted", [True, False])
def test_a_signal_does_not_end_a_call_of_a_library_of_the_next_command(
    noted: bool, receive: Callable[[signal.Signals], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is noted before the next command begins, and handled later; or it is noted later."""
    monkeypatch.setattr(signals, "_GRACE", 0.3)
    ended: list[str] = []
    begin_command(lambda: ended.append("first"))  # type: ignore[arg-type, return-value]
    with contextlib.ExitStack() as late:
        if not noted:
            late.enter_context(signals._noting)
        receive(signal.SIGTERM)
        time.sleep(0.1)
        if not noted:
            monkeypatch.setattr(signals, "_noting", contextlib.nullcontext())  # which this thread holds
        begin_command(lambda: ended.append("second"))  # type: ignore[arg-type, return-value]
    with signals.ended_by_signals():
        time.sleep(0.3 + WAIT)
    assert ended == []


@pytest.mark.usefixtures("handlers_of_signals")
def test_a_signal_to_a_command_does_not_end_what_its_program_does_afterwards(
    receive: Callable[[signal.Signals], None],
) -> None:
    """The command ran in the process of a program, which makes a mesh later."""

    def end() -> NoReturn:
        raise RuntimeError("ended")

    stop = signals.StopRequest()
    stop.set_end_in_library(end)
    stop._note(signal.SIGTERM, None)
    with pytest.raises(RuntimeError, match="ended"), signals.ended_by_signals():
        pass
    stop.ignore()
    with signals.ended_by_signals():
        pass
