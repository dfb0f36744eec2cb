"""Codacy's protocol, byte by byte, and the messages of failures."""

import json
import socket
import ssl
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from calibration.addons.coverage.codacy import (
    API_URL,
    Account,
    Codacy,
    Upload,
    parse_account,
    parse_api_url,
    report_body,
)
from calibration.addons.coverage.formats import FileCoverage, Rate
from calibration.base import InfrastructureError, InputError
from calibration.base.http import FIRST_PAUSE, MAX_ATTEMPTS, MAX_BYTES, Http, Timeouts
from tests.docker_engine import wait_until

from . import projects
from .projects import TOKEN

SHA = "0123456789abcdef0123456789abcdef01234567"
FILES = {
    "robot/naming.py": FileCoverage({10: 2**40, 2: 0, 1: 1}, {1: Rate(1, 2)}),
    "robot/__init__.py": FileCoverage(),
    "a ü.py": FileCoverage({1: 0}),
}
PYTHON = (
    '{"fileReports":[{"filename":"a ü.py","coverage":{"1":0}},'
    '{"filename":"robot/naming.py","coverage":{"1":1,"2":0,"10":2147483647}}]}'
).encode()


@pytest.fixture
def server() -> Iterator[projects.Codacy]:
    with projects.codacy() as service:
        yield service


def client(url: str, account: Account | None = None, **limits: float) -> tuple[Codacy, list[float]]:
    """A client that records its pauses instead of sleeping, with a time limit of a minute."""
    pauses: list[float] = []
    waits = Timeouts(**{"connect": 60, "silence": 60, "whole": 60} | limits)
    http = Http([TOKEN], address="the address (api-url)", timeouts=waits, pause=pauses.append)
    return Codacy(account or Account(TOKEN), url, http=http), pauses


def tell(codacy: Codacy, **options: bool) -> None:
    codacy.send(codacy.requests(Upload(SHA, FILES, **options)))


def test_a_projects_token(server: projects.Codacy) -> None:
    codacy, _ = client(server.url)
    tell(codacy)
    [asked] = server.asked
    assert (asked.method, asked.path) == ("POST", f"/2.0/coverage/{SHA}/python?partial=false")
    assert asked.body == PYTHON
    headers = {name.lower(): value for name, value in asked.headers.items()}
    assert headers["project-token"] == TOKEN
    assert headers["content-type"] == "application/json"
    assert "api-token" not in headers
    assert "authorization" not in headers


def test_an_accounts_token(server: projects.Codacy) -> None:
    account = parse_account(None, TOKEN, "gh", "team", "robot.py")
    tell(client(server.url, account)[0], final=True)
    base = f"/2.0/gh/team/robot.py/commit/{SHA}"
    assert [asked.path for asked in server.asked] == [f"{base}/coverage/python?partial=true", f"{base}/coverageFinal"]
    assert [asked.body for asked in server.asked] == [PYTHON, b"{}"]
    for asked in server.asked:
        assert asked.headers["api-token"] == TOKEN
        assert "project-token" not in asked.headers


@pytest.mark.parametrize(
    ("options", "more", "language", "paths"),
    [
        ({}, {}, None, ["python?partial=false"]),
        ({"partial": True}, {}, None, ["python?partial=true"]),
        ({"final": True}, {}, None, ["python?partial=true", "Final"]),
        ({}, {"src/arm.cpp": FileCoverage({1: 1})}, None, ["python?partial=true", "cpp?partial=true", "Final"]),
        ({"partial": True}, {"src/arm.cpp": FileCoverage({1: 1})}, None, ["python?partial=true", "cpp?partial=true"]),
        ({}, {"src/arm.cpp": FileCoverage({1: 1})}, "Visual Basic", ["visual%20basic?partial=false"]),
        ({}, {"README": FileCoverage({1: 1})}, None, ["python?partial=false"]),
    ],
)
def test_partial_and_final(
    options: dict[str, bool], more: dict[str, FileCoverage], language: str | None, paths: list[str]
) -> None:
    codacy = Codacy(Account(TOKEN), API_URL, language)
    found = [request.url for request in codacy.requests(Upload(SHA, FILES | more, **options))]
    base = f"{API_URL}/2.0/"
    expected = [
        base + (f"commit/{SHA}/coverageFinal" if path == "Final" else f"coverage/{SHA}/{path}") for path in paths
    ]
    assert found == expected


