"""What is read of a repository, once for all checks."""

from functools import cached_property

from calibration.analysis.ros.known import PACKAGES
from calibration.analysis.ros.package import Package, find_packages
from calibration.analysis.ros.tree import Tree


class Repository:
    """Packages of a repository, and what their files say."""

    def __init__(self, tree: Tree) -> None:
        """Take the tracked files."""
        self.tree = tree

    @cached_property
    def packages(self) -> list[Package]:
        """All packages, by folder."""
        return find_packages(self.tree)

    @cached_property
    def by_name(self) -> dict[str, Package]:
        """The packages by name; the first of two of one name."""
        return {each.name: each for each in reversed(self.packages) if each.name}

    @cached_property
    def known(self) -> frozenset[str]:
        """Names of packages: those of the repository, and common ones."""
        return PACKAGES | frozenset(self.by_name)
