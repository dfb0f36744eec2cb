"""What coverage is of: a commit, the files that count, which are tracked source files and no tests, and functions.

Of a function: where it is, which lines are its alone, and whether it has anything to test.
"""

import ast
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from calibration.base import InputError, one_line, shorten
from calibration.ci.git import Repository, is_commit
from calibration.ci.workflow.runner import Event

SUFFIXES_OF_LANGUAGE = {
    "c": (".c",),
    "cpp": (".cc", ".cpp", ".cxx", ".h", ".hh", ".hpp", ".hxx", ".ipp", ".tpp"),
    "csharp": (".cs",),
    "go": (".go",),
    "java": (".java",),
    "javascript": (".js", ".jsx", ".mjs", ".cjs"),
    "kotlin": (".kt",),
    "php": (".php",),
    "python": (".py", ".pyw"),
    "ruby": (".rb",),
    "rust": (".rs",),
    "scala": (".scala",),
    "shell": (".sh", ".bash"),
    "swift": (".swift",),
    "typescript": (".ts", ".tsx"),
}
"""Suffixes by language, in Codacy's names."""
PYTHON_LANGUAGE = "python"
_LANGUAGE_OF_SUFFIX = {suffix: language for language, suffixes in SUFFIXES_OF_LANGUAGE.items() for suffix in suffixes}
NO_SOURCES = (
    *("**/test", "**/tests", "**/test_*.*", "**/*_test.*", "**/*_tests.*", "**/conftest.py"),
    *("**/setup.py", "**/noxfile.py", "**/docs/conf.py", "**/doc/conf.py"),
)
"""Default of ``exclude``, as git patterns: tests, build scripts and configuration of documentation."""


def language_of(path: str) -> str | None:
    """Return the language of a file by its suffix; None if it is not source code."""
    return _LANGUAGE_OF_SUFFIX.get(PurePosixPath(path).suffix.lower())


@dataclass(frozen=True)
class Sources:
    """Files that count for coverage."""

    repository: Repository
    directory: Path
    """Working directory of the tests."""
    folders: tuple[str, ...]
    """Folders and files that the user named, relative to the root; none for the whole repository."""
    tracked: Sequence[str]
    """Every tracked file."""
    counted: Sequence[str]
    """Every file that counts."""

    def measured(self) -> list[str]:
        """Return the sources for coverage.py: folders, and packages, which may be imported from an installed copy."""
        root = self.repository.root
        named = [root / folder for folder in self.folders or (".",)]
        # Of a file its folder, since coverage.py takes files for names of packages; what counts is chosen later.
        folders = dict.fromkeys(str(path if path.is_dir() else path.parent) for path in named)
        return [*folders, *self._top_packages()]

    def _top_packages(self) -> list[str]:
        folders = {str(PurePosixPath(path).parent) for path in self.counted if path.endswith("/__init__.py")}
        return sorted(
            PurePosixPath(folder).name for folder in folders if str(PurePosixPath(folder).parent) not in folders
        )


def find_sources(
    repository: Repository, directory: Path, named: Iterable[Path], exclude: Iterable[str] | None
) -> Sources:
    """Find the files that count.

    Args:
        repository: the repository of the directory.
        directory: working directory of the tests.
        named: folders and files of sources, relative to it.
        exclude: git patterns of files that do not count; None for :data:`NO_SOURCES`.

    Raises:
        InputError: a source is outside of the repository, or contains no tracked source file.
    """
    folders = []
    for path in named:
        inside = repository.path(directory / path)
        if inside is None:
            raise InputError(f"source: {path}: found a path outside of the repository {repository.root}")
        folders.append(inside)
    # Folders are filtered here: git 2.39 fails if they are combined with patterns to exclude.
    candidates = list(filter(language_of, repository.tracked(NO_SOURCES if exclude is None else exclude)))
    for folder in folders or (".",):
        if not any(_lies_in(path, folder) for path in candidates):
            raise InputError(f"source: {folder}: no source file was found there that git tracks and exclude leaves in")
    counted = [path for path in candidates if any(_lies_in(path, folder) for folder in folders or (".",))]
    return Sources(repository, directory, tuple(folders), repository.tracked(), counted)


def find_commit(given: str | None, event: Event, repository: Repository) -> tuple[str, str]:
    """Return the commit to report coverage for, and the source of that information.

    For a pull request it is the head commit, not the merge commit that GitHub creates for testing. For
    ``pull_request_target`` it is the commit that is checked out, by default the base.

    Raises:
        InputError: the given commit is not a full hash, or no commit is known.
    """
    if given is not None:
        if not is_commit(given.lower()):
            raise InputError(f"commit: found {shorten(one_line(given))!r}, expected a hash of 40 hexadecimal digits")
        return given.lower(), "as given"
    head = repository.head()
    pull_request = event.pull_request_commit
    candidates = [
        (None if event.checks_out_base else pull_request, "the pull request's last"),
        (event.followed_commit, "that of the workflow that this one follows"),
    ]
    if event.checks_out_base and head is not None:
        merged = pull_request is not None and pull_request in repository.parents(head)
        candidates.append((pull_request if merged else head, "the one that is checked out"))
    candidates += [(event.commit, "GITHUB_SHA"), (head, "the one that is checked out")]
    for sha, source in candidates:
        if sha is not None and is_commit(sha):
            return sha, source
    raise InputError("commit is not given, and there is no checkout: set commit, or check out the repository")


