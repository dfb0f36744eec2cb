"""What each call of AWS Batch does and answers."""

import json
import re
from collections.abc import Callable, Iterable
from typing import Any

from . import definitions
from .definitions import NAME
from .jobs import STATES, Definition, Job, Jobs, Queue
from .scheduler import Scheduler

Record = dict[str, Any]


class ClientError(Exception):
    """The caller asked for something that does not go: ClientException, 400."""


class Calls:
    """One method per operation, by its name."""

    def __init__(self, jobs: Jobs, scheduler: Scheduler) -> None:
        self._jobs, self._scheduler = jobs, scheduler
        self.unseen = 0
        """How many times DescribeJobs does not know a job that was just submitted."""

    def find(self, operation: str) -> Callable[[Record], Record] | None:
        """Return what answers an operation, or None where the emulator does not know it."""
        method: Callable[[Record], Record] | None = getattr(self, "do_" + operation, None)
        return method

    # job definitions

    def do_RegisterJobDefinition(self, request: Record) -> Record:
        refuse(definitions.problems(request))
        name = request["jobDefinitionName"]
        with self._jobs.lock:
            revisions = self._jobs.definitions.setdefault(name, [])
            number = len(revisions) + 1
            arn = self._jobs.arn("job-definition", f"{name}:{number}")
            revisions.append(Definition(arn, name, number, request, dict(request.get("tags", {}))))
        return {"jobDefinitionName": name, "jobDefinitionArn": arn, "revision": number}

    def do_DeregisterJobDefinition(self, request: Record) -> Record:
        found = self._jobs.definition(request["jobDefinition"])
        if found is None or not re.search(r":\d+$", request["jobDefinition"]):
            raise ClientError(f"{request['jobDefinition']} is no job definition with a revision")
        found.active = False
        return {}

    def do_DescribeJobDefinitions(self, request: Record) -> Record:
        if "jobDefinitions" in request:
            if len(request) > 1 or len(request["jobDefinitions"]) > 100:
                raise ClientError("jobDefinitions: at most 100, and no other parameter with it")
            found = [self._jobs.definition(name) for name in request["jobDefinitions"]]
            return {"jobDefinitions": [describe_definition(each) for each in found if each is not None]}
        known = [each for revisions in self._jobs.definitions.values() for each in revisions]
        if "jobDefinitionName" in request:
            known = [each for each in known if each.name == request["jobDefinitionName"]]
        if "status" in request:
            known = [each for each in known if each.active == (request["status"] == "ACTIVE")]
        known.sort(key=lambda each: each.arn)  # no order is promised: 10 comes before 2
        page, token = paged(known, request, 100)
        return {"jobDefinitions": [describe_definition(each) for each in page], **token}

    # queues and hosts

    def do_DescribeJobQueues(self, request: Record) -> Record:
        queues = list(self._jobs.queues.values())
        if "jobQueues" in request:
            found = (self._jobs.queue(name) for name in request["jobQueues"])
            queues = [queue for queue in found if queue is not None]
        page, token = paged(queues, request, 100)
        return {"jobQueues": [describe_queue(each, self._jobs) for each in page], **token}

    def do_DescribeComputeEnvironments(self, request: Record) -> Record:
        queues = list(self._jobs.queues.values())
        if "computeEnvironments" in request:
            names = {name.rpartition("/")[2] for name in request["computeEnvironments"]}
            queues = [queue for queue in queues if queue.environment in names]
        page, token = paged(queues, request, 100)
        return {"computeEnvironments": [describe_environment(each, self._jobs) for each in page], **token}

    # jobs

    def do_SubmitJob(self, request: Record) -> Record:
        for unknown in ("dependsOn", "parameters", "containerOverrides", "nodeOverrides", "eksPropertiesOverride"):
            if request.get(unknown):
                raise ClientError(f"the emulator does not know {unknown}")
        queue, definition = self._jobs.queue(request["jobQueue"]), self._jobs.definition(request["jobDefinition"])
        if queue is None:
            raise ClientError(f"JobQueue {request['jobQueue']} not found")
        if queue.state != "ENABLED":
            raise ClientError(f"JobQueue {queue.arn} is not enabled")
        if definition is None or not definition.active:
            raise ClientError(f"JobDefinition {request['jobDefinition']} not found or not active")
        size = request.get("arrayProperties", {}).get("size")
        overrides = _overrides(request, definition)
        refuse(_submission_problems(request, size, queue, definition))
        timeout = request.get("timeout", definition.request.get("timeout", {}))
        job_id = self._jobs.new_id()
        job = Job(
            id=job_id,
            name=request["jobName"],
            queue=queue,
            definition=definition,
            arn=self._jobs.arn("job", job_id),
            overrides=overrides,
            retry=request.get("retryStrategy", definition.request.get("retryStrategy", {"attempts": 1})),
            timeout=timeout.get("attemptDurationSeconds"),
            tags=dict(request.get("tags", {})),
            request=request,
            unseen=self.unseen,
        )
        self._jobs.add(job, size)
        self._scheduler.add(job)
        return {"jobArn": job.arn, "jobName": job.name, "jobId": job.id}

    def do_DescribeJobs(self, request: Record) -> Record:
        if not 1 <= len(request["jobs"]) <= 100:
            raise ClientError(f"jobs: {len(request['jobs'])} ids, 1 to 100")
        found = []
        with self._jobs.lock:
            for job_id in request["jobs"]:
                job = self._jobs.find(job_id.rpartition("/")[2])
                if job is not None and job.unseen == 0:
                    found.append(describe_job(job))
                elif job is not None:
                    job.unseen -= 1
        return {"jobs": found}

    def do_ListJobs(self, request: Record) -> Record:
        if sum(key in request for key in ("jobQueue", "arrayJobId", "multiNodeJobId")) != 1:
            raise ClientError("exactly one of jobQueue, arrayJobId, multiNodeJobId")
        if "multiNodeJobId" in request:
            raise ClientError("the emulator does not know multiNodeJobId")
        with self._jobs.lock:
            if "arrayJobId" in request:
                array = self._jobs.find(request["arrayJobId"])
                if array is None:
                    raise ClientError(f"Job {request['arrayJobId']} not found")
                jobs: Iterable[Job] = array.children
            else:
                queue = self._jobs.queue(request["jobQueue"])
                if queue is None:
                    raise ClientError(f"JobQueue {request['jobQueue']} not found")
                jobs = (job for job in self._jobs.jobs.values() if job.queue is queue)
            filters = request.get("filters", [])
            if filters and "arrayJobId" not in request:
                chosen = sorted((job for job in jobs if _filtered(job, filters)), key=lambda job: -job.created)
            else:
                chosen = [job for job in jobs if job.status == request.get("jobStatus", "RUNNING")]
            page, token = paged(chosen, request, 100 if filters else 1000)
            return {"jobSummaryList": [summarise(job) for job in page], **token}

    def do_TerminateJob(self, request: Record) -> Record:
        job = self._jobs.find(request["jobId"])
        if len(request["reason"]) > 1024:
            raise ClientError("reason: at most 1024 characters")
        if job is not None:
            self._scheduler.terminate(job, request["reason"])
        return {}

    def do_CancelJob(self, request: Record) -> Record:
        job = self._jobs.find(request["jobId"])
        if job is not None:
            self._scheduler.cancel(job, request["reason"])
        return {}

    # tags

    def do_TagResource(self, request: Record) -> Record:
        tags = self._tags(request["resourceArn"])
        if len(tags | request["tags"]) > 50:
            raise ClientError("more than 50 tags")
        tags.update(request["tags"])
        return {}

    def do_UntagResource(self, request: Record) -> Record:
        tags = self._tags(request["resourceArn"])
        for key in request["tagKeys"]:
            tags.pop(key, None)
        return {}

    def do_ListTagsForResource(self, request: Record) -> Record:
        return {"tags": self._tags(request["resourceArn"])}

    def _tags(self, arn: str) -> dict[str, str]:
        kind, _, name = arn.removeprefix(self._jobs.arn("", "").removesuffix("/")).partition("/")
        find: dict[str, Callable[[str], Job | Definition | Queue | None]] = {
            "job": self._jobs.find,
            "job-definition": self._jobs.definition,
            "job-queue": self._jobs.queue,
        }
        found = find[kind](name) if kind in find else None
        if found is None:
            raise ClientError(f"{arn} not found")
        tags: dict[str, str] = found.tags
        return tags


