import base64
import hashlib
import json
import ssl
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from calibration.base import CalibrationError, InfrastructureError, InputError
from calibration.base.http import Timeouts
from calibration.ci.registries.reference import Credentials
from calibration.ci.registries.registry import MEDIA_TYPES, Manifest, RegistryClient
from tests.ci.registries.server import Reply, Request, Server, serve

INDEX, _, OCI, DOCKER = MEDIA_TYPES
PASSWORD = "pl4nted-pässword/+"  # noqa: S105
CONTENT = b'{"schemaVersion": 2,\n "manifests": []}'
DIGEST = f"sha256:{hashlib.sha256(CONTENT).hexdigest()}"
OTHER = "sha256:" + "0" * 64
FINE = Reply(200, CONTENT, {"Content-Type": DOCKER, "Docker-Content-Digest": DIGEST})
BASIC = "Basic " + base64.b64encode(f"robot:{PASSWORD}".encode()).decode()


def denial(*_: object) -> Reply:
    return Reply(403, b'{"errors": [{"code": "DENIED", "message": "not yours"}]}')


@pytest.fixture
def pauses() -> list[float]:
    return []


@pytest.fixture
def client(pauses: list[float]) -> Iterator[RegistryClient]:
    with RegistryClient(pause=pauses.append, timeouts=Timeouts(connect=2, silence=0.2)) as client:
        yield client


def user(server: Server, **more: object) -> Credentials:
    return Credentials(server.address, "robot", PASSWORD, **more)  # type: ignore[arg-type]


def in_turn(*replies: Reply) -> Callable[[Request], Reply]:
    waiting = list(replies)
    return lambda _: waiting.pop(0) if len(waiting) > 1 else waiting[0]


def test_digest_of_a_name(client: RegistryClient) -> None:
    with serve(lambda _: FINE) as server:
        assert client.find_manifest(f"{server.address}/team/robot:v1") == DIGEST
        assert client.find_manifest(f"{server.address}/team/robot") == DIGEST
        assert client.find_manifest(f"{server.address}/team/robot@{DIGEST}") == DIGEST
        assert client.read_manifest(f"{server.address}/team/robot:v1") == Manifest(DIGEST, DOCKER, CONTENT)
    assert server.paths() == [
        "HEAD /v2/team/robot/manifests/v1",
        "HEAD /v2/team/robot/manifests/latest",
        f"HEAD /v2/team/robot/manifests/{DIGEST}",
        "GET /v2/team/robot/manifests/v1",
    ]
    for request in server.requests:
        assert request.headers["accept"].split(", ") == list(MEDIA_TYPES)
        assert request.authorization is None


def test_missing_objects(client: RegistryClient) -> None:
    missing = Reply(404, b'{"errors": [{"code": "MANIFEST_UNKNOWN"}]}')
    with serve(lambda _: missing) as server:
        assert client.find_manifest(f"{server.address}/robot") is None
        assert client.read_manifest(f"{server.address}/robot") is None


def test_denied_anonymous_access_counts_as_missing(client: RegistryClient) -> None:
    with serve(denial) as server:
        assert client.find_manifest(f"{server.address}/robot") is None


def test_denied_access_with_a_login_is_an_error() -> None:
    with serve(denial) as server, RegistryClient(user(server)) as client:
        with pytest.raises(InputError) as caught:
            client.find_manifest(f"{server.address}/robot")
        with pytest.raises(InputError):
            client.put_manifest(f"{server.address}/robot:v1", Manifest(DIGEST, DOCKER, CONTENT))
    assert str(caught.value) == (
        f"{server.address}/robot: {server.address} denies access (403); "
        "check the password of robot, and what it may do to this name"
    )


def test_a_registry_that_does_not_say_the_digest(client: RegistryClient) -> None:
    with serve(lambda _: Reply(200, CONTENT, {"Content-Type": f"{INDEX}; charset=utf-8"})) as server:
        assert client.find_manifest(f"{server.address}/robot") == DIGEST
        assert client.read_manifest(f"{server.address}/robot@{DIGEST}") == Manifest(DIGEST, INDEX, CONTENT)


