"""No program runs but git's own: neither one that a committed folder names, nor one of the repository's settings.

Each setting is first shown to run its program where git is called plainly, where a command of git's does so.
"""

import shlex
import shutil
import ssl
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from calibration.base import CalibrationError, InputError
from calibration.ci.git import Repository
from calibration.ci.image.context import build_labels
from tests.repositories import WHO, commit, git

MISSING = "1" * 40
FETCH = ("fetch", "--quiet", "origin", MISSING)


@dataclass(frozen=True)
class Trap:
    """A checkout, and a program that leaves a file when it runs."""

    root: Path
    sprung: Path
    program: Path

    def plainly(self, *arguments: str) -> bool:
        """Run git as anyone does, and return whether the program ran."""
        subprocess.run(
            ["git", *arguments],
            cwd=self.root,
            env={"PATH": "/usr/bin:/bin", "GIT_CONFIG_NOSYSTEM": "1", "GIT_TERMINAL_PROMPT": "0", **WHO},
            capture_output=True,
            check=False,
            timeout=20,
            stdin=subprocess.DEVNULL,
        )
        ran = self.sprung.exists()
        self.sprung.unlink(missing_ok=True)
        return ran

    def by_us(self) -> bool:
        """Call all that we ask of git, and return whether the program ran."""
        repository = Repository.around(self.root)
        calls: list[Callable[[], object]] = [
            repository.tracked,
            repository.links,
            repository.head,
            repository.origin,
            lambda: repository.parents("HEAD"),
            lambda: repository.commit(MISSING),
            lambda: repository.merge_base("HEAD", "HEAD~1"),
            lambda: repository.content("HEAD", "a.txt", 1000),
            lambda: list(repository.contents(["HEAD", MISSING], "a.txt", 1000)),
            lambda: repository.changes_of("a.txt"),
            lambda: repository.difference("HEAD"),
            lambda: repository.changed("HEAD~1"),
            lambda: repository.fetched(MISSING),
            lambda: build_labels("k", "s", {}, self.root, {}),
        ]
        for call in calls:
            with suppress(CalibrationError):
                call()
        return self.sprung.exists()

    def configure(self, text: str) -> None:
        """Append to the repository's own settings; ``TRAP`` is the program."""
        if "url = " in text:
            git(self.root, "remote", "remove", "origin")
        with (self.root / ".git/config").open("a") as file:
            file.write(text.replace("TRAP", str(self.program)))


@pytest.fixture
def trap(tmp_path: Path) -> Trap:
    root = tmp_path / "checkout"
    commit(root, {"a.txt": "one\n", "b.txt": "b\n"})
    commit(root, {"a.txt": "two\n"})
    git(tmp_path, "clone", "--quiet", "--bare", "checkout", "origin.git")
    git(root, "remote", "add", "origin", str(tmp_path / "origin.git"))
    (root / "a.txt").write_text("three\n")
    program = tmp_path / "program"
    program.write_text(f"#!/bin/sh\ntouch {tmp_path}/sprung\nexit 1\n")
    program.chmod(0o755)
    return Trap(root, tmp_path / "sprung", program)


def attributes(trap: Trap, text: str) -> None:
    (trap.root / ".gitattributes").write_text(text)


