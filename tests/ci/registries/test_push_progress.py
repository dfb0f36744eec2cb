from calibration.ci.registries.push import PushProgress


class Log:
    def __init__(self) -> None:
        self.lines: list[str] = []

    def __call__(self, done: int, total: int, line: str, *, important: bool = False) -> None:
        self.lines.append(f"[{done}/{total}] {line}{' !' if important else ''}")


def told(*events: dict[str, object]) -> list[str]:
    log = Log()
    progress = PushProgress(log)
    for event in events:
        progress.event(event)
    return log.lines


def test_a_step_for_each_layer() -> None:
    assert told(
        {"status": "The push refers to repository [x]"},
        {"id": "a", "status": "Preparing", "progressDetail": {}},
        {"id": "b", "status": "Preparing"},
        {"id": "c", "status": "Waiting"},
        {"id": "a", "status": "Layer already exists"},
        {"id": "b", "status": "Pushing", "progressDetail": {"current": 512, "total": 2_500_000}},
        {"id": "b", "status": "Pushed"},
        {"id": "b", "status": "Pushed"},
        {"id": "c", "status": "Mounted from team/other"},
        {"status": "v1: digest: sha256:12 size: 5"},
    ) == ["[1/3] layer a is there already", "[2/3] layer b pushed (2.5 MB)", "[3/3] layer c is there already"]


def test_progress_of_a_large_layer() -> None:
    events = [
        {"id": "a", "status": "Pushing", "progressDetail": {"current": at * 10**6, "total": 400 * 10**6}}
        for at in (0, 50, 100, 120, 210, 390, 400)
    ]
    assert told(
        *events, {"id": "a", "status": "Retrying in 2 seconds"}, {"id": "a", "status": "Retrying in 1 second"}
    ) == [
        "[0/1] layer a: 100.0 MB of 400.0 MB !",
        "[0/1] layer a: 210.0 MB of 400.0 MB !",
        "[0/1] layer a: 390.0 MB of 400.0 MB !",
        "[0/1] layer a is sent again !",
    ]


def test_unknown_events_are_ignored() -> None:
    pushing = [3, {}, {"current": "1", "total": 2}, {"current": 3, "total": 2}, {"current": 0, "total": 0}]
    assert told(*({"id": "a", "status": "Pushing", "progressDetail": detail} for detail in pushing), {"id": 3}) == []
    assert told({"id": "a\n::error::", "status": "Pushed"}) == ["[1/1] layer a ::error:: pushed"]


def test_without_a_listener() -> None:
    PushProgress(None).event({"id": "a", "status": "Pushed"})