@pytest.mark.parametrize(
    ("reply", "version", "message"),
    [
        (Reply(200, CONTENT, {**FINE.headers, "Docker-Content-Digest": OTHER}), "", f"has the digest {DIGEST}, not"),
        (FINE, f"@{OTHER}", f"has the digest {DIGEST}, not {OTHER}"),
        (Reply(200, b"<html>", {"Content-Type": "text/html"}), "", "answers with text/html, an image's manifest was"),
        (Reply(200, b"{}", {"Content-Type": "a/b\tc"}), "", "answers with a/b"),
        (
            Reply(200, b"{}", {"Content-Type": "application/vnd.docker.distribution.manifest.v1+prettyjws"}),
            "",
            "manifest.v1+prettyjws, an image's manifest was expected",
        ),
        (Reply(200, b"", {"Content-Length": "0"}), "", "answers with nothing, an image's manifest was expected"),
        (Reply(418, b"teapot"), "", "the registry answers 418"),
        (
            Reply(200, b" " * (4 * 1024 * 1024 + 1), {"Content-Type": DOCKER}),
            "",
            "answers with more than 4194304 bytes",
        ),
    ],
)
def test_answers_that_are_no_manifest(client: RegistryClient, reply: Reply, version: str, message: str) -> None:
    with serve(lambda _: reply) as server, pytest.raises(CalibrationError) as caught:
        client.read_manifest(f"{server.address}/robot{version}")
    assert message in str(caught.value)


def test_another_image_than_the_one_that_was_asked_for(client: RegistryClient) -> None:
    with serve(lambda _: FINE) as server, pytest.raises(InfrastructureError, match="answers with another image"):
        client.find_manifest(f"{server.address}/robot@{OTHER}")


@pytest.mark.parametrize("fault", [Reply(500), Reply(503, b"<html>"), Reply(429), Reply(reset=True), Reply(hang=True)])
def test_temporary_failures_are_retried(client: RegistryClient, pauses: list[float], fault: Reply) -> None:
    with serve(in_turn(fault, fault, FINE)) as server:
        assert client.read_manifest(f"{server.address}/robot") == Manifest(DIGEST, DOCKER, CONTENT)
    assert pauses == [0.5, 1.0]


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (
            Reply(500, b'{"errors": [{"code": "UNKNOWN", "message": "disk\\nfull"}]}'),
            "answered 500 (UNKNOWN: disk full)",
        ),
        (Reply(502, b"<html>::error::</html>"), "answered 502 (4 attempts)"),
        (Reply(500, b'{"errors": [1]}'), "answered 500 (4 attempts)"),
        (Reply(500, b'{"errors": []}'), "answered 500 (4 attempts)"),
        (Reply(500, b"[" * 100_000), "answered 500 (4 attempts)"),
        (Reply(reset=True), "no answer: "),
        (Reply(hang=True), "no answer within 0.2 s (4 attempts)"),
        (
            Reply(200, b"x", {"Content-Length": "100", "Content-Type": DOCKER, "Connection": "close"}),
            "broke off in the middle",
        ),
    ],
)
def test_permanent_failures_end_the_retries(
    client: RegistryClient, pauses: list[float], fault: Reply, message: str
) -> None:
    with serve(lambda _: fault) as server, pytest.raises(InfrastructureError) as caught:
        client.read_manifest(f"{server.address}/robot")
    assert str(caught.value).startswith(f"{server.address}: {message}")
    assert pauses == [0.5, 1.0, 2.0]
    assert len(server.requests) == 4


def test_no_server_at_all(client: RegistryClient) -> None:
    with serve(lambda _: FINE) as server:
        pass
    with pytest.raises(InfrastructureError, match=r"no answer: .*[Rr]efused"):
        client.find_manifest(f"{server.address}/robot")


def test_the_pause_that_a_registry_asks_for(client: RegistryClient, pauses: list[float]) -> None:
    with serve(
        in_turn(Reply(429, headers={"Retry-After": "7"}), Reply(429, headers={"Retry-After": "x"}), FINE)
    ) as server:
        assert client.find_manifest(f"{server.address}/robot") == DIGEST
    assert pauses == [7.0, 1.0]


def test_a_pause_that_is_too_long(client: RegistryClient, pauses: list[float]) -> None:
    with (
        serve(lambda _: Reply(429, headers={"Retry-After": "3600"})) as server,
        pytest.raises(InfrastructureError, match="answered 429 and asks for a pause of 3600 s"),
    ):
        client.find_manifest(f"{server.address}/robot")
    assert pauses == []