@pytest.mark.parametrize(
    ("settings", "attribute", "provoking"),
    [
        ("[core]\nfsmonitor = TRAP\n", "", ("status",)),
        ("[core]\nsshCommand = TRAP\n[remote.origin]\nurl = ssh://h/r\n", "", FETCH),
        ("[remote.origin]\nurl = h:r\n[core]\nsshCommand = TRAP\n", "", FETCH),
        ("[core]\ngitProxy = TRAP\n[remote.origin]\nurl = git://127.0.0.1/r\n", "", FETCH),
        ("[core]\npager = TRAP\n[pager]\nlog = TRAP\ndiff = TRAP\n", "", ()),
        ("[core]\neditor = TRAP\n[sequence]\neditor = TRAP\n", "", ("commit", "--allow-empty")),
        ('[remote "origin"]\nuploadpack = TRAP;\n', "", FETCH),
        ('[remote "origin"]\nurl = ext::TRAP\n[protocol "ext"]\nallow = always\n', "", FETCH),
        ('[remote "origin"]\nvcs = ext\nurl = TRAP\n[protocol]\nallow = always\n', "", FETCH),
        ('[url "ext::TRAP "]\ninsteadOf = /\n[protocol "ext"]\nallow = always\n', "", FETCH),
        ('[filter "f"]\nclean = TRAP\n', "* filter=f\n", ("diff", "HEAD")),
        ('[filter "f"]\nclean = TRAP\nrequired = true\n', "* filter=f\n", ("diff", "HEAD")),
        ('[filter "f"]\nprocess = TRAP\n', "* filter=f\n", ("diff", "HEAD")),
        ('[filter "f"]\nsmudge = TRAP\n', "* filter=f\n", ("checkout", "b.txt", "a.txt")),
        ('[filter "F.x é"]\nclean = TRAP\n', "", ()),
        ('[filter "[*"]\nclean = TRAP\n', "* filter=[*\n", ("diff", "HEAD")),
        ('[filter "A.b"]\nCLEAN = TRAP\n', "* filter=A.b\n", ("diff", "HEAD")),
        ('[diff "d"]\ntextconv = TRAP\n', "* diff=d\n", ("diff", "HEAD")),
        ('[diff "d"]\ncommand = TRAP\n', "* diff=d\n", ("diff", "HEAD")),
        ("[diff]\nexternal = TRAP\n", "", ("diff", "HEAD")),
        ('[merge "m"]\ndriver = TRAP\n', "* merge=m\n", ()),
        ("[alias]\nco = !TRAP\nlog = !TRAP\ndiff = !TRAP\n", "", ("co",)),
        ("[uploadpack]\npackObjectsHook = TRAP\n", "", ()),
        ("[gc]\nauto = 1\nautoDetach = false\nrecentObjectsHook = TRAP\n", "", ()),
        ('[submodule "b"]\nupdate = !TRAP\nactive = true\nurl = ./\n', "", ()),
        ('[hook "h"]\ncommand = TRAP\nevent = reference-transaction\n', "", ()),
        (
            """[core]\nrepositoryFormatVersion = 1\n[extensions]\npartialClone = p
            [remote "p"]\nurl = ./\npromisor = true\nuploadpack = TRAP;\n""",
            "",
            ("cat-file", "-p", MISSING),
        ),
    ],
)
def test_a_setting_of_the_repository_runs_nothing(
    trap: Trap, settings: str, attribute: str, provoking: tuple[str, ...]
) -> None:
    trap.configure(settings)
    attributes(trap, attribute)
    if provoking and "smudge" in settings:
        (trap.root / "a.txt").unlink()
    assert not provoking or trap.plainly(*provoking)
    assert not trap.by_us()


@pytest.mark.parametrize("how", ["include", "includeIf", "worktree", "chain"])
def test_settings_in_other_files_run_nothing(trap: Trap, how: str) -> None:
    """As those of .git/config do."""
    attributes(trap, "* filter=f\n")
    text = f'[filter "f"]\nclean = {trap.program}\n'
    (trap.root / "more").write_text(text)
    if how == "include":
        trap.configure("[include]\npath = ../more\n")
    elif how == "includeIf":
        trap.configure(f'[includeIf "gitdir:{trap.root}/"]\npath = ../more\n')
    elif how == "chain":
        (trap.root / "first").write_text("[include]\npath = more\n")
        trap.configure("[include]\npath = ../first\n")
    else:
        trap.configure("[extensions]\nworktreeConfig = true\n[core]\nrepositoryFormatVersion = 1\n")
        (trap.root / ".git/config.worktree").write_text(text)
    assert trap.plainly("diff", "HEAD")
    assert not trap.by_us()


def test_a_setting_whose_name_cannot_be_given_to_git_is_refused(trap: Trap) -> None:
    trap.configure('[filter "a=b"]\nclean = TRAP\n')
    attributes(trap, "* filter=a=b\n")
    assert trap.plainly("diff", "HEAD")
    with pytest.raises(InputError, match=r"the setting 'filter\.a=b\.clean' of git has a = in its name"):
        Repository.around(trap.root)
    assert not trap.sprung.exists()


@pytest.mark.parametrize("folder", [".git/hooks", "elsewhere"])
def test_hooks_do_not_run(trap: Trap, folder: str) -> None:
    hooks = trap.root / folder
    hooks.mkdir(exist_ok=True)
    for name in ("reference-transaction", "post-index-change", "pre-auto-gc", "post-checkout"):
        (hooks / name).write_bytes(trap.program.read_bytes())
        (hooks / name).chmod(0o755)
    if folder == "elsewhere":
        trap.configure(f"[core]\nhooksPath = {hooks}\n")
    trap.configure("[gc]\nauto = 1\n")
    assert trap.plainly("fetch", "--quiet", "origin")
    assert not trap.by_us()
    trap.plainly("update-ref", "-d", "refs/remotes/origin/main")
    Repository.around(trap.root).fetched("main")  # which updates that again
    assert git(trap.root, "rev-parse", "refs/remotes/origin/main")
    assert not trap.sprung.exists()


