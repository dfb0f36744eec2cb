"""Jobs handed over to Batch, each once: it would run a request twice that is sent twice."""

import time
from collections.abc import Mapping
from typing import Any

from calibration.aws_errors import AwsLostError, aws_errors
from calibration.errors import WorldError
from calibration.execution.batch.service.following import Submitted
from calibration.execution.batch.service.leftovers import find_by_name, terminate
from calibration.execution.batch.service.patience import Patience
from calibration.execution.batch.service.session import Aws

STOPPED = "the run was stopped"
"""The reason that Batch is given."""
_TRIES = 3
_LOOKING = 1.0


class Submitting:
    """Submits, and knows what it has submitted."""

    def __init__(self, aws: Aws, queue: str) -> None:
        self.submitted: list[Submitted] = []
        self._aws = aws
        self._queue = queue
        self._unclear: str = ""
        """The name of a job that may have been submitted: its answer has not come."""

    def submit(self, request: Mapping[str, Any], group: str, first: int) -> Submitted:
        """Submit a job or an array of a name that nothing else has.

        Where an answer is lost, the queue is searched for the name before it is tried again.

        Raises:
            InputError: Batch refuses it, or it is not allowed.
            AwsLostError: AWS does not answer, or throttles for too long.
        """
        self._unclear = name = str(request["jobName"])
        patience = Patience()
        answers_lost = False
        while True:
            try:
                ids = find_by_name(self._aws, self._queue, name) if answers_lost else []
                identifier = ids[0] if ids else self._send(request)
                break
            except AwsLostError as error:
                answers_lost = True
                time.sleep(patience.failed(error))
        count = int(request.get("arrayProperties", {}).get("size", 1))
        self.submitted.append(Submitted(identifier, group, first, count))
        self._unclear = ""
        if answers_lost:
            self._end_doubles(name, identifier)
        return self.submitted[-1]

    def stop(self, ids: list[str], reason: str = STOPPED) -> None:
        """End jobs, and what may have been submitted without our knowing.

        Raises:
            WorldError: something may go on.
            InputError: it is not allowed, or the credentials are expired.
            AwsLostError: AWS does not answer.
        """
        terminate(self._aws, ids, reason)
        for _ in range(_TRIES if self._unclear else 0):
            if found := find_by_name(self._aws, self._queue, self._unclear):
                terminate(self._aws, found, reason)
                break
            time.sleep(_LOOKING)  # the list of jobs is a little behind
        self._unclear = ""

    def _send(self, request: Mapping[str, Any]) -> str:
        with aws_errors(f"queue '{self._queue}'"):
            answer = self._aws.submitting.submit_job(**request)
        if not answer.get("jobId"):
            raise WorldError(f"queue '{self._queue}': AWS Batch answers without the id of the job")
        return str(answer["jobId"])

    def _end_doubles(self, name: str, keep: str) -> None:
        """End what a request whose answer was lost has made after all."""
        doubles = [each for each in find_by_name(self._aws, self._queue, name) if each != keep]
        if doubles:
            terminate(self._aws, doubles, "submitted twice")
