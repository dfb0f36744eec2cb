import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InputError
from calibration.ci.registries.reference import Reference, check_tag, parse_reference

DIGEST = "sha256:" + "0123456789abcdef" * 4


@pytest.mark.parametrize(
    ("text", "registry", "repository", "tag", "digest"),
    [
        ("debian", "docker.io", "library/debian", None, None),
        ("debian:bookworm", "docker.io", "library/debian", "bookworm", None),
        ("host:5000", "docker.io", "library/host", "5000", None),
        ("team/robot", "docker.io", "team/robot", None, None),
        ("docker.io/debian", "docker.io", "library/debian", None, None),
        ("docker.io/library/ros:humble-ros-base", "docker.io", "library/ros", "humble-ros-base", None),
        ("index.docker.io/team/robot:1", "docker.io", "team/robot", "1", None),
        ("ghcr.io/team/a/b__c.d-e:v1.0", "ghcr.io", "team/a/b__c.d-e", "v1.0", None),
        ("127.0.0.1:5000/robot", "127.0.0.1:5000", "robot", None, None),
        ("localhost/robot:x", "localhost", "robot", "x", None),
        ("localhost:5000/team/robot:x", "localhost:5000", "team/robot", "x", None),
        ("[::1]:5000/robot", "[::1]:5000", "robot", None, None),
        ("Registry/robot", "Registry", "robot", None, None),
        (f"a.b/c@{DIGEST}", "a.b", "c", None, DIGEST),
        (f"a.b:1/c:t@{DIGEST}", "a.b:1", "c", "t", DIGEST),
        ("012345678901.dkr.ecr.eu-west-1.amazonaws.com/robot", "012345678901.dkr.ecr.eu-west-1.amazonaws.com",
         "robot", None, None),
    ],
)  # fmt: skip
def test_parts(text: str, registry: str, repository: str, tag: str | None, digest: str | None) -> None:
    assert parse_reference(text) == Reference(registry, repository, tag, digest)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "'library/' is no repository"),
        ("Robot", "'library/Robot' is no repository"),
        ("ghcr.io/Team/robot", "'Team/robot' is no repository"),
        ("ghcr.io/team//robot", "is no repository"),
        ("ghcr.io/../robot", "is no repository"),
        ("ghcr.io/team/robot:", "found the tag ''"),
        ("ghcr.io/team/robot:a b", "found the tag 'a b'"),
        ("ghcr.io/team/robot:" + "a" * 129, "found the tag 'aaa"),
        ("ghcr.io/team/robot:-x", "found the tag '-x'"),
        ("ghcr.io/team/robot@sha256:12", "'sha256:12' is no digest"),
        (f"ghcr.io/team/robot@{DIGEST.upper()}", "is no digest"),
        ("ghcr.io/team/robot@", "'' is no digest"),
        ("https://ghcr.io/team/robot", "'https:' is no registry"),
        ("user@ghcr.io/team/robot", "is no digest"),
        ("ghcr.io:port/robot", "'ghcr.io:port' is no registry"),
        ("-a.b/robot", "'-a.b' is no registry"),
        ("ghcr.io/" + "a" * 250, "more than 255 characters"),
        ("robot\nRUN evil", "is no repository"),
        ("robot:a\n", "found the tag"),
    ],
)
def test_invalid_names(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_reference(text)
    assert message in str(caught.value)


part = st.from_regex(r"[a-z0-9]+((\.|__?|-+)[a-z0-9]+)*", fullmatch=True).filter(lambda text: len(text) < 30)
host = st.from_regex(r"[a-z0-9]([a-z0-9-]*[a-z0-9])?\.[a-z]{2,5}(:[0-9]{1,5})?", fullmatch=True)
references = st.builds(
    Reference,
    host.filter(lambda text: len(text) < 60 and not text.endswith("docker.io")),
    st.lists(part, min_size=1, max_size=4).map("/".join),
    st.none() | st.from_regex(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,20}", fullmatch=True),
    st.none() | st.just(DIGEST),
)


@given(references)
def test_round_trip(reference: Reference) -> None:
    assert parse_reference(str(reference)) == reference


@given(st.lists(part, min_size=1, max_size=3).map("/".join))
def test_the_name_of_an_image_of_docker_hub_is_the_short_one(path: str) -> None:
    first, slash, _ = path.partition("/")
    if slash and ("." in first or first == "localhost"):
        return
    name = parse_reference(path).name
    assert name == path.removeprefix("library/") or path == "library/" + name
    assert parse_reference(f"docker.io/{path}").name == name


@given(st.text())
def test_any_text_is_a_name_or_refused_in_one_line(text: str) -> None:
    refusal = None
    try:
        reference = parse_reference(text)
    except InputError as error:
        refusal = str(error)
    assert parse_reference(str(reference)) == reference if refusal is None else refusal.isprintable()


def test_another_tag_or_digest_of_the_same_repository() -> None:
    reference = parse_reference(f"ghcr.io/team/robot:v1@{DIGEST}")
    assert str(reference.with_tag("stable")) == "ghcr.io/team/robot:stable"
    assert str(reference.with_digest(DIGEST)) == f"ghcr.io/team/robot@{DIGEST}"
    with pytest.raises(InputError, match="a digest such as"):
        reference.with_digest("v1")
    with pytest.raises(InputError, match="found the tag"):
        check_tag("a/b")
