"""Cell of the matrix: one system from one noisy initial guess; and a comparison method on the same data."""

from dataclasses import dataclass

from calibration.base.text import number_text
from calibration.engine.estimation.solve.options import Loss, Start
from calibration.engine.estimation.start.starting_noise import StartingNoise

REPROJECTION_FILE = "reprojection.csv"
"""Default table, of a system that names none."""


@dataclass(frozen=True)
class Cell:
    """System and initial guess of a cell."""

    system: str
    noise: StartingNoise
    start: Start = "linear"
    loss: Loss = "huber"

    @property
    def folder(self) -> str:
        """Folder of its files, relative to the output folder."""
        return f"{self.system}/{noise_folder(self.noise)}"

    def __str__(self) -> str:
        n = self.noise
        return f"{self.system}, {noise_text(n.translation, n.rotation)}, seed {n.seed}"


@dataclass(frozen=True)
class Comparison:
    """Comparison method on a system's data."""

    system: str
    method: str
    noise: StartingNoise | None
    """Noise of the initial guess, of a method that uses one; else None."""

    @property
    def folder(self) -> str:
        """Folder of its files, relative to the output folder."""
        folder = f"{self.system}/{self.method}"
        return folder if self.noise is None else f"{folder}/{noise_folder(self.noise)}"


def noise_folder(noise: StartingNoise) -> str:
    """Return the name of the folder for results of an initial guess."""
    return f"translation-{number_text(noise.translation)}_rotation-{number_text(noise.rotation)}_seed-{noise.seed}"


def noise_text(translation: float, rotation: float) -> str:
    """Format a pair of noises with all digits: "0.5 m, 0.1 rad"."""
    return f"{number_text(translation)} m, {number_text(rotation)} rad"
