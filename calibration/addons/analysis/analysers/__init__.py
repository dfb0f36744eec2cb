"""Registry of the analysers: their files, their programs, and their findings in a common form."""

from calibration.addons.analysis.analysers.analyser import Analyser
from calibration.addons.analysis.analysers.code import Cppcheck, Lizard, Ruff, Shellcheck
from calibration.addons.analysis.analysers.documents import Urdf, XmlFiles, Yamllint, Zizmor
from calibration.addons.analysis.analysers.ros import RosChecks

ANALYSERS: dict[str, Analyser] = {
    each.name: each
    for each in (Ruff(), Cppcheck(), Shellcheck(), Yamllint(), Zizmor(), Lizard(), XmlFiles(), Urdf(), RosChecks())
}
"""Analysers by name; a new one is a class and an entry here."""

__all__ = ["ANALYSERS", "Analyser"]
