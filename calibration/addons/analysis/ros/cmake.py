"""CMakeLists.txt as a list of commands, with the variables whose values are written in it."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from calibration.addons.analysis.ros.tree import Tree, join

_TOKEN_OUTSIDE_QUOTES = re.compile(r'\s+|\(|\)|(?:\\[\s\S]|\$\{[^}\s]{0,200}\}|[^\s()"#\\])+|["#\\]')
_OPENING_BRACKET = re.compile(r"\[(=*)\[")
_VARIABLE_REFERENCE = re.compile(r"\$\{([A-Za-z0-9_./+-]+)\}")
_MAX_EXPANDED_LENGTH = 2_000
"""Limit of characters of an argument in which variables are expanded."""
_MAX_LIST_LENGTH = 20_000
"""Limit of characters of a variable's values."""
_MAX_STEPS = 300_000
"""Limit of commands and their arguments, with those of unrolled loops and included folders."""
_MAX_LOOP_DEPTH = 20
"""Limit of loops in loops."""
_FOLDER_VARIABLES = ("CMAKE_CURRENT_SOURCE_DIR", "CMAKE_CURRENT_LIST_DIR")
_ROOT_VARIABLES = ("CMAKE_SOURCE_DIR", "PROJECT_SOURCE_DIR")
_REPOSITORY_ROOT = "/repository"
"""Stands for the root of the repository in absolute paths."""
CATKIN_PACKAGE_KEYWORDS = ("INCLUDE_DIRS", "LIBRARIES", "CATKIN_DEPENDS", "DEPENDS", "CFG_EXTRAS", "EXPORTED_TARGETS")
_END_OF_BLOCK = {"foreach": "endforeach", "function": "endfunction", "macro": "endmacro"}


@dataclass(frozen=True)
class Argument:
    """Argument of a command; its text has unresolved variables as they are written."""

    text: str
    line: int
    is_quoted: bool = False

    @property
    def is_known(self) -> bool:
        """Whether its value is written in the file."""
        return "$" not in self.text


@dataclass(frozen=True)
class CMakeCommand:
    """Command, with its arguments after the expansion of variables."""

    name: str
    """Name of the command in lower case."""
    arguments: tuple[Argument, ...]
    path: str
    line: int
    folder: str
    """Folder of its CMakeLists.txt."""

    @property
    def texts(self) -> tuple[str, ...]:
        """The texts of the arguments."""
        return tuple(each.text for each in self.arguments)

    def place(self, text: str) -> str | None:
        """Return the path in the repository of a path in the command; None if it is outside, or not known."""
        if "$" in text or "*" in text or (text.startswith("/") and not text.startswith(_REPOSITORY_ROOT)):
            return None
        return (
            join("", text.removeprefix(_REPOSITORY_ROOT))
            if text.startswith(_REPOSITORY_ROOT)
            else join(self.folder, text)
        )

    def after(self, keyword: str, keywords: Sequence[str]) -> list[Argument]:
        """Return the arguments between a keyword and the next one of ``keywords``."""
        found, inside = [], False
        for each in self.arguments:
            if each.text == keyword:
                inside = True
            elif each.text in keywords:
                inside = False
            elif inside:
                found.append(each)
        return found


@dataclass
class _State:
    """State of the expansion of one package's files."""

    tree: Tree
    variables: dict[str, list[str]] = field(default_factory=dict)
    commands: list[CMakeCommand] = field(default_factory=list)
    seen: dict[str, None] = field(default_factory=dict)
    steps: int = 0

    def assign(self, name: str, values: Sequence[str]) -> None:
        """Set a variable, to no more text than is expanded."""
        kept, size = [], 0
        for value in values:
            size += len(value) + 1
            if size > _MAX_LIST_LENGTH:
                kept.append("${" + name + "}")  # the rest is unknown
                break
            kept.append(value)
        self.variables[name] = kept


def read_cmake(tree: Tree, folder: str) -> list[CMakeCommand]:
    """Return the commands of a folder's CMakeLists.txt and of the folders that it adds.

    Loops over written values are unrolled; bodies of functions and macros are left out.
    """
    state = _State(tree)
    _include_folder(state, folder)
    return state.commands


def _include_folder(state: _State, folder: str) -> None:
    path = f"{folder}/CMakeLists.txt" if folder else "CMakeLists.txt"
    if path in state.seen or path not in state.tree.present or len(state.seen) > 200:
        return
    state.seen[path] = None
    commands = [
        CMakeCommand(name, arguments, path, line, folder) for name, arguments, line in parse(state.tree.text(path))
    ]
    root = next(iter(state.seen)).rpartition("/")[0]
    for name, value in (*((each, folder) for each in _FOLDER_VARIABLES), *((each, root) for each in _ROOT_VARIABLES)):
        state.variables[name] = [f"{_REPOSITORY_ROOT}/{value}"]
    _run_commands(state, commands, 0)


def _run_commands(state: _State, commands: Sequence[CMakeCommand], depth: int) -> None:
    at = 0
    while at < len(commands) and state.steps < _MAX_STEPS:
        state.steps += 1
        command = commands[at]
        if (end := _END_OF_BLOCK.get(command.name)) is not None:
            last = _find_end(commands, at, command.name, end)
            if command.name == "foreach" and depth < _MAX_LOOP_DEPTH:
                _unroll_loop(state, command, commands[at + 1 : last], depth)
            at = last + 1
            continue
        _run_command(state, command)
        at += 1