def test_user_and_password(pauses: list[float]) -> None:
    def answer(request: Request) -> Reply:
        ask = Reply(401, headers={"WWW-Authenticate": 'Basic realm="test"'})
        return FINE if request.authorization == BASIC else ask

    with serve(answer) as server:
        with RegistryClient(user(server)) as client:
            assert client.find_manifest(f"{server.address}/robot") == DIGEST
            assert client.find_manifest(f"{server.address}/robot") == DIGEST
        assert [request.authorization for request in server.requests] == [None, BASIC, BASIC]
        with RegistryClient(Credentials("ghcr.io", "robot", PASSWORD)) as stranger:
            assert stranger.find_manifest(f"{server.address}/robot") is None
        assert server.requests[-1].authorization is None
        with RegistryClient(Credentials(server.address, "robot", "wrong")) as client, pytest.raises(InputError):
            client.find_manifest(f"{server.address}/robot")


@pytest.mark.parametrize("header", ["", "Negotiate", 'Bearer service="x"', "Bearer"])
def test_a_question_that_cannot_be_answered(header: str) -> None:
    with (
        serve(lambda _: Reply(401, headers={"WWW-Authenticate": header})) as server,
        RegistryClient(user(server)) as client,
        pytest.raises(InputError, match="denies access"),
    ):
        client.find_manifest(f"{server.address}/robot")
    assert [request.authorization for request in server.requests] == [None]


class TokenRegistry:
    """Requires tokens, which it issues at /token."""

    def __init__(self, realm: str = "", key: str = "token") -> None:
        self.realm, self.key = realm, key
        self.token = "t0ken-1"  # noqa: S105
        self.address = ""

    def __call__(self, request: Request) -> Reply:
        if request.path.startswith("/token"):
            known = request.authorization in (None, BASIC)
            return Reply(200 if known else 401, json.dumps({self.key: self.token}).encode())
        if request.authorization == f"Bearer {self.token}":
            return FINE
        write = ",push" if request.method == "PUT" else ""
        realm = self.realm or f"http://{self.address}/token?account=x"
        ask = f'Bearer realm="{realm}",service="a b",scope="repository:robot:pull{write}"'
        return Reply(401, headers={"WWW-Authenticate": ask})


def test_tokens(pauses: list[float]) -> None:
    registry = TokenRegistry()
    with serve(registry) as server, RegistryClient(user(server), pause=pauses.append) as client:
        registry.address = server.address
        name = f"{server.address}/robot:v1"
        assert client.find_manifest(name) == DIGEST
        assert client.find_manifest(name) == DIGEST
        client.put_manifest(name, Manifest(DIGEST, DOCKER, CONTENT))
        registry.token = "t0ken-2"  # the first has expired  # the first has expired  # noqa: S105
        assert client.find_manifest(name) == DIGEST
    read = "GET /token?account=x&service=a+b&scope=repository%3Arobot%3Apull"
    head, put = "HEAD /v2/robot/manifests/v1", "PUT /v2/robot/manifests/v1"
    assert server.paths() == [head, read, head, head, put, f"{read}%2Cpush", put, head, read, head]
    assert server.requests[1].authorization == BASIC
    assert server.requests[6].body == CONTENT
    assert server.requests[6].headers["content-type"] == DOCKER


@pytest.mark.parametrize("key", ["token", "access_token"])
def test_a_token_for_anyone(client: RegistryClient, key: str) -> None:
    registry = TokenRegistry(key=key)
    with serve(registry) as server:
        registry.address = server.address
        assert client.find_manifest(f"{server.address}/robot") == DIGEST
    assert server.requests[1].authorization is None


def test_a_token_of_a_credential_helper() -> None:
    registry = TokenRegistry()
    with serve(registry) as server:
        registry.address = server.address
        with RegistryClient(Credentials(server.address, identity_token=PASSWORD)) as client:
            assert client.find_manifest(f"{server.address}/robot") == DIGEST
    asked = server.requests[1]
    assert asked.method == "POST"
    assert b"grant_type=refresh_token&" in asked.body
    assert b"refresh_token=pl4nted-p%C3%A4ssword%2F%2B" in asked.body


