"""Report of missing point clouds and depth images."""

from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.finding import Finding


def missing_files(dataset: Dataset) -> tuple[Finding, ...]:
    """Report the labels that are left out because their files are missing, by sensor."""
    return tuple(
        Finding(
            "missing-files",
            "warning",
            f"{dataset.missing_files_of(sensor)}; "
            + (
                "its labels in these are left out"
                if sensor in dataset.sensors
                else "it is not calibrated, and stays where the robot's description puts it"
            ),
            sensors=(sensor,),
            value=float(len(files)),
        )
        for sensor, files in dataset.missing_files.items()
    )