def _lies_in(path: str, folder: str) -> bool:
    return folder in (".", path) or path.startswith(f"{folder}/")


CACHES = ("cache", "lru_cache", "cached_property", "cached", "memoize")
"""Decorators after which a call may not run the function."""
UNTESTED_NAMES = ("__repr__", "__str__", "__hash__", "__del__", "__format__", "__dir__", "__getstate__", "__sizeof__")
"""Special methods that are written for people or for Python, and that tests run by the way."""
WITHOUT_EFFECT = ("abstractmethod", "overload", "abstractproperty")
"""Decorators of functions whose body is not meant to run."""


@dataclass(frozen=True)
class PythonFunction:
    """A function or method of a Python file."""

    path: str
    """Of its file, in the repository."""
    name: str
    """With the classes and functions around it: ``Arm.move``."""
    line: int
    """Line of ``def``."""
    column: int
    first: int
    """First line, that of the first decorator if there are any."""
    last: int
    own_lines: frozenset[int]
    """Lines of its body that belong to no function within it; empty if the body begins in the line of ``def``."""
    trivial: bool
    """Whether it has nothing to test: an empty body, a constant, a getter, a setter, text for people."""
    decorators: tuple[str, ...]
    """Names, without modules and arguments."""
    generator: bool
    parameters: tuple[str, ...]
    """Names of the arguments, in the order of the signature."""
    fields: tuple[str, ...] = ()
    """Attributes of its first argument that it sets."""


def functions_of(path: str, source: bytes) -> list[PythonFunction]:
    """Return the functions of a file in the order of their lines; none if this Python cannot parse it."""
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return []
    return sorted(_functions_in(tree, path, ()), key=lambda each: (each.line, each.column))


def _functions_in(node: ast.AST, path: str, names: tuple[str, ...]) -> Iterator[PythonFunction]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            yield _function_of(child, path, names)
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield from _functions_in(child, path, (*names, child.name))
        else:
            yield from _functions_in(child, path, names)


def _function_of(node: ast.FunctionDef | ast.AsyncFunctionDef, path: str, names: tuple[str, ...]) -> PythonFunction:
    decorators = tuple(filter(None, map(_name_of_decorator, node.decorator_list)))
    last = node.end_lineno or node.lineno
    own = set(range(node.body[0].lineno, last + 1)) if node.body[0].lineno > node.lineno else set()
    for inner in _inner_functions(node):
        own -= set(range(inner.body[0].lineno, (inner.end_lineno or inner.lineno) + 1))
    arguments = node.args
    ordered = [*arguments.posonlyargs, *arguments.args, arguments.vararg, *arguments.kwonlyargs, arguments.kwarg]
    parameters = tuple(each.arg for each in ordered if each is not None)
    return PythonFunction(
        path,
        ".".join((*names, node.name)),
        node.lineno,
        node.col_offset,
        min([node.lineno, *(each.lineno for each in node.decorator_list)]),
        last,
        frozenset(own),
        node.name in UNTESTED_NAMES or bool(set(decorators) & set(WITHOUT_EFFECT)) or _has_nothing_to_test(node.body),
        decorators,
        any(isinstance(each, ast.Yield | ast.YieldFrom) for each in _own_nodes(node)),
        parameters,
        tuple(dict.fromkeys(_fields_set(node, parameters[0]))) if parameters else (),
    )


def _own_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes within a function that belong to no function or class within it."""
    for child in ast.iter_child_nodes(node):
        yield child
        if not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda | ast.ClassDef):
            yield from _own_nodes(child)


def _fields_set(node: ast.AST, name: str) -> Iterator[str]:
    """Yield the attributes of a variable that a function sets."""
    for each in _own_nodes(node):
        match each:
            case ast.Attribute(value=ast.Name(id=found), ctx=ast.Store()) if found == name:
                yield each.attr


def _inner_functions(node: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for child in ast.walk(node):
        if child is not node and isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            yield child


def _name_of_decorator(node: ast.expr) -> str:
    while isinstance(node, ast.Call):
        node = node.func
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def _has_nothing_to_test(body: list[ast.stmt]) -> bool:
    """Return whether a body is empty, only raises, or only returns a constant or gets or sets one attribute."""
    statements = [each for each in body if not isinstance(each, ast.Pass) and not _is_constant_expression(each)]
    if not statements:
        return True
    if len(statements) > 1:
        return False
    match statements[0]:
        case ast.Raise() | ast.Return(value=None | ast.Constant()):
            return True
        case ast.Return(value=ast.Attribute(value=ast.Name())):
            return True
        case ast.Assign(targets=[ast.Attribute(value=ast.Name())], value=ast.Name()):
            return True
    return False


def _is_constant_expression(statement: ast.stmt) -> bool:
    """Return whether a statement is a docstring or an ellipsis."""
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