def test_only_the_end() -> None:
    [request] = Codacy(Account(TOKEN)).requests(Upload(SHA, {}, final=True))
    assert (request.url, request.body) == (f"{API_URL}/2.0/commit/{SHA}/coverageFinal", b"{}")


def test_a_name_that_is_no_text_is_still_json() -> None:
    body = report_body({"a\udcff.py": FileCoverage({1: 1})})
    assert json.loads(body)["fileReports"][0]["filename"] == "a\udcff.py"


def test_no_token_in_what_is_printed() -> None:
    codacy = Codacy(Account(TOKEN), API_URL, http=Http([TOKEN]))
    assert TOKEN not in repr([codacy, codacy.requests(Upload(SHA, FILES))])


HTML = "<!DOCTYPE html><html><body>Sign in</body></html>"


@pytest.mark.parametrize(
    ("status", "body", "headers", "said"),
    [
        (401, '{"error": "bad credentials"}', {}, "answered 401 (bad credentials): check the token, whether it is of"),
        (404, '{"error": "not found"}', {}, "answered 404 (not found): check the token"),
        (200, '{"error": "Project NOT FOUND"}', {}, "answered 200 (Project NOT FOUND): check the token"),
        (400, '{"error": "unknown commit"}', {}, "answered 400 (unknown commit): check the commit and the language"),
        (200, '{"error": "x", "success": "y"}', {}, "answered 200 (x): check the commit"),
        (403, "no", {}, "answered 403 (no): check the token"),
        (403, HTML, {"Content_Type": "text/html"}, "answered 403: check the token"),
        (
            200,
            HTML,
            {"Content_Type": "text/html; charset=utf-8"},
            "answered 200 with an HTML page, not from Codacy's API",
        ),
        (200, HTML, {}, "with an HTML page"),
        (200, "thanks", {}, "answered 200 with a body that is not JSON (thanks): check api-url"),
        (200, "", {}, "answered 200 with a body that is not JSON: check api-url"),
        (200, "[" * 100_000, {}, "with a body that is not JSON"),
        (200, '{"ok": true}', {}, 'answered 200 with JSON that contains neither success nor error ({"ok": true})'),
        (200, '["success"]', {}, "neither success nor error"),
        (200, '{"success": false}', {}, "neither success nor error"),
        (
            302,
            "",
            {"Location": "https://user:pw@login.example.org/x"},
            "redirects a POST to https://login.example.org, which is not followed: check the address (api-url)",
        ),
        (302, "", {"Location": "/x"}, "answered 302: redirects a POST to http://127.0.0.1, which is not followed"),
        (200, b"\xff\xfe", {}, "with a body that is not JSON"),
        (200, '{"error": "\\u001b[2J::add-mask::x\\n\\n"}', {}, "answered 200 (\\x1b[2J::add-mask::x): check"),
        (200, json.dumps({"error": f"token {TOKEN} is wrong"}), {}, "answered 200 (token *** is wrong)"),
    ],
)
def test_answers_that_are_no_success(
    server: projects.Codacy, status: int, body: str | bytes, headers: dict[str, str], said: str
) -> None:
    codacy, pauses = client(server.url)
    server.answer(status, body, **headers)
    with pytest.raises(InfrastructureError) as failed:
        tell(codacy)
    message = str(failed.value)
    assert message.startswith(f"codacy: {urlsplit(server.url).netloc}: ")
    assert said in message
    assert "\n" not in message
    assert len(message) < 500
    assert len(server.asked) == 1  # not again
    assert pauses == []


def test_json_decides_whatever_the_status(server: projects.Codacy) -> None:
    server.answer(404, '{"success": "taken"}')
    tell(client(server.url)[0])


@pytest.mark.parametrize("status", [500, 502, 503, 429])
def test_what_passes_is_tried_again(server: projects.Codacy, status: int) -> None:
    codacy, pauses = client(server.url)
    server.answer(status, "")
    server.answer(status, "", Retry_After="7")
    tell(codacy)
    assert len(server.asked) == 3
    assert {asked.body for asked in server.asked} == {PYTHON}
    assert pauses == [FIRST_PAUSE, 7.0]


