"""Build of an image from a specification, unless an unchanged image is found; results of ``build-image``."""

import hashlib
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from calibration.base import CalibrationError, InfrastructureError, InputError
from calibration.base.records import computed, field, result
from calibration.ci.docker_engine import connect, engine_errors
from calibration.ci.image.build_request import BuildLog, BuildRequest, SecretValue, read_secrets, refuse_secrets_in
from calibration.ci.image.builders import Program, build_and_push, build_by_buildkit, build_by_engine, find_buildkit
from calibration.ci.image.context import KEY_LABEL, build_labels, key_tag
from calibration.ci.image.plan import Base, Plan, fetch, local_image, make_plan
from calibration.ci.image.specification import ImageSpecification, OwnDockerfile
from calibration.ci.registries.push import promote, push_image
from calibration.ci.registries.reference import DOCKER_HUB, Credentials, parse_reference
from calibration.ci.registries.registry import RegistryClient, registry_login
from calibration.ci.report import Code, Outcome, Report, Table, verdict_of
from calibration.ci.workflow import Annotation, Runner, group, stop_commands
from calibration.ci.workflow.streams import Advance, progress

if TYPE_CHECKING:
    from docker import DockerClient

BuilderName = Literal["auto", "engine", "buildkit"]
TITLE = "build-image"


@dataclass(frozen=True)
class BuiltImage:
    """An image that was built, or found on the engine or in its registry."""

    reference: str
    """Name to run: ``name:key-<hash>``."""
    key: str
    """Content key, 64 hexadecimal digits."""
    built: bool
    """Whether it was built now; otherwise it was found."""
    id: str | None = None
    """Image id on the engine; None if the engine does not have it."""
    digest: str | None = None
    """Digest in the registry; None if it is in no registry."""
    found_in: Literal["local", "registry"] | None = None
    tags: tuple[str, ...] = ()
    """Other current names of the image: ``name:latest``."""
    seconds: float = 0.0


def build_image(
    specification: ImageSpecification,
    runner: Runner,
    *,
    push: bool | None = None,
    load: bool = True,
    builder: BuilderName = "auto",
    force: bool = False,
    pull: bool = False,
    leave_out: Sequence[Path] = (),
) -> BuiltImage:
    """Find or build the image of a specification, tag it, and push it on request.

    It is searched by its content key, on the engine and then in its registry, and built only if
    neither has it. Tags of an image in the registry are set without pulling or pushing it.

    Args:
        specification: specification of the image.
        runner: runner whose log shows the build.
        push: whether to push; by default as in the specification.
        load: whether the image must be on the engine, to be run here.
        builder: auto uses BuildKit if a docker command on PATH supports it, else the engine's classic builder.
        force: build without any cache.
        pull: resolve the bases in their registries, for newer versions.
        leave_out: folders that are excluded from the context: folders for results, which change in every run.

    Raises:
        InputError: a file, base, secret or builder is missing, or access is denied.
        BuildFailedError: a step of the Dockerfile failed.
        InfrastructureError: the engine, a registry or the network failed.
    """
    begin = time.monotonic()
    push = specification.push if push is None else push
    secrets = read_secrets(specification.secrets, runner)
    with closing(connect()) as client, engine_errors():
        work = _Work(client, specification, runner, secrets, push, load)
        plan = make_plan(client, specification, work.login, ask_registry=pull, leave_out=leave_out)
        image = work.bring_about(plan, builder, force)
    return replace(image, seconds=time.monotonic() - begin)


