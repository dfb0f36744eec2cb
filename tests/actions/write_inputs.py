"""Writes what is declared once where it is shown: `make actions`.

The inputs that the commands declare go into every action.yml and the README, the records into the JSON Schemas that
ship. `test_contract.py` holds the files to them.
"""

import json
import re
from pathlib import Path

import click
import yaml

from calibration.__main__ import load_command
from calibration.commands.schema import SCHEMAS, generated

PROJECT = Path(__file__).resolve().parents[2]
README = PROJECT / "README.md"
FILES = {"run": PROJECT / "action.yml"} | {path.parent.name: path for path in PROJECT.glob("actions/*/action.yml")}
COMMENT = {
    "comment": "keep: one comment on the pull request is kept up to date; delete: it is removed (no comment).",
    "token": "For the comment: github.token of a job with permissions: pull-requests: write.",
}
"""Inputs of the root action's second step."""
PYTHON = "A Python >= 3.11 that has the packages of requirements/{lock}; nothing is installed then."


def options(name: str) -> dict[str, click.Option]:
    """Return the options of a command by the name that an input has."""
    params = load_command(name).params
    return {option.opts[0].removeprefix("--"): option for option in params if isinstance(option, click.Option)}


def with_inputs(text: str, name: str, lock: str) -> str:
    """Return the text of an action.yml with the inputs of the command, and the one for the interpreter."""
    inputs = env = ""
    for option, declared in options(name).items():
        inputs += f"  {option}:\n    description: {scalar(declared.help or '')}\n"
        inputs += "    required: true\n" if declared.required else ""
    for option, text_of in COMMENT.items() if name == "run" else ():
        inputs += f"  {option}:\n    description: {scalar(text_of)}\n"
    inputs += f"  python:\n    description: {scalar(PYTHON.format(lock=lock))}\n"
    for option in [*options(name), "python"]:
        env += f"        INPUT_{option.upper().replace('-', '_')}: ${{{{ inputs.{option} }}}}\n"
    text = re.sub(r"(?<=^inputs:\n).*?(?=^\n)", lambda _: inputs, text, flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"(?<=^      env:\n)(?: {8}.*\n)+", lambda _: env, text, count=1, flags=re.MULTILINE)


def with_tables(readme: str) -> str:
    """Return the README with a table of inputs and one of outputs for each action between its marks."""
    return re.sub(
        r"(?<=<!-- inputs: )(\S+)( -->\n).*?(?=<!-- end -->)",
        lambda found: f"{found[1]}{found[2]}{tables(found[1])}",
        readme,
        flags=re.DOTALL,
    )


def tables(name: str) -> str:
    """Return what an action takes and gives, as its action.yml says."""
    action = yaml.safe_load(FILES[name].read_text())
    text = ""
    for kind in ("inputs", "outputs"):
        text += f"| {kind[:-1]} | |\n| --- | --- |\n"
        for key, entry in action[kind].items():
            text += f"| `{key}` | {entry['description'].replace('*', '&#42;')} |\n"
        text += "\n"
    return text


def scalar(text: str) -> str:
    """Return a text as YAML writes it in a line, quoted where it must be."""
    try:
        plain = yaml.safe_load(f"key: {text}") == {"key": text}
    except yaml.YAMLError:
        plain = False
    return text if plain else json.dumps(text, ensure_ascii=False)


def lock_of(name: str) -> str:
    """Return the lock of an action, as bootstrap.py states it."""
    [lock] = re.findall(
        rf'^    "{name}": \(".*", "(.*)"\)', (PROJECT / "actions/bootstrap.py").read_text(), re.MULTILINE
    )
    return str(lock)


def schema_file(name: str) -> Path:
    """Return the file in which a schema ships."""
    shipped = SCHEMAS[name]
    return PROJECT / shipped.package.replace(".", "/") / shipped.file


if __name__ == "__main__":
    for schema in SCHEMAS:
        schema_file(schema).write_text(generated(schema))
    for name, path in FILES.items():
        path.write_text(with_inputs(path.read_text(), name, lock_of(name)))
    README.write_text(with_tables(README.read_text()))
