"""``make aws-example``: scenarios on an EMULATED AWS Batch, on this machine, without an account.

What runs on AWS otherwise, the queue, the tasks with their two containers of ours, the bucket and the logs, is emulated
here (`emulator`, and moto for the other services); containers are real ones of this machine's Docker Engine.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

import docker

from tests.addons.aws_batch.fixtures import BUCKET, QUEUE, REGION, aws_in_containers, bridge_address
from tests.addons.aws_batch.services import Services

PROJECT = Path(__file__).resolve().parents[3]
ROLE = "arn:aws:iam::123456789012:role/robots"


def main(arguments: list[str] | None = None) -> int:
    """Run `calibration collect-data-sim --backend aws-batch` as a client of the emulator; its exit code."""
    parser = argparse.ArgumentParser(prog="make aws-example", description=__doc__)
    parser.add_argument("--image", required=True, help="one with calibration-ci[aws,calibrate,opencv]")
    parser.add_argument("--output", type=Path, default=Path("output/aws-example"))
    parser.add_argument("--scenarios", type=int, default=4)
    parser.add_argument("--system", default="t2rgb")
    asked = parser.parse_args(arguments)
    engine = docker.from_env(timeout=60)
    services = Services(bridge_address(engine))
    try:
        with aws_in_containers(engine, services, asked.image) as aws:
            print(f"EMULATED AWS at {services.endpoint}: nothing leaves this machine, nothing is billed", flush=True)
            asked.output.mkdir(parents=True, exist_ok=True)
            section = asked.output / "aws-batch.yml"
            section.write_text(
                f"aws-batch: {{region: {REGION}, queue: {QUEUE}, bucket: {BUCKET}, tools-image: '{asked.image}', "
                f"job-role: '{ROLE}', execution-role: '{ROLE}'}}\n"
            )
            command = [sys.executable, "-m", "calibration", "collect-data-sim", "--system", asked.system]
            command += ["--scenario-set", str(PROJECT / "datasets/scenarios.yml"), "--scenarios", str(asked.scenarios)]
            command += ["--backend", "aws-batch", "--aws-batch", str(section), "--image", asked.image]
            command += ["--run", "example", "--overwrite", "--output", str(asked.output)]
            others = {name: value for name, value in os.environ.items() if not name.startswith("AWS_")}
            return subprocess.run(command, env=others | aws.variables, cwd=Path.cwd(), check=False).returncode
    finally:
        services.close()


if __name__ == "__main__":
    sys.exit(main())
