"""The packages, code and launch files of a repository, each read once for all checks."""

from functools import cached_property

from calibration.addons.analysis.ros.code import ClientCode
from calibration.addons.analysis.ros.cpp_code import read_cpp
from calibration.addons.analysis.ros.executables import Executables, find_executables
from calibration.addons.analysis.ros.known import COMMON_PACKAGES
from calibration.addons.analysis.ros.launch import Include, Launch, package_of
from calibration.addons.analysis.ros.launch_markup import read_launch_xml, read_launch_yaml
from calibration.addons.analysis.ros.launch_python import read_launch_python
from calibration.addons.analysis.ros.package import Package, find_packages
from calibration.addons.analysis.ros.python_code import read_python
from calibration.addons.analysis.ros.tree import Tree, join


class RosRepository:
    """Packages of a repository, with their code, executables and launch files."""

    def __init__(self, tree: Tree) -> None:
        """Create it from the tracked files."""
        self.tree = tree
        self._codes: dict[str, ClientCode] = {}
        self._executables: dict[str, Executables] = {}

    @cached_property
    def packages(self) -> list[Package]:
        """Packages of the repository, by folder."""
        return find_packages(self.tree)

    @cached_property
    def by_name(self) -> dict[str, Package]:
        """The packages by name; the first of two of one name."""
        return {each.name: each for each in reversed(self.packages) if each.name}

    @cached_property
    def known(self) -> frozenset[str]:
        """Names of packages: those of the repository, and common ones."""
        return COMMON_PACKAGES | frozenset(self.by_name)

    @cached_property
    def launches(self) -> dict[str, Launch]:
        """The launch files of the packages, by path."""
        read = (self._read_launch(path) for package in self.packages for path in package.files)
        return {each.path: each for each in read if each is not None}

    def _read_launch(self, path: str) -> Launch | None:
        if path.endswith((".launch", ".launch.xml", ".test")):
            return read_launch_xml(path, self.tree.data(path))
        if path.endswith((".launch.yaml", ".launch.yml")):
            return read_launch_yaml(path, self.tree.text(path))
        return read_launch_python(path, self.tree.text(path)) if path.endswith(".py") else None

    @cached_property
    def image_text(self) -> str:
        """The text of all files that say what images contain."""
        names = ((path, path.rpartition("/")[2]) for path in self.tree.files)
        paths = (path for path, name in names if name.startswith("Dockerfile") or name == "calibration.yml")
        return "\n".join(map(self.tree.text, paths))

    def place(self, text: str | None) -> str | None:
        """Return the path in the repository of ``package://name/path``; None if it is of no package here."""
        if text is not None and text.startswith("repository://"):
            return None if "$" in text else join("", text.removeprefix("repository://"))
        named = package_of(text or "")
        package = self.by_name.get(named[0]) if named else None
        return package.inside(named[1]) if package and named else None

    def included(self, include: Include) -> Launch | None:
        """Return the launch file that another one includes, if it is of this repository."""
        return self.launches.get(self.place(include.file) or "")

    def executables(self, package: Package) -> Executables:
        """Return the executables of a package."""
        if package.folder not in self._executables:
            self._executables[package.folder] = find_executables(package)
        return self._executables[package.folder]

    def code(self, path: str) -> ClientCode:
        """Return the calls in a file of code."""
        if path not in self._codes:
            read = read_python if path.endswith(".py") else read_cpp
            self._codes[path] = read(path, self.tree.text(path))
        return self._codes[path]