class _Work:
    """State of one call of :func:`build_image`."""

    def __init__(
        self,
        client: "DockerClient",
        specification: ImageSpecification,
        runner: Runner,
        secrets: Sequence[SecretValue],
        push: bool,
        load: bool,
    ) -> None:
        self._client = client
        self._specification = specification
        self._runner = runner
        self._secrets = secrets
        self._push = push
        self._load = load and len(specification.platforms) < 2
        self._attest = specification.attest and push
        self._by_registry = self._attest or len(specification.platforms) > 1
        """Whether the builder pushes it, as the engine cannot store it whole."""
        self._logins: dict[str, Credentials] = {}

    def bring_about(self, plan: Plan, builder: BuilderName, force: bool) -> BuiltImage:
        """Find the image of a plan, or build it; then tag it, and push it on request."""
        specification, runner = self._specification, self._runner
        self._refuse_secrets(plan)
        for note in plan.notes:
            runner.log(f"not covered by the content key: {note}")
        reference = f"{specification.name}:{key_tag(plan.key)}"
        found = None if force else self._find_image(reference, plan.key)
        if found is not None:
            runner.log(f"{reference}: nothing has changed, found {WORDS_OF_PLACE[found.found_in]}")
        image = found or self._build_image(plan, reference, builder, force)
        return self._set_tags(image)

    def login(self, name: str) -> Credentials:
        """Return the credentials for an image's registry; the settings are for that of the built image."""
        registry = parse_reference(name).registry
        if registry not in self._logins:
            own = registry == parse_reference(self._specification.name).registry
            self._logins[registry] = registry_login(self._specification.registry if own else None, name, self._runner)
        return self._logins[registry]

    def _refuse_secrets(self, plan: Plan) -> None:
        places = {"the Dockerfile": plan.text}
        if isinstance(self._specification.source, OwnDockerfile):
            arguments = self._specification.source.build_arguments
            places |= {f"build-arguments.{name}": value for name, value in arguments.items()}
        else:
            places["the entrypoint"] = "\n".join(self._specification.source.entrypoint)
        places |= {f"labels.{name}": value for name, value in self._specification.labels.items()}
        refuse_secrets_in(self._secrets, places)

    def _find_image(self, reference: str, key: str) -> BuiltImage | None:
        """Return the image of a key from the engine or the registry; None if it is missing."""
        local = None if self._by_registry else local_image(self._client, reference)
        if local is not None and local.labels.get(KEY_LABEL) == key:
            return BuiltImage(reference, key, built=False, id=local.id, found_in="local")
        digest = self._digest_in_registry(reference)
        if digest is None:
            return None
        if not self._load:
            return BuiltImage(reference, key, built=False, digest=digest, found_in="registry")
        name = f"{self._specification.name}@{digest}"
        with self._logged_group(f"{TITLE}: pulling {reference}") as log:
            fetch(self._client, name, self.login, None, log)
        image = self._client.images.get(name)
        if image.labels.get(KEY_LABEL) != key:
            self._runner.log(f"{reference}: the image with this tag in the registry was built for another key")
            return None
        image.tag(*reference.rsplit(":", 1))
        return BuiltImage(reference, key, built=False, id=image.id, digest=digest, found_in="registry")

    def _digest_in_registry(self, reference: str) -> str | None:
        """Return the digest of an image in its registry; a failing registry does not prevent a build, only a push."""
        registry = parse_reference(reference).registry
        settings = self._specification.registry
        if registry == DOCKER_HUB and not self._push and settings is None:
            return None  # a name without a host may be local, and belong to a stranger on Docker Hub
        try:
            with RegistryClient(self.login(reference)) as client:
                return client.find_manifest(reference)
        except CalibrationError as error:
            if self._push:
                raise
            self._runner.log(f"the registry was not searched: {error}")
            return None

    def _build_image(self, plan: Plan, reference: str, builder: BuilderName, force: bool) -> BuiltImage:
        specification = self._specification
        own = specification.source if isinstance(specification.source, OwnDockerfile) else None
        program = self._choose_program(plan, builder)
        described = hashlib.sha256(plan.text.encode()).hexdigest()
        folder = own.context if own else Path()
        request = BuildRequest(
            name=specification.name,
            context=plan.context,
            dockerfile=plan.dockerfile,
            labels=build_labels(plan.key, described, specification.labels if own else {}, folder),
            build_arguments=own.build_arguments if own else {},
            target=own.target if own else None,
            platforms=specification.platforms,
            secrets=self._secrets,
            ssh=specification.ssh,
            no_cache=force,
            attest=self._attest,
        )
        if self._by_registry:
            return self._built_in_registry(program, request, reference, plan)
        with self._logged_group(f"{TITLE}: building {reference}") as log:
            for base in plan.bases:
                self._fetch_base(base, log)
            if program is None:
                made = build_by_engine(self._client, request, log)
            else:
                build_by_buildkit(program, request, reference, log)
                made = reference
        image = self._client.images.get(made)
        if image.labels.get(KEY_LABEL) != plan.key:
            raise InfrastructureError(f"{reference}: the builder has made an image without our labels")
        platform = f"{image.attrs['Os']}/{image.attrs['Architecture']}"
        for asked in specification.platforms:
            if "/".join(asked.split("/")[:2]) != platform:
                raise InputError(
                    f"platforms: asked for {asked}, but the engine's base image is for {platform}: remove it"
                )
        image.tag(*reference.rsplit(":", 1))
        return BuiltImage(reference, plan.key, built=True, id=image.id)

    def _fetch_base(self, base: Base, log: BuildLog) -> None:
        """Pull a base at the digest in the content key, and tag it with the name that the Dockerfile uses."""
        reference = parse_reference(base.name)
        pinned = f"{reference.name}@{base.digest}" if base.digest else base.name
        fetch(self._client, pinned, self.login, next(iter(self._specification.platforms), None), log)
        if base.digest and not reference.digest:
            self._client.images.get(pinned).tag(reference.name, reference.tag or "latest")

    def _built_in_registry(
        self, program: "Program | None", request: "BuildRequest", reference: str, plan: Plan
    ) -> BuiltImage:
        if program is None or not program.buildx:
            key = "attest: SBOM and provenance" if self._attest else "platforms: several"
            raise InputError(f"{key} need docker's plugin buildx (docker-buildx-plugin): install it, or remove the key")
        with self._logged_group(f"{TITLE}: building {reference}") as log:
            digest = build_and_push(program, request, [reference], self.login(reference), log)
        found = self._find_image(reference, plan.key) if self._load else None
        return replace(found or BuiltImage(reference, plan.key, built=True), built=True, digest=digest)

    def _choose_program(self, plan: Plan, builder: BuilderName) -> "Program | None":
        """Return the command to build with; None for the engine's classic builder.

        Raises:
            InputError: BuildKit is needed or requested, and not installed.
        """
        if builder == "engine":
            if plan.needs_buildkit:
                raise InputError(f"builder: engine cannot build this: {_BUILDKIT_ONLY} need BuildKit")
            return None
        program = find_buildkit(os.environ.get("PATH", os.defpath))
        if program is None and (builder == "buildkit" or plan.needs_buildkit):
            why = f"{_BUILDKIT_ONLY} need BuildKit" if plan.needs_buildkit else "builder: buildkit is requested"
            raise InputError(f"{why}, and no docker on PATH supports it: install docker's plugin buildx")
        return program

    @contextmanager
    def _logged_group(self, title: str) -> Iterator[BuildLog]:
        """Log the block in a group, with workflow commands disabled and secrets redacted."""
        values = [secret.text for secret in self._secrets]
        values += [value for login in self._logins.values() for value in login.secrets]
        with group(self._runner, title), stop_commands(self._runner), progress(self._runner, TITLE) as advance:
            log = BuildLog(self._runner, advance, values)
            try:
                yield log
            finally:
                log.end_line()

    def _set_tags(self, image: BuiltImage) -> BuiltImage:
        """Set the other tags of an image, on the engine and in the registry."""
        specification = self._specification
        if image.id is not None:
            local = self._client.images.get(image.id)
            for tag in specification.tags:
                local.tag(specification.name, tag)
        if self._push:
            image = replace(image, digest=self._push_image(image))
        return replace(image, tags=tuple(f"{specification.name}:{tag}" for tag in specification.tags))

    def _push_image(self, image: BuiltImage) -> str:
        """Push an image and its tags; return its digest in the registry."""
        specification = self._specification
        credentials = self.login(image.reference)
        digest = image.digest
        if digest is None and not image.built:
            digest = self._digest_in_registry(image.reference)
        if digest is None:
            with self._grouped_progress(f"{TITLE}: pushing {image.reference}") as advance:
                return push_image(self._client, image.reference, specification.tags, credentials, advance)
        if specification.tags:
            promote(specification.name, digest, specification.tags, credentials, self._runner)
        return digest

    @contextmanager
    def _grouped_progress(self, title: str) -> Iterator[Advance]:
        with group(self._runner, title), progress(self._runner, TITLE) as advance:
            yield advance


