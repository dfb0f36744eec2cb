"""Registry of the analysers: their files, their programs, and their findings in a common form."""

from calibration.addons.analysis.analysers.analyser import Analyser
from calibration.addons.analysis.analysers.own_checks import RosChecks, Urdf, XmlFiles
from calibration.addons.analysis.analysers.programs import Cppcheck, Lizard, Ruff, Shellcheck, Yamllint, Zizmor

ANALYSERS: dict[str, Analyser] = {
    each.name: each
    for each in (Ruff(), Cppcheck(), Shellcheck(), Yamllint(), Zizmor(), Lizard(), XmlFiles(), Urdf(), RosChecks())
}
"""Analysers by name; a new one is a class and an entry here."""

__all__ = ["ANALYSERS", "Analyser"]
