"""Settings of AWS Batch: the section ``aws-batch`` of calibration.yml, or of a separate file."""

from collections.abc import Mapping
from typing import Annotated, Literal

from calibration.base.records import Misfit, above, at_least, between, field, length, matching, needs, record
from calibration.ci.execution.job import Bytes, Seconds

Platform = Literal["fargate", "ec2"]
"""fargate: each task has its own network and machine. ec2: instances of the compute environment, for GPUs,
privileges and shared memory; tasks share the instance's network, so their ports may conflict."""
Architecture = Literal["x86_64", "arm64"]

AWS_BATCH = "aws-batch"
"""Name of the backend, and of its section of calibration.yml."""
_QUEUE_NAME = "[A-Za-z0-9][A-Za-z0-9_-]{0,127}"
_FOLDER_NAME = "[A-Za-z0-9_][A-Za-z0-9_.=-]*"
Region = Annotated[str, matching("[a-z]{2}(-[a-z]+)+-[0-9]", "the name of a region such as eu-west-1")]
Queue = Annotated[
    str,
    matching(
        f"{_QUEUE_NAME}|arn:aws[a-z-]*:batch:[a-z0-9-]+:[0-9]{{12}}:job-queue/{_QUEUE_NAME}",
        "the name or the ARN of a job queue",
    ),
]
Bucket = Annotated[
    str,
    matching(
        "[a-z0-9][a-z0-9.-]{1,61}[a-z0-9]",
        "the name of an S3 bucket, without s3:// and folders (these are the prefix)",
    ),
]
Prefix = Annotated[
    str,
    length(most=200),
    matching(
        f"{_FOLDER_NAME}(/{_FOLDER_NAME})*",
        "folders such as team/calibration: no / at its ends, no part that begins with a dot",
    ),
]
Image = Annotated[str, matching("[A-Za-z0-9][A-Za-z0-9_.:/@-]{0,254}", "the name of an image")]
Role = Annotated[
    str,
    matching(
        "arn:aws[a-z-]*:iam::[0-9]{12}:role/[A-Za-z0-9_+=,.@/-]+",
        "the ARN of a role: arn:aws:iam::ACCOUNT:role/NAME",
    ),
]
SecretArn = Annotated[
    str,
    matching(
        "arn:aws[a-z-]*:(secretsmanager|ssm):[a-z0-9-]+:[0-9]{12}:[!-~]+",
        "the ARN of a secret or parameter: arn:aws:secretsmanager:REGION:ACCOUNT:secret:NAME",
        secret=True,
    ),
]
Variable = Annotated[str, matching("[A-Za-z_][A-Za-z0-9_]*", "the name of a variable")]
TagKey = Annotated[
    str,
    matching(
        r"(?!aws:|AWS:|ci\.calibration\.)[A-Za-z0-9 _.:/=+@-]{1,128}",
        "letters, digits and _ . : / = + - @, and not aws: or ci.calibration. at its start",
    ),
]
TagValue = Annotated[
    str, matching("[A-Za-z0-9 _.:/=+@-]{0,256}", "letters, digits and _ . : / = + - @, at most 256 of them")
]


@record
class Prices:
    """Prices per hour in your region, for the estimate; without them only hours are reported."""

    vcpu_hour: Annotated[float, at_least(0)] = field("Price of one vCPU-hour.")
    gb_hour: Annotated[float, at_least(0)] = field("Price of one GB-hour of memory.")
    currency: Annotated[str, matching("[A-Z]{3}", "three capital letters such as EUR")] = field(
        "Currency of the prices.", default="USD"
    )