_BUILDKIT_ONLY = "secrets, ssh, several platforms and RUN --mount"


REPORT_TITLE = "build-image"
WORDS_OF_PLACE = {"local": "on the engine", "registry": "in the registry", None: ""}
"""Where an image was found."""


@result
class Failure:
    """A failed step of the Dockerfile."""

    message: str = field("Reason of the failure.")
    lines: tuple[str, ...] = field("Last lines of the step's output.")


@result(kw_only=True)
class BuildResult:
    """Results of build-image: an image that was built, found or only promoted, or a failure."""

    reference: str | None = field(
        "Name to run: name:key-..., or name@digest if an image was only promoted.", default=None
    )
    id: str | None = field("Image id on the engine, if the engine has it.", default=None)
    digest: str | None = field("Digest in the registry, if it is there: sha256:...", default=None)
    key: str | None = field("Content key: equal exactly for images with the same content.", default=None)
    built: bool = field("Whether it was built now; otherwise nothing had changed.", default=False)
    found_in: Literal["local", "registry"] | None = field(
        "Where an image that was not built now was found.", default=None
    )
    tags: tuple[str, ...] = field("Its other current names: name:latest.", default=())
    promoted: tuple[str, ...] = field("Names that it was promoted to.", default=())
    seconds: float = field("Duration of the whole command.", default=0.0)
    failure: Failure | None = field("Reason of the failure.", default=None)

    @property
    @computed()
    def reasons(self) -> tuple[str, ...]:
        """Reasons of the failure."""
        return (self.failure.message,) if self.failure else ()