def _find_end(commands: Sequence[CMakeCommand], at: int, name: str, end: str) -> int:
    depth = 0
    for index in range(at, len(commands)):
        depth += (commands[index].name == name) - (commands[index].name == end)
        if depth == 0:
            return index
    return len(commands)


def _unroll_loop(state: _State, command: CMakeCommand, body: Sequence[CMakeCommand], depth: int) -> None:
    """Run the body of a loop for each value; once with an unknown value if the values are not written."""
    words = [each.text for each in _expand_variables(command.arguments, state.variables)]
    if not words:
        return
    variable, values = words[0], words[1:]
    if values[:1] == ["IN"]:
        lists = command.arguments[2:]
        values, kind = [], ""
        for each in lists:
            if each.text in ("LISTS", "ITEMS"):
                kind = each.text
            elif kind == "LISTS":
                values += state.variables.get(each.text, ["${" + each.text + "}"])
            else:
                values += [one.text for one in _expand_variables([each], state.variables)]
    before = state.variables.get(variable)
    for value in values[:500] or ["${" + variable + "}"]:
        if value == "${" + variable + "}":
            state.variables.pop(variable, None)
        else:
            state.variables[variable] = [value]
        state.steps += 1
        _run_commands(state, body, depth + 1)
        if state.steps >= _MAX_STEPS:
            break
    if before is None:
        state.variables.pop(variable, None)
    else:
        state.variables[variable] = before


def _run_command(state: _State, command: CMakeCommand) -> None:
    arguments = _expand_variables(command.arguments, state.variables)
    state.steps += len(arguments)
    expanded = CMakeCommand(command.name, tuple(arguments), command.path, command.line, command.folder)
    state.commands.append(expanded)
    words = list(expanded.texts)
    if command.name == "set" and words:
        values = [word for word in words[1:] if word != "PARENT_SCOPE"]
        if "CACHE" in values:
            values = values[: values.index("CACHE")]
        state.assign(words[0], [part for value in values for part in value.split(";")])
    elif command.name == "list" and words[:1] == ["APPEND"] and len(words) > 1:
        state.assign(words[1], [*state.variables.get(words[1], []), *words[2:]])
    elif command.name == "project" and words:
        state.variables.setdefault("PROJECT_NAME", [words[0]])
        state.variables.setdefault("CMAKE_PROJECT_NAME", [words[0]])
    elif command.name == "file" and words[:1] and words[0].startswith("GLOB") and len(words) > 1:
        state.variables[words[1]] = ["${" + words[1] + "}"]  # what a pattern finds is not written
    elif command.name == "add_subdirectory" and words:
        below = expanded.place(words[0])
        if below is not None:
            _include_folder(state, below)
            for name in _FOLDER_VARIABLES:
                state.variables[name] = [f"{_REPOSITORY_ROOT}/{command.folder}"]


def _expand_variables(arguments: Sequence[Argument], variables: Mapping[str, list[str]]) -> list[Argument]:
    found: list[Argument] = []
    for each in arguments:
        whole = _VARIABLE_REFERENCE.fullmatch(each.text)
        if whole and whole[1] in variables and not each.is_quoted:
            found += [Argument(value, each.line) for value in variables[whole[1]]]
            continue
        text = each.text
        for _ in range(5):
            new = _VARIABLE_REFERENCE.sub(lambda match: ";".join(variables.get(match[1], [match[0]])), text)
            if new == text or len(new) > _MAX_EXPANDED_LENGTH:
                break
            text = new
        parts = [text] if each.is_quoted else [part for part in text.split(";") if part]
        found += [Argument(part, each.line, each.is_quoted) for part in parts]
    return found


def parse(text: str) -> Iterator[tuple[str, tuple[Argument, ...], int]]:
    """Yield name, arguments and line of every command; the rest of a file that does not parse is left out."""
    name, line, depth = "", 0, 0
    arguments: list[Argument] = []
    for kind, token, at in _split_tokens(text):
        if kind == "(":
            depth += 1
        elif kind == ")":
            depth -= 1
            if depth == 0 and name:
                yield name.lower(), tuple(arguments), line
            if depth <= 0:
                name, arguments, depth = "", [], 0
        elif depth == 0:
            name, line, arguments = token, at, []
        else:
            arguments.append(Argument(token, at, kind == "text"))


def _split_tokens(text: str) -> Iterator[tuple[str, str, int]]:
    """Yield kind (``(``, ``)``, word, or text in quotes), text and line; stop at an open quote or bracket."""
    at, line = 0, 1
    while at < len(text):
        comment = text[at] == "#"
        bracket = _OPENING_BRACKET.match(text, at + comment)
        if bracket:
            end = text.find(f"]{bracket[1]}]", bracket.end())
            if end < 0:
                return
            if not comment:
                yield "text", text[bracket.end() : end], line
            end += len(bracket[1]) + 2
        elif comment:
            end = text.find("\n", at)
            end = len(text) if end < 0 else end
        elif text[at] == '"':
            end = at + 1
            while end < len(text) and text[end] != '"':
                end += 2 if text[end] == "\\" else 1
            if end >= len(text):
                return
            yield "text", text[at + 1 : end], line
            end += 1
        else:
            token = _TOKEN_OUTSIDE_QUOTES.match(text, at)
            if token is None:
                return
            end = token.end()
            if token[0] in "()":
                yield token[0], token[0], line
            elif not token[0].isspace():
                yield "word", token[0], line
        line += text.count("\n", at, end)
        at = end
