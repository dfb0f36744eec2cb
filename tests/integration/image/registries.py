"""Shared parts of tests of registries: a small image, and a faulty proxy of a real registry."""

import io
import tarfile
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from tests.ci.registries.server import Reply, Request, Server, serve

if TYPE_CHECKING:
    from docker import DockerClient


def fresh_name(address: str) -> str:
    """Return the name of an unused repository."""
    return f"{address}/calibration-test/{uuid.uuid4().hex[:12]}"


@contextmanager
def small_image(engine: "DockerClient", name: str, *tags: str) -> Iterator[str]:
    """Create a unique image with one small layer; yield its id."""
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w") as tar:
        content = uuid.uuid4().bytes
        entry = tarfile.TarInfo("file")
        entry.size = len(content)
        tar.addfile(entry, io.BytesIO(content))
    engine.api.import_image_from_data(archive.getvalue(), repository=name, tag=tags[0])
    identity = engine.images.get(f"{name}:{tags[0]}").id
    assert identity is not None
    try:
        for tag in tags[1:]:
            engine.images.get(identity).tag(name, tag)
        yield identity
    finally:
        engine.images.remove(identity, force=True)


@contextmanager
def faulty(address: str, fault: Callable[[Request], Reply | None]) -> Iterator[Server]:
    """Run a proxy of a registry; answers of ``fault`` replace the registry's."""
    import requests

    def answer(request: Request) -> Reply:
        own = fault(request)
        if own is not None:
            return own
        headers = {
            name: value for name, value in request.headers.items() if name not in ("connection", "transfer-encoding")
        }
        with requests.request(
            request.method,
            f"http://{address}{request.path}",
            headers=headers,
            data=request.body,
            allow_redirects=False,
            timeout=60,
        ) as passed:
            kept = {name: value for name, value in passed.headers.items() if name.lower() != "transfer-encoding"}
            return Reply(passed.status_code, passed.content, kept)

    with serve(answer) as server:
        yield server