def refuse(problems: Iterable[str]) -> None:
    """Raise the problems, where there are any."""
    lines = list(problems)
    if lines:
        raise ClientError("Error executing request, Exception : " + "; ".join(lines))


def paged(found: list[Any], request: Record, most: int) -> tuple[list[Any], Record]:
    """Return the page that is asked for, and the token of the next."""
    token, size = request.get("nextToken", "page-0"), request.get("maxResults", most)
    if not re.fullmatch(r"page-\d+", token) or size < 1:
        raise ClientError("nextToken or maxResults is invalid")
    start, size = int(token.removeprefix("page-")), min(size, most)
    following = start + size
    return found[start:following], {"nextToken": f"page-{following}"} if following < len(found) else {}


def _submission_problems(request: Record, size: int | None, queue: Queue, definition: Definition) -> list[str]:
    found = []
    if not NAME.fullmatch(request["jobName"]):
        found.append(f"jobName {request['jobName']!r}")
    if "arrayProperties" in request and not 2 <= (size or 0) <= 10_000:
        found.append(f"arrayProperties.size: {size}, 2 to 10000")
    platform = definition.request.get("platformCapabilities", ["EC2"])[0]
    if (platform == "FARGATE") != queue.kind.startswith("FARGATE"):
        found.append(f"the definition is for {platform}, the queue's hosts are {queue.kind}")
    if ("shareIdentifier" in request) != (queue.scheduling_policy is not None):
        found.append("shareIdentifier: exactly for a queue with a scheduling policy")
    found += definitions.retry_problems(request.get("retryStrategy", {}))
    found += definitions.timeout_problems(request.get("timeout", {}))
    if len(request.get("tags", {}) | definition.tags) > 50 and request.get("propagateTags"):
        found.append("more than 50 tags")
    if len(json.dumps(request)) > 30 * 1024:
        found.append("the request is larger than 30 KiB")
    return found


