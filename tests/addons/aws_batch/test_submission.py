from dataclasses import replace
from typing import Any

import pytest

from calibration.addons.aws_batch.settings import BatchSettings
from calibration.addons.aws_batch.submitting import attempt_seconds, chunks, submission
from calibration.addons.aws_batch.wire import Location
from tests.addons.aws_batch.samples import SETTINGS, complaints, job, unknown_keys

LOCATION = Location("team-robots", "team/calibration", "ab12", "c07b5b521ae6")
DEFINITION = "arn:aws:batch:eu-west-1:123456789012:job-definition/calibration-robot-1:7"
RUN = {"ci.calibration.run": "ab12"}


def request(chunk: range, settings: BatchSettings = SETTINGS, **changes: Any) -> dict[str, Any]:
    said = {"location": LOCATION, "seconds": 2400, "tags": RUN, **changes}
    found = submission(chunk, definition=DEFINITION, settings=settings, **said)
    assert complaints("SubmitJob", found) == ""
    assert unknown_keys("SubmitJob", found) == []
    return found


def test_an_array() -> None:
    variables = [
        {"name": "CALIBRATION_LOCATION", "value": "s3://team-robots/team/calibration/ab12/c07b5b521ae6"},
        {"name": "CALIBRATION_FIRST", "value": "10000"},
        {"name": "AWS_REGION", "value": "eu-west-1"},
    ]
    assert request(range(10_000, 10_005)) == {
        "jobName": "calibration-ab12-c07b5b521ae6-10000",
        "jobQueue": "robots",
        "jobDefinition": DEFINITION,
        "arrayProperties": {"size": 5},
        "ecsPropertiesOverride": {
            "taskProperties": [
                {
                    "containers": [
                        {"name": "calibration-prepare", "environment": variables},
                        {"name": "calibration-watch", "environment": variables},
                    ]
                }
            ]
        },
        "timeout": {"attemptDurationSeconds": 2400},
        "propagateTags": True,
        "tags": RUN,
    }


def test_a_single_job_is_no_array() -> None:
    assert "arrayProperties" not in request(range(3, 4))
    assert "timeout" not in request(range(3, 4), seconds=None)


def test_share_priority_and_tags() -> None:
    settings = replace(SETTINGS, share="nightly", priority=7, tags={"team": "robots", "ci.calibration.run": "forged"})
    found = request(range(2), settings)
    assert (found["shareIdentifier"], found["schedulingPriorityOverride"]) == ("nightly", 7)
    assert found["tags"] == {"team": "robots", "ci.calibration.run": "ab12"}  # ours take precedence over the user's


def test_any_name_of_a_run() -> None:
    name = request(range(2), location=replace(LOCATION, run="a run: of/mine" + "x" * 200))["jobName"]
    assert name.startswith("calibration-a-run-of-minexxx")
    assert len(name) == 128


def test_arrays_are_no_longer_than_batch_takes_them() -> None:
    assert chunks(0) == []
    assert chunks(1) == [range(1)]
    assert chunks(10_000) == [range(10_000)]
    assert chunks(10_001) == [range(10_000), range(10_000, 10_001)]
    assert chunks(25_000) == [range(10_000), range(10_000, 20_000), range(20_000, 25_000)]


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [((600.0,), 2400), ((600.2, 3.0), 2401), ((0.5,), 1801), ((600.0, None), None), ((None,), None), ((), None)],
)
def test_batch_waits_longer_than_we_do(seconds: tuple[float | None, ...], expected: int | None) -> None:
    assert attempt_seconds(job(seconds=each) for each in seconds) == expected
