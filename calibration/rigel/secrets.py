"""Which texts of a Rigelfile are secrets: these are not copied, the name of a variable stands for them."""

import re

_NAME = re.compile(
    r"passw(or)?d|passphrase|secret|token|credential|private_?key|access_?key|api_?key|ssh_?key|deploy_?key"
    r"|(^|_)(key|auth|pwd)$",
    re.IGNORECASE,
)
_VALUES = (
    re.compile(r"-----BEGIN [A-Z ]*PRIVATE KEY-----.*?(?:-----END [A-Z ]*PRIVATE KEY-----|\Z)", re.DOTALL),
    re.compile(r"\b(?:AKIA|ASIA)[0-9A-Z]{16}\b"),
    re.compile(r"\bgh[pousr]_[A-Za-z0-9]{20,}\b|\bgithub_pat_[A-Za-z0-9_]{20,}\b|\bglpat-[A-Za-z0-9_-]{20,}"),
    re.compile(r"\bdckr_pat_[A-Za-z0-9_-]{20,}|\bxox[abprs]-[A-Za-z0-9-]{10,}"),
    re.compile(r"(?<=://)[^\s/@:]*:[^\s/@{}$]+(?=@)"),  # https://user:password@host
)


def names_a_secret(name: str) -> bool:
    """Whether what is called so is a secret: ``DOCKER_PASSWORD``, ``aws_secret_access_key``."""
    return _NAME.search(name) is not None


def spans_of_secrets(text: str) -> list[tuple[int, int]]:
    """Where a text holds something that has the form of a secret: a private key, a token, a password in a URL."""
    return [match.span() for pattern in _VALUES for match in pattern.finditer(text)]


def variable_name(text: str) -> str:
    """A name for an environment variable: ``docker-password`` gives ``DOCKER_PASSWORD``."""
    name = re.sub(r"[^A-Za-z0-9_]+", "_", text).strip("_")
    if re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name):
        return name if name == text else name.upper()
    return f"SECRET_{name.upper()}".rstrip("_")