def _overrides(request: Record, definition: Definition) -> dict[str, Record]:
    tasks = request.get("ecsPropertiesOverride", {}).get("taskProperties", [])
    if len(tasks) > 1:
        raise ClientError("ecsPropertiesOverride.taskProperties: at most one task")
    names = {container["name"] for container in definition.task["containers"]}
    found = {}
    for override in (tasks or [{}])[0].get("containers", []):
        name = override.get("name")
        if name not in names or name in found:
            raise ClientError(f"ecsPropertiesOverride: container {name!r} is not in the job definition, or twice here")
        variables = [each.get("name", "") for each in override.get("environment", [])]
        if any(variable.startswith("AWS_BATCH") for variable in variables):
            raise ClientError("ecsPropertiesOverride: variables that start with AWS_BATCH are Batch's own")
        found[name] = override
    return found


def _filtered(job: Job, filters: list[Record]) -> bool:
    if len(filters) != 1:
        raise ClientError("filters: one at a time")
    name, values = filters[0].get("name"), filters[0].get("values", [])
    if name == "JOB_NAME":
        return any(_matches(value.lower(), job.name.lower()) for value in values)
    if name == "JOB_DEFINITION":
        return any(_matches(value, job.definition.name) or value == job.definition.arn for value in values)
    if name == "BEFORE_CREATED_AT":
        return job.created < int(values[0])
    if name == "AFTER_CREATED_AT":
        return job.created > int(values[0])
    raise ClientError(f"filters: {name!r}")


def _matches(pattern: str, text: str) -> bool:
    return text.startswith(pattern[:-1]) if pattern.endswith("*") else text == pattern


def describe_definition(definition: Definition) -> Record:
    """Return a definition as DescribeJobDefinitions tells it."""
    return {
        **definition.request,
        "jobDefinitionArn": definition.arn,
        "revision": definition.revision,
        "status": "ACTIVE" if definition.active else "INACTIVE",
        "containerOrchestrationType": "ECS",
        "tags": definition.tags,
        "parameters": {},
    }


