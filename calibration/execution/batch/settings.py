"""Settings of AWS Batch: the section ``aws-batch`` of calibration.yml, or of a separate file."""

from collections.abc import Mapping
from typing import Annotated, Literal

from calibration.execution.sizes import Bytes, Seconds
from calibration.records import Misfit, above, at_least, between, field, length, matching, needs, record

Platform = Literal["fargate", "ec2"]
"""fargate: each task has its own network and machine. ec2: instances of the compute environment, for GPUs,
privileges and shared memory; tasks share the instance's network, so their ports may conflict."""
Architecture = Literal["x86_64", "arm64"]

_QUEUE = "[A-Za-z0-9][A-Za-z0-9_-]{0,127}"
_FOLDER = "[A-Za-z0-9_][A-Za-z0-9_.=-]*"
Region = Annotated[str, matching("[a-z]{2}(-[a-z]+)+-[0-9]", "the name of a region such as eu-west-1")]
Queue = Annotated[
    str,
    matching(
        f"{_QUEUE}|arn:aws[a-z-]*:batch:[a-z0-9-]+:[0-9]{{12}}:job-queue/{_QUEUE}", "the name or the ARN of a job queue"
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
        f"{_FOLDER}(/{_FOLDER})*",
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

    vcpu_hour: Annotated[float, at_least(0)] = field("Of one CPU.")
    gb_hour: Annotated[float, at_least(0)] = field("Of one GB of memory.")
    currency: Annotated[str, matching("[A-Z]{3}", "three capital letters such as EUR")] = field(
        "Of both.", default="USD"
    )


@record(rules=(needs("priority", "share", "priority orders the jobs of a share: say share too"),))
class BatchSettings:
    """Settings of AWS Batch: queue, and the environment of a job's containers."""

    region: Region = field("Of the queue: eu-west-1.")
    queue: Queue = field(
        "The name or ARN of a job queue; whether its hosts are Spot is its compute environment's doing."
    )
    bucket: Bucket = field("The S3 bucket for inputs and results.")
    tools_image: Image = field(
        "An image with Python and calibration-ci[aws] (examples/aws-batch): it prepares a task and brings its results "
        "out."
    )
    job_role: Role = field("The ARN of the containers' role: calibration aws-policy --for job prints what it needs.")
    execution_role: Role | None = field(
        "The ARN of the role that pulls images, writes logs and reads secrets; Fargate needs one.", default=None
    )
    prefix: Prefix = field("Of all keys in the bucket.", default="calibration")
    platform: Platform = field(
        "fargate: each task has a network and a machine of its own. ec2: instances of the compute environment, for "
        "GPUs and devices; tasks share the instance's network.",
        default="fargate",
    )
    architecture: Architecture = field("Of the images.", default="x86_64")
    spot: bool = field("Whether the queue is expected to give Spot hosts; refused where it does not.", default=False)
    attempts: Annotated[int, between(1, 10)] = field(
        "How often a job is tried when its host was lost; a failure of the software is never tried again.", default=3
    )
    cpus: Annotated[float, above(0, 192)] = field("Of a container that says none.", default=1.0)
    memory: Bytes = field("Of a container that says none, such as 2g.", default=2 * 1024**3)
    disk: Annotated[int, between(21, 200)] | None = field(
        "GiB for a task on Fargate; 20 where none is said.", default=None
    )
    public_ip: bool = field(
        "Whether a task on Fargate has a public address, which a subnet without NAT needs to pull images.",
        default=False,
    )
    shared_hosts: bool = field(
        "Whether an instance of platform ec2 may hold more than one job at once; then jobs whose ports clash are "
        "refused.",
        default=True,
    )
    deadline: Seconds | None = field("For all jobs of a run: 6h; no limit but the jobs' own where none.", default=None)
    stuck: Seconds = field("A job that waits so long for a host (RUNNABLE) is given up, such as 30m.", default=1800.0)
    secrets: Mapping[Variable, SecretArn] = field(
        "ARNs (Secrets Manager, Parameter Store) of the variables that are secret: their values never pass through us.",
        default_factory=dict,
    )
    tags: Annotated[Mapping[TagKey, TagValue], length(most=30)] = field(
        "On the job definitions and jobs.", default_factory=dict
    )
    priority: Annotated[int, between(0, 9999)] | None = field("Among the jobs of the share.", default=None)
    share: Annotated[str, matching("[A-Za-z0-9]{1,255}", "letters and digits")] | None = field(
        "The share identifier, where the queue has a scheduling policy.", default=None
    )
    log_group: Annotated[str, matching("[A-Za-z0-9_/.#-]{1,512}", "the name of a log group")] = field(
        "In CloudWatch.", default="/aws/batch/job"
    )
    prices: Prices | None = field("What an hour costs in your region, for the estimate.", default=None)

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
            raise Misfit(f"it is in {found}, but region says {self.region}", "queue")
        accounts = {arn.split(":")[4] for arn in (self.job_role, self.execution_role) if arn is not None}
        if len(accounts) > 1:
            raise Misfit(f"it is of another account than job-role: {', '.join(sorted(accounts))}", "execution-role")


_NOT_THERE = "platform {} has no such thing: drop it, or say {}"


@record(unknown="ignore")
class BatchFile:
    """File with the section aws-batch: a separate one, or calibration.yml."""

    aws_batch: BatchSettings = field()