def test_a_token_that_is_denied() -> None:
    registry = TokenRegistry()
    with serve(registry) as server:
        registry.address = server.address
        with (
            RegistryClient(Credentials(server.address, "robot", "wrong")) as client,
            pytest.raises(InputError, match="check the password of robot"),
        ):
            client.find_manifest(f"{server.address}/robot")


@pytest.mark.parametrize(
    "answer", [b"<html>", b"[]", b"{}", b'{"token": 3}', b'{"token": "a\\nb"}', '{"token": "\u00e4"}'.encode(), b"\xff"]
)
def test_something_else_than_a_token(answer: bytes) -> None:
    def reply(request: Request) -> Reply:
        ask = {"WWW-Authenticate": f'Bearer realm="http://{server.address}/token"'}
        return Reply(200, answer) if request.path.startswith("/token") else Reply(401, headers=ask)

    with (
        serve(reply) as server,
        RegistryClient() as client,
        pytest.raises(InfrastructureError, match=r"answered 200 instead of a token for"),
    ):
        client.find_manifest(f"{server.address}/robot")


@pytest.mark.parametrize(
    "realm", ["http://203.0.113.7/token", "ftp://x", "//x", "http://127.0.0.1:1@evil.org/t", "http://[x"]
)
def test_a_place_for_passwords_that_is_not_safe(realm: str) -> None:
    registry = TokenRegistry(realm)
    with (
        serve(registry) as server,
        RegistryClient(user(server)) as client,
        pytest.raises(InfrastructureError, match=r"wants passwords sent unencrypted to .*, expected https"),
    ):
        client.find_manifest(f"{server.address}/robot")


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tls")
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"]
    command += ["-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1"]
    files = ["-keyout", str(folder / "key.pem"), "-out", str(folder / "cert.pem")]
    try:
        subprocess.run([*command, *files], check=True, capture_output=True, timeout=60)
    except OSError:
        pytest.skip("needs openssl")
    return folder


def tls_context(certificate: Path) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate / "cert.pem", certificate / "key.pem")
    return context


