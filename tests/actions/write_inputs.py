"""Writes what is declared once where it is shown: `make actions`.

The inputs that the commands declare go into every action.yml and its page in docs/, the records into the JSON
Schemas that ship and the pages of the configuration files, the headings of a page into its contents.
`test_contract.py` holds the files to them.
"""

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click
import yaml

from calibration.__main__ import load_command
from calibration.commands.parameters import ActionInput
from calibration.commands.schema import SHIPPED_SCHEMAS, generated

PROJECT = Path(__file__).resolve().parents[2]
README = PROJECT / "README.md"
PAGES = [README, *sorted(PROJECT.glob("docs/*.md"))]
FILES = {"run": PROJECT / "action.yml"} | {path.parent.name: path for path in PROJECT.glob("actions/*/action.yml")}
SHOWN = FILES | {"pipeline": PROJECT / ".github" / "workflows" / "pipeline.yml"}
"""Of what pages show the inputs."""
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


def deprecated(name: str) -> dict[str, str]:
    """Return what replaces the deprecated inputs of a command, by their names."""
    replaced = {}
    for option, declared in options(name).items():
        if isinstance(declared, ActionInput):
            replaced |= {option: f"the key {declared.instead} of calibration.yml"} if declared.instead else {}
            replaced |= {declared.formerly: option} if declared.formerly else {}
    return replaced


def with_inputs(text: str, name: str, lock: str) -> str:
    """Return the text of an action.yml with the inputs of the command, and the one for the interpreter.

    Deprecated ones have no deprecationMessage: the command tells of them on every runner, GitHub would tell once more.
    """
    inputs = env = ""
    replaced = deprecated(name)
    for option, declared in options(name).items():
        if option in replaced:
            continue
        inputs += f"  {option}:\n    description: {scalar(declared.help or '')}\n"
        former = isinstance(declared, ActionInput) and declared.formerly
        inputs += "    required: true\n" if declared.required and not former else ""
    for option, text_of in COMMENT.items() if name == "run" else ():
        inputs += f"  {option}:\n    description: {scalar(text_of)}\n"
    inputs += f"  python:\n    description: {scalar(PYTHON.format(lock=lock))}\n"
    for option, instead in replaced.items():
        inputs += f"  {option}:\n    description: {scalar(f'Deprecated: {instead}.')}\n"
    for option in [*(each for each in options(name) if each not in replaced), "python", *replaced]:
        env += f"        INPUT_{option.upper().replace('-', '_')}: ${{{{ inputs.{option} }}}}\n"
    text = re.sub(r"(?<=^inputs:\n).*?(?=^\n)", lambda _: inputs, text, flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"(?<=^      env:\n)(?: {8}.*\n)+", lambda _: env, text, count=1, flags=re.MULTILINE)


def with_parts(page: str) -> str:
    """Return a page of Markdown with what is generated between its marks: inputs, keys of a document, contents."""
    made = {"inputs": tables, "keys": keys, "contents": lambda _: contents(page)}
    return re.sub(
        r"(?<=<!-- )(inputs|keys|contents)((?:: \S+)?) -->\n.*?(?=<!-- end -->)",
        lambda found: f"{found[1]}{found[2]} -->\n{made[found[1]](found[2].removeprefix(': '))}",
        page,
        flags=re.DOTALL,
    )


def contents(page: str) -> str:
    """Return the contents of a page: a link to each of its headings of the second level."""
    text = re.sub(r"^```.*?^```", "", page, flags=re.DOTALL | re.MULTILINE)
    return "".join(f"- [{title}](#{anchor(title)})\n" for title in re.findall(r"^## (.*)$", text, re.MULTILINE))


def anchor(title: str) -> str:
    """Return the anchor that GitHub gives a heading."""
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


def keys(name: str) -> str:
    """Return a table of the keys of a document, as its JSON Schema describes them."""
    text = "| key | |\n| --- | --- |\n"
    for path, description in described_keys(name).items():
        text += f"| `{path}` | {description.replace('|', '&#124;').replace('*', '&#42;')} |\n"
    return text


def described_keys(name: str) -> dict[str, str]:
    """Return the descriptions of the keys of a document by their paths."""
    schema = json.loads(generated(name))
    return dict(_described(schema, schema, "", ()))


def _described(schema: Any, whole: Any, path: str, opened: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Each key below a part of a schema, as `a.b`, `a[].b` in a list, `a.NAME.b` under names of your own."""
    if (reference := schema.get("$ref")) and reference not in opened:
        of = whole["$defs"][reference.rpartition("/")[2]]
        yield from _described(of, whole, path, (*opened, reference))
    for key, value in schema.get("properties", {}).items():
        below = f"{path}.{key}" if path else key
        yield below, value.get("description", "")
        yield from _described(value, whole, below, opened)
    for part in (*schema.get("anyOf", []), *schema.get("allOf", [])):
        yield from _described(part, whole, path, opened)
    if isinstance(of_list := schema.get("items"), dict):
        yield from _described(of_list, whole, f"{path}[]", opened)
    if isinstance(of_names := schema.get("additionalProperties"), dict):
        yield from _described(of_names, whole, f"{path}.NAME", opened)


def tables(name: str) -> str:
    """Return what an action takes and gives, as its action.yml says."""
    action = yaml.safe_load(SHOWN[name].read_text())
    action = action if "inputs" in action else action[True]["workflow_call"]  # YAML 1.1 reads `on` as true
    text, old = "", dict[str, str]()
    for kind in (each for each in ("inputs", "secrets", "outputs") if each in action):
        text += f"| {kind[:-1]} | |\n| --- | --- |\n"
        for key, entry in action[kind].items():
            described = entry["description"].strip().replace("*", "&#42;").replace("|", "&#124;")
            if described.startswith("Deprecated: "):
                old[key] = described.removeprefix("Deprecated: ").removesuffix(".")
            else:
                text += f"| `{key}` | {described} |\n"
        text += "\n"
    return text + old_names(old)


def old_names(replaced: Mapping[str, str]) -> str:
    """Return a paragraph on deprecated inputs: those of each place in calibration.yml, and new names."""
    inputs_of: dict[str, list[str]] = {}
    for name, instead in replaced.items():
        found = re.fullmatch(r"the key (?:(.*)\.)?(.*) of calibration\.yml", instead)
        place = f"now in calibration.yml, {found[1] or 'at its top'}" if found else f"now `{instead}`"
        new_name = f" as `{found[2]}`" if found and found[2] != name else ""
        inputs_of.setdefault(place, []).append(f"`{name}`{new_name}")
    lists = [f"{', '.join(names)} ({place})" for place, names in inputs_of.items()]
    return f"Deprecated, and gone in the next version: {'; '.join(lists)}.\n\n" if lists else ""


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
    shipped = SHIPPED_SCHEMAS[name]
    return PROJECT / shipped.package.replace(".", "/") / shipped.file


if __name__ == "__main__":
    for schema in SHIPPED_SCHEMAS:
        schema_file(schema).write_text(generated(schema))
    for name, path in FILES.items():
        path.write_text(with_inputs(path.read_text(), name, lock_of(name)))
    for page in PAGES:
        page.write_text(with_parts(page.read_text()))
