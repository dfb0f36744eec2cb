"""An image with this package and what it needs, made from this environment: no network, where the Pythons agree."""

import hashlib
import io
import sys
import tarfile
import time
from collections.abc import Iterable
from contextlib import suppress
from datetime import datetime
from importlib.metadata import Distribution, distribution
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from docker import DockerClient

REPOSITORY = "calibration-test-tools"
NEEDED = ("numpy", "opencv-python-headless", "boto3", "click", "pyyaml", "defusedxml", "rich")
"""What the package's extras bring; with all that these need."""
CLOUD_DATA = {"batch", "ecr", "logs", "s3", "sts"}
"""Services whose descriptions botocore keeps: all of them are 25 MB."""
FOLDER = "/usr/local/lib/python{}.{}/dist-packages"
PACKAGE = Path(__file__).resolve().parents[3] / "calibration"
COMPILED = "boto3, botocore.session, click, cv2, defusedxml.ElementTree, numpy.random, rich.console, yaml"
"""Modules whose bytecode is kept: every container would compile them anew."""
ENTRY = "#!/usr/bin/python3\nimport sys\nfrom calibration.__main__ import main\nsys.exit(main())\n"
KEPT_SECONDS = 3600


def build_tools_image(engine: "DockerClient", base: str) -> str:
    """Return an image that is `base`, which has Python, with the package and what it needs; its user is root.

    It is made once for each state of the package, on an image that changes with the versions of the others only.
    """
    version = _python_of(engine, base)
    below = _with_libraries(engine, base, version)
    files = sorted(path for path in PACKAGE.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    contents = [f"{path.relative_to(PACKAGE)} {hashlib.sha256(path.read_bytes()).hexdigest()}" for path in files]
    tag = f"{REPOSITORY}:{_hash(below, *contents)}"
    if engine.images.list(tag):
        return tag
    folder = FOLDER.format(*version)
    dockerfile = f"FROM {below}\nCOPY entry /usr/local/bin/calibration\nCOPY calibration {folder}/calibration\n"
    dockerfile += f"RUN python3 -m compileall -q {folder}/calibration\n"
    _build(engine, tag, dockerfile, [(f"calibration/{path.relative_to(PACKAGE)}", path) for path in files])
    _forget_older(engine, tag)
    return tag


def _with_libraries(engine: "DockerClient", base: str, version: tuple[int, int]) -> str:
    """Return the image below, with all that the package needs, in the versions of this environment."""
    same = version == sys.version_info[:2]
    packages = sorted(_with_all_they_need(NEEDED)) if same else NEEDED
    pinned = [f"{name}=={installed_version(name)}" for name in packages]
    tag = f"{REPOSITORY}:libraries-{_hash(str(same), engine.images.get(base).id or '', COMPILED, *pinned)}"
    if engine.images.list(tag):
        return tag
    if same:
        dockerfile = f"FROM {base}\nUSER root\nCOPY packages {FOLDER.format(*version)}\n"
        dockerfile += f"RUN python3 -c 'import {COMPILED}'\n"
        _build(engine, tag, dockerfile, [(f"packages/{name}", path) for name, path in _files_of(packages)])
    else:
        install = (
            "apt-get update -qq && apt-get install -y -qq --no-install-recommends python3-pip && "
            f"python3 -m pip install --quiet --no-cache-dir --break-system-packages {' '.join(pinned)}"
        )
        _build(engine, tag, f"FROM {base}\nUSER root\nRUN {install}\n", [])
    return tag


def _python_of(engine: "DockerClient", image: str) -> tuple[int, int]:
    command = ["python3", "-c", "import sys; print(*sys.version_info[:2])"]
    major, minor = engine.containers.run(image, command, entrypoint=[], network_mode="none", remove=True).split()
    return int(major), int(minor)


def _with_all_they_need(names: tuple[str, ...]) -> set[str]:
    """Return distributions and those that they require, by their names."""
    from packaging.requirements import Requirement

    found: set[str] = set()
    waiting = list(names)
    while waiting:
        name = waiting.pop().lower().replace("_", "-")
        if name in found:
            continue
        found.add(name)
        requirements = map(Requirement, distribution(name).requires or ())
        waiting += [each.name for each in requirements if each.marker is None or each.marker.evaluate({"extra": ""})]
    return found


def _files_of(packages: Iterable[str]) -> list[tuple[str, Path]]:
    """Return the files of distributions, with where they lie in site-packages."""
    return [pair for name in packages for pair in _files_of_one(distribution(name))]


def _files_of_one(package: Distribution) -> list[tuple[str, Path]]:
    found = []
    for file in package.files or ():
        parts = file.parts
        if parts[0] == ".." or "__pycache__" in parts or "tests" in parts or not Path(str(file.locate())).is_file():
            continue
        service = parts[2] if parts[:2] in (("botocore", "data"), ("boto3", "data")) and len(parts) > 3 else ""
        if not service or service in CLOUD_DATA:
            found.append((str(file), Path(str(file.locate()))))
    return found


def _build(engine: "DockerClient", tag: str, dockerfile: str, files: list[tuple[str, Path]]) -> None:
    with io.BytesIO() as context:
        with tarfile.open(fileobj=context, mode="w") as tar:
            for name, content, mode in (("Dockerfile", dockerfile, 0o644), ("entry", ENTRY, 0o755)):
                member = tarfile.TarInfo(name)
                member.size, member.mode = len(content), mode
                tar.addfile(member, io.BytesIO(content.encode()))
            for name, path in files:
                tar.add(path, name, recursive=False, filter=_plain)
        context.seek(0)
        engine.images.build(fileobj=context, custom_context=True, tag=tag, rm=True, forcerm=True)


def _plain(member: tarfile.TarInfo) -> tarfile.TarInfo:
    member.mtime, member.uid, member.gid, member.mode = 0, 0, 0, 0o755
    return member


def _hash(*parts: str) -> str:
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def _forget_older(engine: "DockerClient", tag: str) -> None:
    """Remove the images of states of the package that are no more; what a container uses stays."""
    from docker.errors import APIError

    for image in engine.images.list(REPOSITORY):
        created = datetime.fromisoformat(image.attrs["Created"][:19] + "+00:00").timestamp()
        for name in image.tags:
            if name != tag and ":libraries-" not in name and time.time() - created > KEPT_SECONDS:
                with suppress(APIError):
                    engine.images.remove(name)
