"""Registry of the analysers: their files, their programs, and their findings in a common form."""

from calibration.addons.analysis.analysers.analyser import Analyser
from calibration.addons.analysis.analysers.complexity import Lizard
from calibration.addons.analysis.analysers.cpp import Cppcheck
from calibration.addons.analysis.analysers.python import Ruff
from calibration.addons.analysis.analysers.ros import RosChecks
from calibration.addons.analysis.analysers.shell import Shellcheck
from calibration.addons.analysis.analysers.urdf import Urdf
from calibration.addons.analysis.analysers.workflows import Zizmor
from calibration.addons.analysis.analysers.xml_files import XmlFiles
from calibration.addons.analysis.analysers.yaml_files import Yamllint

ANALYSERS: dict[str, Analyser] = {
    each.name: each
    for each in (Ruff(), Cppcheck(), Shellcheck(), Yamllint(), Zizmor(), Lizard(), XmlFiles(), Urdf(), RosChecks())
}
"""Analysers by name; a new one is a module and an entry here."""

__all__ = ["ANALYSERS", "Analyser"]
