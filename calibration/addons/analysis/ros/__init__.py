"""Checks of ROS packages (ROS 1 and ROS 2), read as text: nothing of the repository is run. This page has their rules.

- ``tree``: the tracked files; ``repository``: what is in them, each read once;
- ``package``, ``cmake``, ``uses``: what a package declares, builds, installs and uses;
- ``launch``, ``launch_python``: what launch files start; ``client_code``: what code publishes, serves and sets;
- ``graph``: the nodes and what connects them;
- ``..._checks``: the checks; ``__main__``: all of them, in a process of their own.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from calibration.addons.analysis.results import Category, CodeFinding, Severity
from calibration.base import did_you_mean, one_line, shorten


@dataclass(frozen=True)
class FaultRule:
    """Kind of fault."""

    severity: Severity
    meaning: str
    """Description of the fault, for the documentation."""
    category: Category = "error-prone"


RULES: dict[str, FaultRule] = {
    "package-xml": FaultRule("error", "package.xml lacks what the build tools need"),
    "package-name": FaultRule("error", "the package has another name in CMakeLists.txt or setup.py"),
    "package-twice": FaultRule("error", "two packages have one name"),
    "dependency-twice": FaultRule("note", "a dependency is declared twice", "style"),
    "undeclared-dependency": FaultRule(
        "warning", "code, CMake, interfaces or launch files use a package that package.xml does not name"
    ),
    "unused-dependency": FaultRule(
        "note", "nothing of the package names what it declares to build with", "unused code"
    ),
    "build-type": FaultRule("error", "the files do not fit the build type that package.xml exports"),
    "not-found-in-cmake": FaultRule("error", "CMake links or exports a package that it has not found"),
    "no-such-source": FaultRule("error", "CMake builds or installs a file that does not exist"),
    "no-such-target": FaultRule("error", "CMake installs, links or exports a target that it does not build"),
    "no-such-interface": FaultRule("error", "CMake or code names a message, service or action that is not there"),
    "interface-not-built": FaultRule("warning", "a file of an interface that CMake does not generate"),
    "interface-field": FaultRule("error", "a field's type is no built-in one and no interface of its package"),
    "no-such-entry-point": FaultRule("error", "setup.py names a module or function that does not exist"),
    "no-such-executable": FaultRule("error", "a launch file starts an executable that its package does not have"),
    "no-such-file": FaultRule("error", "a launch file or robot description names a file that does not exist"),
    "not-installed": FaultRule("warning", "a launch file or robot description names a file that is not installed"),
    "launch-argument": FaultRule("error", "an argument of a launch file is not declared, or not given"),
    "launch-cycle": FaultRule("error", "a launch file includes itself"),
    "node-name-twice": FaultRule("error", "two nodes that are started together have one name"),
    "topic-types": FaultRule("error", "a topic, service or action is used with two types"),
    "not-connected": FaultRule(
        "warning", "nothing gives to a topic, service or action, and a similar one has no taker"
    ),
    "quality-of-service": FaultRule("error", "a subscriber asks for more than the publisher offers"),
    "no-such-parameter": FaultRule("warning", "a parameter is set that the code of the node does not know"),
    "unused-remapping": FaultRule("warning", "a name is remapped that the node does not use, but a similar one"),
    "no-such-frame": FaultRule("error", "a calibration names a frame that the robot description does not have"),
    "frame-parent": FaultRule("error", "a calibration names another parent of a frame than the description"),
    "mesh-size": FaultRule("warning", "a mesh of a robot description is too large for metres"),
}
"""Rules by name."""


def fault(rule: str, path: str, line: int, message: str, word: str = "", known: Iterable[str] = ()) -> CodeFinding:
    """Return a finding of a rule; its message ends with the known word that is nearest to a misspelt one."""
    kind = RULES[rule]
    text = shorten(one_line(message + did_you_mean(word, known)), 400)
    return CodeFinding(path, max(line, 1), f"ros/{rule}", kind.category, kind.severity, text)


def quoted(name: str) -> str:
    """Return a name for a message."""
    return repr(shorten(name, 80))