@pytest.mark.parametrize(
    ("status", "body", "said"),
    [
        (503, HTML, "answered 503 (4 attempts): the server failed: run it again later"),
        (500, '{"error": "boom"}', 'answered 500 ({"error": "boom"}) (4 attempts): the server failed'),
        (429, "slow down", "answered 429 (slow down) (4 attempts): too many requests"),
    ],
)
def test_what_does_not_pass(server: projects.Codacy, status: int, body: str, said: str) -> None:
    codacy, pauses = client(server.url)
    for _ in range(9):
        server.answer(status, body)
    with pytest.raises(InfrastructureError) as failed:
        tell(codacy)
    assert said in str(failed.value)
    assert len(server.asked) == MAX_ATTEMPTS == 4
    assert pauses == [0.5, 1.0, 2.0]


def test_a_long_wait_is_not_waited_for(server: projects.Codacy) -> None:
    codacy, pauses = client(server.url)
    server.answer(429, "", Retry_After="3600")
    with pytest.raises(InfrastructureError, match=r"answered 429 and asks for a pause of 3600 s \(1 attempt\)"):
        tell(codacy)
    assert pauses == []
    server.answer(503, "", Retry_After="Wed, 21 Oct 2026 07:28:00 GMT")  # a date is not understood
    tell(codacy)
    assert pauses == [0.5]


@pytest.mark.parametrize(
    ("fault", "limits", "said"),
    [
        (projects.reset, {}, "no answer: Connection reset by peer (4 attempts): check the network"),
        (projects.hang, {"silence": 0.5}, "no answer within 0.5 s (4 attempts)"),
        (projects.drip, {"whole": 0.5}, "did not finish its answer within 0.5 s (4 attempts)"),
        (projects.cut, {}, "broke off in the middle of its answer"),
    ],
)
def test_faults_of_the_network(
    server: projects.Codacy, fault: Callable[..., None], limits: dict[str, float], said: str
) -> None:
    codacy, pauses = client(server.url, **limits)
    server.fault = fault
    with pytest.raises(InfrastructureError) as failed:
        tell(codacy)
    assert said in str(failed.value)
    assert "\n" not in str(failed.value)
    wait_until(lambda: len(server.asked) == 4, "the server has heard of all")
    assert pauses == [0.5, 1.0, 2.0]


def test_nobody_is_there() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        codacy, pauses = client(f"http://127.0.0.1:{taken.getsockname()[1]}")
        with pytest.raises(
            InfrastructureError, match=r"no answer: Connection refused \(4 attempts\): check the network, a proxy"
        ):
            tell(codacy)
    assert pauses == [0.5, 1.0, 2.0]


def test_no_such_host() -> None:
    codacy, _ = client("https://codacy.invalid")
    with pytest.raises(InfrastructureError, match=r"codacy: codacy.invalid: no (answer|connection)"):
        tell(codacy)


def test_tls_that_is_none(server: projects.Codacy) -> None:
    codacy, pauses = client(server.url.replace("http:", "https:"))
    with pytest.raises(InfrastructureError, match=r"TLS is not trusted|no answer"):
        tell(codacy)
    assert len(pauses) in (0, 3)


