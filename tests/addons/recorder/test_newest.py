import threading
import time

from calibration.addons.recorder.page import Newest

LONG = 60.0  # s: a test that waits so long has failed


def test_what_was_overtaken_is_never_begun() -> None:
    done: list[int] = []
    begun, go_on, last = threading.Event(), threading.Event(), threading.Event()

    def work(item: int) -> None:
        begun.set()
        assert go_on.wait(LONG)
        done.append(item)
        if item == 99:
            last.set()

    newest = Newest(work)
    newest.ask(0)
    assert begun.wait(LONG)
    for item in range(1, 100):
        newest.ask(item)
    go_on.set()
    assert last.wait(LONG)
    newest.close()
    assert done == [0, 99]


def test_spare_work_is_done_while_nobody_asks_and_ends_when_there_is_none() -> None:
    left = ["a", "b", "c"]
    calls: list[int] = []
    empty = threading.Event()

    def spare() -> bool:
        calls.append(len(left))
        if left:
            left.pop()
            return True
        empty.set()
        return False

    newest: Newest[int] = Newest(lambda _: None, spare)
    assert empty.wait(LONG)
    assert not left
    time.sleep(0.05)
    assert calls == [3, 2, 1, 0]  # and no more: it does not spin
    empty.clear()
    left.append("d")
    newest.wake()
    assert empty.wait(LONG)
    assert not left
    newest.close()


def test_a_request_comes_before_spare_work() -> None:
    order: list[str] = []
    in_spare, go_on, asked = threading.Event(), threading.Event(), threading.Event()

    def spare() -> bool:
        order.append("spare")
        in_spare.set()
        assert go_on.wait(LONG)
        return len(order) < 4

    def work(_: int) -> None:
        order.append("work")
        asked.set()

    newest = Newest(work, spare)
    assert in_spare.wait(LONG)
    newest.ask(1)
    go_on.set()
    assert asked.wait(LONG)
    newest.close()
    assert order[:2] == ["spare", "work"]


def test_closing_waits_for_the_work_at_hand_and_drops_what_waits() -> None:
    done: list[int] = []
    begun = threading.Event()

    def work(item: int) -> None:
        begun.set()
        while not newest._closed:
            time.sleep(0.01)
        done.append(item)

    newest = Newest(work)
    newest.ask(1)
    assert begun.wait(LONG)
    newest.ask(2)
    newest.close()
    assert done == [1]
    newest.ask(3)
    assert done == [1]