@record(rules=(needs("priority", "share", "priority orders the jobs of a share: set share too"),))
class BatchSettings:
    """Settings of AWS Batch: queue, and the environment of a job's containers."""

    region: Region = field("Region of the queue: eu-west-1.")
    queue: Queue = field("Name or ARN of a job queue; its compute environment determines whether hosts are Spot.")
    bucket: Bucket = field("The S3 bucket for inputs and results.")
    tools_image: Image = field(
        "Image with Python and calibration-ci[aws] (examples/aws-batch), which prepares a task and uploads its results."
    )
    job_role: Role = field("ARN of the containers' role: calibration aws-policy --for job prints its permissions.")
    execution_role: Role | None = field(
        "The ARN of the role that pulls images, writes logs and reads secrets; Fargate needs one.", default=None
    )
    prefix: Prefix = field("Prefix of all keys in the bucket.", default="calibration")
    platform: Platform = field(
        "fargate: each task has its own network and machine. ec2: instances of the compute environment, for "
        "GPUs and devices; tasks share the instance's network.",
        default="fargate",
    )
    architecture: Architecture = field("Architecture of the images.", default="x86_64")
    spot: bool = field("Require that the queue's hosts are Spot.", default=False)
    attempts: Annotated[int, between(1, 10)] = field(
        "Limit of attempts after losses of hosts; failures of the software are never retried.", default=3
    )
    cpus: Annotated[float, above(0, 192)] = field("Default vCPUs of a container.", default=1.0)
    memory: Bytes = field("Default memory of a container, such as 2g.", default=2 * 1024**3)
    disk: Annotated[int, between(21, 200)] | None = field("Disk of a task on Fargate, GiB (20).", default=None)
    public_ip: bool = field(
        "Whether a task on Fargate has a public address, required to pull images in a subnet without NAT.",
        default=False,
    )
    shared_hosts: bool = field(
        "Whether an instance of platform ec2 may hold more than one job at once; then jobs whose ports clash are "
        "refused.",
        default=True,
    )
    deadline: Seconds | None = field("Time limit of a whole run: 6h; by default only those of the jobs.", default=None)
    stuck: Seconds = field("Time without a host (RUNNABLE) after which jobs are given up, such as 30m.", default=1800.0)
    secrets: Mapping[Variable, SecretArn] = field(
        "ARNs (Secrets Manager, Parameter Store) of secret variables, whose values only AWS reads.",
        default_factory=dict,
    )
    tags: Annotated[Mapping[TagKey, TagValue], length(most=30)] = field(
        "Tags of the job definitions and jobs.", default_factory=dict
    )
    priority: Annotated[int, between(0, 9999)] | None = field("Priority among the jobs of the share.", default=None)
    share: Annotated[str, matching("[A-Za-z0-9]{1,255}", "letters and digits")] | None = field(
        "Share identifier, for a queue with a scheduling policy.", default=None
    )
    log_group: Annotated[str, matching("[A-Za-z0-9_/.#-]{1,512}", "the name of a log group")] = field(
        "Log group in CloudWatch.", default="/aws/batch/job"
    )
    prices: Prices | None = field("Prices per hour in your region, for the estimate.", default=None)

    @property
    def where(self) -> str:
        """Queue, for messages."""
        return f"AWS Batch, queue {self.queue}"

    def __post_init__(self) -> None:
        """Refuse inconsistent values."""
        fargate = self.platform == "fargate"
        if fargate and not self.shared_hosts:
            raise Misfit(_NOT_THERE.format("fargate", "ec2"), "shared-hosts")
        for key, given in (("disk", self.disk is not None), ("public-ip", self.public_ip)):
            if given and not fargate:
                raise Misfit(_NOT_THERE.format("ec2", "fargate"), key)
        if self.execution_role is None and (fargate or self.secrets):
            what = "fargate pulls images and writes logs" if fargate else "secrets are read"
            raise Misfit(f"it is missing: {what} with this role", "execution-role")
        if self.queue.startswith("arn:") and (found := self.queue.split(":")[3]) != self.region:
            raise Misfit(f"it is in {found}, but region is {self.region}", "queue")
        accounts = {arn.split(":")[4] for arn in (self.job_role, self.execution_role) if arn is not None}
        if len(accounts) > 1:
            raise Misfit(f"it is of another account than job-role: {', '.join(sorted(accounts))}", "execution-role")


_NOT_THERE = "platform {} does not support it: remove it, or set {}"


@record(unknown="ignore")
class BatchFile:
    """File with the section aws-batch: a separate one, or calibration.yml."""

    aws_batch: BatchSettings = field()