def test_the_command_that_lists_an_alternates_commits_does_not_run(trap: Trap, tmp_path: Path) -> None:
    (trap.root / ".git/objects/info/alternates").write_text(f"{tmp_path}/origin.git/objects\n")
    trap.configure("[core]\nalternateRefsCommand = TRAP\n")
    commit(trap.root.parent / "other", {"x": "x"})
    git(trap.root, "remote", "set-url", "origin", str(tmp_path / "other"))
    assert trap.plainly("fetch", "--quiet", "origin")
    assert not trap.by_us()


def test_the_program_that_checks_signatures_does_not_run(trap: Trap) -> None:
    text = git(trap.root, "cat-file", "commit", "HEAD").replace(
        "\n\n", "\ngpgsig -----BEGIN PGP SIGNATURE-----\n \n x\n -----END PGP SIGNATURE-----\n\n", 1
    )
    (trap.root / "text").write_text(f"{text}\n")
    signed = git(trap.root, "hash-object", "-t", "commit", "-w", "text")
    git(trap.root, "update-ref", "HEAD", signed)
    trap.configure("[log]\nshowSignature = true\n[gpg]\nprogram = TRAP\n")
    assert trap.plainly("log", "a.txt")
    assert not trap.by_us()


def test_submodules_are_not_fetched_with_their_own_settings(trap: Trap) -> None:
    commit(trap.root / "sub", {"x": "x"})
    git(trap.root, "add", "sub")
    git(trap.root, "commit", "-qm", "sub")
    (trap.root / ".gitmodules").write_text('[submodule "sub"]\npath = sub\nurl = ./sub\n')
    git(trap.root, "config", "submodule.sub.url", "./sub")
    git(trap.root, "config", "fetch.recurseSubmodules", "true")
    git(trap.root / "sub", "remote", "add", "origin", "./")
    git(trap.root / "sub", "config", "remote.origin.uploadpack", f"{trap.program};")
    git(trap.root / "sub", "config", "core.fsmonitor", str(trap.program))
    assert trap.plainly("fetch", "--quiet", "origin")
    assert not trap.by_us()
    repository = Repository.around(trap.root)
    [parent] = repository.parents("HEAD")
    repository.fetched(parent)
    assert not trap.sprung.exists()


@pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl")
@pytest.mark.parametrize("name", ["core.askPass", "credential.helper", "credential.https://127.0.0.1.helper", "url"])
def test_no_program_is_asked_for_a_password(trap: Trap, asking: int, name: str) -> None:
    name = f"credential.https://127.0.0.1:{asking}.helper" if name == "url" else name
    git(trap.root, "remote", "set-url", "origin", f"https://127.0.0.1:{asking}/r")
    git(trap.root, "config", "http.sslVerify", "false")
    git(trap.root, "config", name, str(trap.program))
    if "127.0.0.1.helper" not in name:  # which is for another port
        assert trap.plainly(*FETCH)
    with pytest.raises(InputError, match="cannot be fetched: could not read Username"):
        Repository.around(trap.root).fetched(MISSING)
    assert not trap.by_us()


