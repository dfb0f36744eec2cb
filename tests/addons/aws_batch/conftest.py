from functools import cache

import pytest


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten the client's intervals of polls; read AWS's service descriptions only once."""
    import botocore.session

    from calibration.addons.aws_batch import following, logs, session, submitting

    monkeypatch.setattr(following, "_MIN_POLL_SECONDS", 0.05)
    monkeypatch.setattr(submitting, "_TAKING_NOTE", 0.05)
    monkeypatch.setattr(logs, "_POLL_SECONDS", 0.05)
    monkeypatch.setattr(logs, "_SECONDS_BETWEEN_TRIES", 0.0)
    monkeypatch.setattr(submitting, "_POLL_SECONDS", 0.05)
    monkeypatch.setattr(session, "_FIRST_DELAY", 0.05)
    monkeypatch.setattr(botocore.session, "create_loader", _loader)


@cache
def _loader(search_path: str | None = None) -> object:
    from botocore.loaders import create_loader

    return create_loader(search_path)
