"""Requests and answers held against botocore's description of AWS Batch."""

import re
from functools import cache
from typing import Any

import botocore.session
from botocore.model import ServiceModel, Shape
from botocore.validate import ParamValidator


@cache
def service() -> ServiceModel:
    """Botocore's description of the service."""
    return botocore.session.get_session().get_service_model("batch")


@cache
def _routes() -> list[tuple[str, re.Pattern[str], str]]:
    found = []
    for name in service().operation_names:
        http = service().operation_model(name).http
        pattern = re.sub(r"\\\{(\w+)\\\}", r"(?P<\1>.+)", re.escape(http["requestUri"]))
        found.append((http["method"], re.compile(pattern), name))
    return found


def operation(method: str, path: str) -> tuple[str, dict[str, str]] | None:
    """Return the operation of a request and what its path says, or None."""
    for allowed, pattern, name in _routes():
        match = pattern.fullmatch(path)
        if match and allowed == method:
            return name, match.groupdict()
    return None


def request_problems(name: str, request: dict[str, Any]) -> list[str]:
    """Return what the description of an operation has against a request."""
    return _problems(service().operation_model(name).input_shape, request)


def answer_problems(name: str, answer: dict[str, Any]) -> list[str]:
    """Return what the description of an operation has against an answer."""
    return _problems(service().operation_model(name).output_shape, answer)


def _problems(shape: Shape | None, value: Any) -> list[str]:
    if shape is None:
        return [] if not value else ["nothing was expected"]
    report = ParamValidator().validate(value, shape).generate_report()
    lines = [line.replace('"', "") for line in report.splitlines()]
    # Required by the description, yet AWS gives none before a job has started, nor ever of an array.
    started = re.compile(r"Missing required parameter in jobs\[\d+\]: startedAt")
    return [line for line in lines if not started.fullmatch(line)] + list(_beyond(shape, value, ""))


def _beyond(shape: Any, value: Any, where: str) -> list[str]:
    """What botocore's own check leaves to the service: enumerations and lengths."""
    found = []
    if shape.type_name == "structure":
        for name, member in value.items() if isinstance(value, dict) else ():
            if name in shape.members:
                found += _beyond(shape.members[name], member, f"{where}.{name}")
    elif shape.type_name == "list" and isinstance(value, list):
        for index, each in enumerate(value):
            found += _beyond(shape.member, each, f"{where}[{index}]")
    elif shape.type_name == "map" and isinstance(value, dict) and len(value) > shape.metadata.get("max", len(value)):
        found.append(f"{where}: {len(value)} entries, at most {shape.metadata['max']}")
    elif shape.type_name == "string" and getattr(shape, "enum", None) and value not in shape.enum:
        found.append(f"{where}: {value!r} is none of {', '.join(shape.enum)}")
    return found