def test_another_server_receives_no_password(
    certificate: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Neither that of the settings nor that in the user's .netrc is sent."""
    (tmp_path / ".netrc").write_text("machine localhost login a password b\nmachine 127.0.0.1 login a password b\n")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("REQUESTS_CA_BUNDLE", str(certificate / "cert.pem"))
    with serve(lambda _: FINE, tls_context(certificate)) as other:
        target = f"https://localhost:{other.address.partition(':')[2]}/v2/blob"

        def answer(request: Request) -> Reply:
            if request.authorization != BASIC:
                return Reply(401, headers={"WWW-Authenticate": "Basic"})
            if request.path.endswith("/here"):
                return Reply(302, headers={"Location": "/v2/robot/manifests/v1"})
            return FINE if request.path.endswith("/v1") else Reply(307, headers={"Location": target})

        with serve(answer) as server, RegistryClient(user(server)) as client:
            assert client.find_manifest(f"{server.address}/robot:there") == DIGEST
            assert client.find_manifest(f"{server.address}/robot:here") == DIGEST
    assert [request.authorization for request in server.requests] == [None, BASIC, BASIC, BASIC]
    assert [request.authorization for request in other.requests] == [None]


def test_untrusted_tls(certificate: Path, monkeypatch: pytest.MonkeyPatch, pauses: list[float]) -> None:
    with serve(lambda _: FINE, tls_context(certificate)) as other:
        target = f"https://{other.address}/x"
        with (
            serve(lambda _: Reply(302, headers={"Location": target})) as server,
            RegistryClient(pause=pauses.append) as client,
            pytest.raises(InfrastructureError, match="TLS is not trusted"),
        ):
            client.find_manifest(f"{server.address}/robot")
    assert pauses == []
    assert other.requests == []


@pytest.mark.parametrize(
    ("location", "message"),
    [
        ("http://203.0.113.7/x", "to http://203.0.113.7, which is unencrypted"),
        ("http://user:secret@127.0.0.1:1/x", "to http://127.0.0.1, which is unencrypted"),
        ("file:///etc/passwd", "to file://, which is unencrypted"),
        ("/again", "redirects more than 5 times"),
        ("http://[", "failed"),
    ],
)
def test_redirects_that_are_not_followed(client: RegistryClient, location: str, message: str) -> None:
    with (
        serve(lambda _: Reply(302, headers={"Location": location})) as server,
        pytest.raises(InfrastructureError) as caught,
    ):
        client.find_manifest(f"{server.address}/robot")
    assert message in str(caught.value)


def test_a_manifest_is_not_sent_on(client: RegistryClient) -> None:
    with (
        serve(lambda _: Reply(307, headers={"Location": "/x"})) as server,
        pytest.raises(InfrastructureError, match="redirects a PUT to"),
    ):
        client.put_manifest(f"{server.address}/robot:v1", Manifest(DIGEST, DOCKER, CONTENT))


@pytest.mark.parametrize(
    ("reply", "error", "message"),
    [
        (Reply(201), None, ""),
        (Reply(201, headers={"Docker-Content-Digest": DIGEST}), None, ""),
        (
            Reply(201, headers={"Docker-Content-Digest": OTHER}),
            InfrastructureError,
            f"the registry keeps {OTHER}, not {DIGEST}",
        ),
        (Reply(403), InputError, "denies access (403); not logged in"),
        (
            Reply(400, b'{"errors": [{"code": "TAG_INVALID", "message": "tag is immutable"}]}'),
            InputError,
            "the registry refuses it: 400 (TAG_INVALID: tag is immutable)",
        ),
        (Reply(302), InfrastructureError, "the registry refuses it: 302"),
    ],
)
def test_a_tag_for_an_image(
    client: RegistryClient, reply: Reply, error: type[CalibrationError] | None, message: str
) -> None:
    manifest = Manifest(DIGEST, DOCKER, CONTENT)
    with serve(lambda _: reply) as server:
        name = f"{server.address}/robot:v1"
        if error is None:
            client.put_manifest(name, manifest)
            return
        with pytest.raises(error) as caught:
            client.put_manifest(name, manifest)
    assert str(caught.value).startswith(f"{name}: ")
    assert message in str(caught.value)


@pytest.mark.parametrize("status", [400, 401, 403, 418, 500])
def test_no_message_quotes_a_secret(status: int) -> None:
    """A registry whose errors quote the whole request."""
    registry = TokenRegistry()

    def answer(request: Request) -> Reply:
        if request.path.startswith("/token") or request.authorization is None:
            return registry(request)
        said = f"{request.authorization} {PASSWORD} {BASIC} {registry.token}"
        return Reply(status, json.dumps({"errors": [{"code": "E", "message": said}]}).encode())

    with serve(answer) as server, RegistryClient(user(server), pause=lambda _: None) as client:
        registry.address = server.address
        name = f"{server.address}/robot:v1"
        for call in (
            client.read_manifest,
            lambda name: client.put_manifest(name, Manifest(DIGEST, OCI, b"")),
        ):
            with pytest.raises(CalibrationError) as caught:
                call(name)  # type: ignore[operator]
            text = f"{caught.value}{caught.value.__context__}"
            assert "***" in text
            for secret in (PASSWORD, registry.token, BASIC.partition(" ")[2]):
                assert secret not in text
    assert PASSWORD not in repr(user(server))


def test_a_proxy_of_the_environment_is_not_asked_for_this_machine(
    client: RegistryClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    with serve(denial) as proxy, serve(lambda _: FINE) as server:
        for name in ("http_proxy", "https_proxy", "all_proxy", "HTTP_PROXY", "ALL_PROXY"):
            monkeypatch.setenv(name, f"http://{proxy.address}")
        for name in ("no_proxy", "NO_PROXY"):
            monkeypatch.delenv(name, raising=False)
        assert client.find_manifest(f"{server.address}/robot") == DIGEST
        with RegistryClient(
            Credentials("registry.test", insecure=True), timeouts=Timeouts(connect=2, silence=2)
        ) as other:
            assert other.find_manifest("registry.test/robot") is None  # the proxy answered
    assert proxy.paths() == ["HEAD http://registry.test/v2/robot/manifests/latest"]


def test_docker_hub_is_asked_where_it_answers(client: RegistryClient, monkeypatch: pytest.MonkeyPatch) -> None:
    with serve(lambda _: Reply(503)) as proxy:
        monkeypatch.setenv("https_proxy", f"http://{proxy.address}")
        with pytest.raises(InfrastructureError, match=r"registry-1\.docker\.io: no answer"):
            client.find_manifest("debian:bookworm")