def report(result: BuildResult, source: Path, runner: Runner) -> Report:
    """Return the report of ``build-image``.

    Args:
        result: results of the command.
        source: specification or Dockerfile, for the annotation of a failure.
        runner: runner of the report; the log of a terminal has not shown the output of the steps.
    """
    failure = result.failure
    lines = failure.lines if failure else ()
    annotated = "\n".join((*result.reasons, *(lines if runner.service.annotates_lines else ())))
    return Report(
        title="Image",
        verdict=verdict_of(failure is None),
        sentence=_result_sentence(result),
        results=result,
        outputs={
            "reference": result.reference,
            "digest": result.digest,
            "key": result.key,
            "image-id": result.id,
            "built": result.built,
            "tags": list(dict.fromkeys((*result.tags, *result.promoted))),
        },
        annotations=(Annotation(annotated, file=source),) if failure else (),
        blocks=(
            Code("\n".join(lines), only=None if runner.on_terminal else "summary"),
            Table(
                ("", ""),
                tuple(
                    (name, value)
                    for name, value in (
                        ("Image", result.reference),
                        ("Digest", result.digest),
                        ("Tags", ", ".join(result.tags)),
                        ("Promoted to", ", ".join(result.promoted)),
                        ("Content key", result.key),
                    )
                    if value
                ),
                only="summary",
            ),
        ),
        suites={
            REPORT_TITLE: [Outcome(name="image", group=REPORT_TITLE, reasons=result.reasons, seconds=result.seconds)]
        },
    )


def _result_sentence(result: BuildResult) -> str:
    if result.failure is not None:
        return result.failure.message
    names = ", ".join(result.promoted)
    if result.key is None:
        return f"{result.reference} is promoted to {names}"
    how = "built" if result.built else f"unchanged, found {WORDS_OF_PLACE[result.found_in]}"
    promoted = f", promoted to {names}" if names else ""
    return f"{result.reference}: {how}{promoted} ({result.seconds:.1f} s)"