def test_tls_that_nobody_vouches_for(tmp_path: Path) -> None:
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    names = ["-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(key)]
    command = [
        "openssl",
        "req",
        "-x509",
        "-newkey",
        "rsa:2048",
        "-nodes",
        "-days",
        "2",
        *names,
        "-out",
        str(certificate),
    ]
    try:
        subprocess.run(command, check=True, capture_output=True)
    except FileNotFoundError:
        pytest.skip("needs openssl")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    with projects.codacy(context) as service:
        codacy, pauses = client(service.url)
        with pytest.raises(
            InfrastructureError, match=r"its TLS is not trusted: .*certificate verify failed.*REQUESTS_CA_BUNDLE"
        ):
            tell(codacy)
        assert pauses == []  # not tried again
        assert service.asked == []


def test_an_answer_without_end(server: projects.Codacy) -> None:
    server.answer(200, b" " * (MAX_BYTES + 1))
    with pytest.raises(InfrastructureError, match="answers with more than 4194304 bytes"):
        tell(client(server.url, whole=30)[0])


def test_a_request_that_cannot_be_made(server: projects.Codacy) -> None:
    with pytest.raises(InfrastructureError, match="the request failed: "):
        Http().send("POST", server.url, {"bad\nname": "x"}, b"")


def test_the_token_stays_with_this_server(
    server: projects.Codacy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No redirect is followed, no .netrc is read, no proxy of the environment is asked for this machine."""
    (tmp_path / ".netrc").write_text("machine 127.0.0.1 login someone password secret\n")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    with projects.codacy() as other:
        server.answer(307, "", Location=other.url)
        with pytest.raises(InfrastructureError, match="redirects a POST"):
            tell(client(server.url)[0])
        assert other.asked == []
    assert "Authorization" not in server.asked[0].headers


def test_the_password_of_another_is_sent_to_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / ".netrc").write_text("machine 127.0.0.2 login someone password secret\n")
    monkeypatch.setenv("HOME", str(tmp_path))
    for variable in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(variable, raising=False)
    with projects.codacy(host="127.0.0.2") as server:  # on this machine too, which we do not know of this address
        Http().send("POST", server.url, {}, b"{}")
        assert "Authorization" not in server.asked[0].headers


def test_what_follows_a_failure_is_still_sent(server: projects.Codacy) -> None:
    server.answer(400, '{"error": "first"}')
    server.answer(400, '{"error": "second"}')
    with pytest.raises(InfrastructureError, match="first"):
        tell(client(server.url)[0], final=True)
    assert len(server.asked) == 2


@pytest.mark.parametrize(
    ("text", "url"),
    [
        ("https://api.codacy.com", "https://api.codacy.com"),
        ("https://API.codacy.com:8443/ ", "https://api.codacy.com:8443"),
        ("http://127.0.0.1:80", "http://127.0.0.1:80"),
        ("http://[::1]:80", "http://[::1]:80"),
    ],
)
def test_addresses(text: str, url: str) -> None:
    assert parse_api_url(text) == url


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("api.codacy.com", "expected an address such as https://api.codacy.com"),
        ("file:///etc/passwd", "expected an address"),
        ("https://", "expected an address"),
        ("https://[", "which is not a URL"),
        ("https://host:99999", "which is not a URL"),
        ("http://api.codacy.com", "expected https: the token would be sent unencrypted"),
        ("http://127.0.0.1.evil.org", "expected https"),
        ("https://user:secret@api.codacy.com", "api-url: it contains a user name or a password"),
        ("https://api.codacy.com/2.0", "expected only scheme and host"),
        ("https://api.codacy.com?x=1", "expected only scheme and host"),
    ],
)
def test_addresses_that_are_none(text: str, message: str) -> None:
    with pytest.raises(InputError) as refused:
        parse_api_url(text)
    assert message in str(refused.value)
    assert "secret" not in str(refused.value)


def test_who_tells() -> None:
    assert parse_account(None, None, "gh", "team", "robot") is None
    assert parse_account(TOKEN, "other", "gh", "team", "robot") == Account(TOKEN)  # a project's goes first
    assert parse_account(None, TOKEN, "gh", "team", "robot") == Account(TOKEN, "gh", "team", "robot")


@pytest.mark.parametrize(
    ("account", "message"),
    [
        ((None, TOKEN, None, "team", "robot"), "provider is not given: CODACY_API_TOKEN is an account's and needs all"),
        ((None, TOKEN, "gh", "team", None), "repository is not given"),
        ((None, TOKEN, "gi", "team", "robot"), "provider: found 'gi', expected one of gh, "),
        ((None, TOKEN, "gh", "../..", "robot"), "organisation: found '../..', expected a name"),
        ((None, TOKEN, "gh", "team", ".."), "repository: found '..', expected a name"),
        (("two words", None, None, None, None), "CODACY_PROJECT_TOKEN: found characters that no token has"),
        ((None, "line\nbreak", "gh", "a", "b"), "CODACY_API_TOKEN: found characters that no token has"),
        (("tökenwert", None, None, None, None), "CODACY_PROJECT_TOKEN: found characters"),
    ],
)
def test_who_cannot_tell(account: tuple[str | None, ...], message: str) -> None:
    with pytest.raises(InputError) as refused:
        parse_account(*account)  # type: ignore[arg-type]
    assert message in str(refused.value)
    assert not any(token in str(refused.value) for token in account[:2] if token)
