"""The section ``aws-batch`` in a file: calibration.yml, or one that has nothing else."""

from pathlib import Path

from calibration.errors import InputError
from calibration.execution.batch.settings import SECTION, BatchSettings, settings_from
from calibration.variables import with_variables
from calibration.yaml_file import read_yaml


def read_section(path: Path) -> BatchSettings:
    """Read where in AWS jobs run; ``${NAME}`` in it is replaced by the environment variable.

    Raises:
        InputError: the file or the section is missing, or it is wrong; names file and key.
    """
    document = read_yaml(path, f"a file with a section {SECTION}")
    if not isinstance(document, dict) or SECTION not in document:
        raise InputError(f"{path}: missing {SECTION}: region, queue, bucket, tools-image and job-role")
    where = f"{path}: {SECTION}"
    return settings_from(with_variables(document[SECTION], where), where)