def describe_queue(queue: Queue, jobs: Jobs) -> Record:
    """Return a queue as DescribeJobQueues tells it."""
    described: Record = {
        "jobQueueName": queue.name,
        "jobQueueArn": queue.arn,
        "state": queue.state,
        "status": queue.status,
        "statusReason": "JobQueue Healthy",
        "priority": 1,
        "computeEnvironmentOrder": [
            {"order": 1, "computeEnvironment": jobs.arn("compute-environment", queue.environment)}
        ],
        "jobQueueType": "ECS_FARGATE" if queue.kind.startswith("FARGATE") else "ECS",
        "tags": queue.tags,
    }
    if queue.scheduling_policy is not None:
        described["schedulingPolicyArn"] = queue.scheduling_policy
    return described


def describe_environment(queue: Queue, jobs: Jobs) -> Record:
    """Return a queue's compute environment as DescribeComputeEnvironments tells it."""
    return {
        "computeEnvironmentName": queue.environment,
        "computeEnvironmentArn": jobs.arn("compute-environment", queue.environment),
        "type": "MANAGED",
        "state": queue.environment_state,
        "status": queue.environment_status,
        "statusReason": "ComputeEnvironment Healthy",
        "computeResources": {
            "type": queue.kind,
            "maxvCpus": queue.max_cpus,
            "subnets": ["subnet-1"],
            "securityGroupIds": ["sg-1"],
        },
        "containerOrchestrationType": "ECS",
        "tags": {},
    }


def describe_job(job: Job) -> Record:
    """Return a job as DescribeJobs tells it."""
    described = {
        "jobArn": job.arn,
        "jobName": job.name,
        "jobId": job.id,
        "jobQueue": job.queue.arn,
        "status": job.status,
        "attempts": list(job.attempts),
        "statusReason": job.reason,
        "createdAt": job.created,
        "startedAt": job.started,
        "stoppedAt": job.stopped,
        "retryStrategy": job.retry or None,
        "dependsOn": [],
        "jobDefinition": job.definition.arn,
        "parameters": {},
        "container": {},
        "arrayProperties": _array(job),
        "timeout": None if job.timeout is None else {"attemptDurationSeconds": job.timeout},
        "tags": dict(job.tags),
        "propagateTags": job.request.get("propagateTags"),
        "platformCapabilities": job.definition.request.get("platformCapabilities", ["EC2"]),
        "eksAttempts": [],
        "ecsProperties": {"taskProperties": [_task(job)]},
        "isCancelled": job.cancelled,
        "isTerminated": job.terminated is not None,
    }
    return {key: value for key, value in described.items() if value is not None}


def _array(job: Job) -> Record | None:
    if job.children:
        counted = {} if job.counted is None else {"statusSummaryLastUpdatedAt": job.counted}
        return {"size": len(job.children), "statusSummary": {state: job.counts[state] for state in STATES}, **counted}
    return None if job.index is None else {"index": job.index, "statusSummary": {}}


def _task(job: Job) -> Record:
    """The definition's task with what its containers told; overrides are there, as Batch shows them."""
    task = dict(job.definition.task)
    containers = []
    for container in task["containers"]:
        override = {key: value for key, value in job.overrides.get(container["name"], {}).items() if key != "name"}
        told = job.containers.get(container["name"], {})
        containers.append({"networkInterfaces": [], **container, **override, **told})
    task["containers"] = containers
    return task | ({} if job.task_arn is None else {"taskArn": job.task_arn})


def summarise(job: Job) -> Record:
    """Return a job as ListJobs tells it."""
    described = {
        "jobArn": job.arn,
        "jobId": job.id,
        "jobName": job.name,
        "createdAt": job.created,
        "startedAt": job.started,
        "stoppedAt": job.stopped,
        "status": job.status,
        "statusReason": job.reason,
        "container": {},
        "jobDefinition": job.definition.arn,
        "arrayProperties": _array(job),
    }
    if described["arrayProperties"] and job.children:
        described["arrayProperties"] = {"size": len(job.children)}
    elif described["arrayProperties"]:
        described["arrayProperties"] = {"index": job.index}
    return {key: value for key, value in described.items() if value is not None}
