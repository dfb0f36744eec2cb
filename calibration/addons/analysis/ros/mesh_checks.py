"""Checks of the meshes of robot descriptions: implausible sizes, which suggest a wrong unit."""

import math
import re
import struct
from collections.abc import Iterator

from calibration.addons.analysis.finding import CodeFinding
from calibration.addons.analysis.ros.faults import fault, quoted
from calibration.addons.analysis.ros.repository import RosRepository
from calibration.addons.analysis.ros.tree import join
from calibration.addons.analysis.xml_lines import line_of, parse_xml

MAX_MESH_SIZE = 30.0
"""m: links of robots are smaller, and those in millimetres that are read as metres are larger."""
_VERTEX_LINE = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)")
_HEADER_BYTES, _TRIANGLE_BYTES = 84, 50
"""Bytes of a binary STL before its triangles, and of each."""
_MAX_TRIANGLES = 200_000


def check_meshes(repository: RosRepository) -> Iterator[CodeFinding]:
    """Check the meshes in STL that URDF files name."""
    sizes: dict[str, float | None] = {}
    for path in repository.tree.files:
        root = parse_xml(repository.tree.data(path)) if path.endswith(".urdf") else None
        for mesh in root.iter("mesh") if root is not None else ():
            name = mesh.get("filename", "")
            place = repository.place(name) or join(path.rpartition("/")[0], name.removeprefix("file://"))
            if place is None or not place.lower().endswith(".stl") or place not in repository.tree.present:
                continue
            if place not in sizes:
                sizes[place] = stl_size(repository.tree.data(place))
            size, scale = sizes[place], _largest_factor(mesh.get("scale", "1 1 1"))
            if size is not None and scale is not None and size * scale > MAX_MESH_SIZE:
                message = f"the mesh {quoted(place)} is {size * scale:.3g} m long here, as if its unit were not metres"
                yield fault("mesh-size", path, line_of(mesh), message)


def stl_size(data: bytes) -> float | None:
    """Return the longest side of a mesh's bounding box, in its own unit; None if there is none."""
    points: list[tuple[float, float, float]] = []
    try:
        if (
            len(data) >= _HEADER_BYTES
            and len(data) == _HEADER_BYTES + _TRIANGLE_BYTES * struct.unpack_from("<I", data, 80)[0]
        ):
            end = _HEADER_BYTES + _TRIANGLE_BYTES * _MAX_TRIANGLES
            for numbers in struct.iter_unpack("<12fH", data[_HEADER_BYTES:end]):
                points += [numbers[3:6], numbers[6:9], numbers[9:12]]
        else:
            matches = _VERTEX_LINE.finditer(data)
            points = [(float(x), float(y), float(z)) for x, y, z in (match.groups() for match in matches)]
    except (struct.error, ValueError):
        return None
    sides = [max(values) - min(values) for values in zip(*points, strict=True)]
    return max(sides) if sides and all(map(math.isfinite, sides)) else None


def _largest_factor(text: str) -> float | None:
    """Return the largest of three factors; None if they are not three numbers."""
    try:
        factors = [abs(float(each)) for each in text.split()]
    except ValueError:
        return None
    return max(factors) if len(factors) == 3 and all(map(math.isfinite, factors)) else None