@pytest.fixture
def asking(tmp_path: Path) -> Iterator[int]:
    """Port of a server that wants a password."""

    class Refusing(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(401)
            self.send_header("WWW-Authenticate", 'Basic realm="r"')
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    subject = shlex.split("req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=127.0.0.1")
    files = ("-keyout", str(tmp_path / "key"), "-out", str(tmp_path / "certificate"))
    subprocess.run(["openssl", *subject, *files], check=True, capture_output=True)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(tmp_path / "certificate", tmp_path / "key")
    server = ThreadingHTTPServer(("127.0.0.1", 0), Refusing)
    server.socket = context.wrap_socket(server.socket, server_side=True)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server.server_address[1]
    server.shutdown()
    server.server_close()


@pytest.mark.parametrize(
    "settings",
    [
        "[core]\nfsmonitor = TRAP\nworktree = ./\n",
        '[core]\nworktree = ./\n[remote "origin"]\nurl = ./\nuploadpack = TRAP;\n',
        '[core]\nworktree = ./\nsshCommand = TRAP\n[remote "origin"]\nurl = ssh://h/r\n',
        '[core]\nworktree = ./\n[protocol "ext"]\nallow = always\n[remote "origin"]\nurl = ext::TRAP\n',
    ],
)
def test_a_repository_that_is_committed_as_files_is_not_asked(trap: Trap, settings: str) -> None:
    """Git takes the folder for a repository; ours is the checkout around it."""
    below = trap.root / "below"
    commit(below, {"a.txt": "a\n", ".gitattributes": "* filter=f\n"})
    for path in (below / ".git").iterdir():
        path.rename(below / path.name)
    (below / ".git").rmdir()
    (below / "config").write_text(f"[core]\nrepositoryFormatVersion = 0\nbare = false\n{settings}")
    (below / "config").write_text((below / "config").read_text().replace("TRAP", str(trap.program)))
    (below / "a.txt").write_text("changed\n")
    inside = Trap(below, trap.sprung, trap.program)
    assert inside.plainly(*FETCH) or inside.plainly("diff", "HEAD")
    assert not inside.by_us()
    assert Repository.around(below).root == trap.root
    assert build_labels("k", "s", {}, below, {}) == build_labels("k", "s", {}, trap.root, {})


def test_a_folder_that_is_named_origin_is_not_fetched_from(trap: Trap) -> None:
    git(trap.root, "remote", "remove", "origin")
    git(trap.root, "clone", "--quiet", "--bare", ".", "origin")
    head = git(trap.root, "rev-parse", "HEAD")
    git(trap.root, "fetch", "--quiet", "origin", head)
    with pytest.raises(InputError, match="there is no remote 'origin'"):
        Repository.around(trap.root).fetched(head)


def test_an_origin_that_is_a_partial_clone_runs_nothing_of_its_settings(trap: Trap, tmp_path: Path) -> None:
    """The origin's own settings count where its objects are read."""
    origin = tmp_path / "origin.git"
    [blob] = git(origin, "rev-parse", "HEAD:a.txt").split()
    (origin / "objects" / blob[:2] / blob[2:]).unlink()
    git(origin, "config", "core.repositoryFormatVersion", "1")
    git(origin, "config", "extensions.partialClone", "p")
    git(origin, "config", "remote.p.promisor", "true")
    git(origin, "config", "remote.p.url", "./")
    git(origin, "config", "remote.p.uploadpack", f"{trap.program};")
    git(origin, "config", "uploadpack.packObjectsHook", str(trap.program))
    git(tmp_path, "init", "-q", "empty")
    git(tmp_path / "empty", "remote", "add", "origin", str(origin))
    with pytest.raises(InputError, match="cannot be fetched"):
        Repository.around(tmp_path / "empty").fetched(git(origin, "rev-parse", "HEAD"))
    assert not trap.sprung.exists()


def test_the_working_tree_is_the_folder_of_the_repository(trap: Trap) -> None:
    """Not the one that its settings name."""
    trap.configure("[core]\nworktree = /etc\n")
    assert git(trap.root, "rev-parse", "--show-toplevel") == "/etc"
    repository = Repository.around(trap.root)
    assert repository.root == trap.root
    assert repository.changed("HEAD") == ["a.txt"]


@pytest.mark.parametrize("kind", ["worktree", "submodule"])
def test_a_checkout_whose_git_is_elsewhere(trap: Trap, tmp_path: Path, kind: str) -> None:
    """A worktree and a submodule have a file ``.git``."""
    if kind == "worktree":
        git(trap.root, "worktree", "add", "--quiet", str(tmp_path / "second"))
        root = tmp_path / "second"
    else:
        git(trap.root, "-c", "protocol.file.allow=always", "submodule", "--quiet", "add", str(tmp_path / "origin.git"))
        root = trap.root / "origin"
    assert (root / ".git").is_file()
    repository = Repository.around(root)
    assert repository.tracked() == ["a.txt", "b.txt"]
    assert repository.head() == git(root, "rev-parse", "HEAD")


def test_a_partial_clone_does_not_read_a_folder_in_the_background(trap: Trap, tmp_path: Path) -> None:
    """Only https is used without being asked for."""
    git(tmp_path / "origin.git", "config", "uploadpack.allowFilter", "true")
    options = ("--quiet", "--no-checkout", "--filter=blob:none")
    git(tmp_path, "clone", *options, f"file://{tmp_path}/origin.git", "partial")
    assert Repository.around(tmp_path / "partial").content("HEAD", "a.txt", 100) is None
