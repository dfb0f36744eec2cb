"""Promotion: tag a tested image for release in the registry, without pulling or building."""

from collections.abc import Sequence

from calibration.base.errors import InputError
from calibration.ci.registries.credentials import Credentials
from calibration.ci.registries.reference import Reference, check_tag, is_digest, parse_reference
from calibration.ci.registries.registry import Manifest, RegistryClient
from calibration.ci.workflow import Runner


def promote(
    name: str, digest_or_key: str, tags: Sequence[str], credentials: Credentials | None, runner: Runner
) -> list[str]:
    """Add tags to an image in a registry; its digest is unchanged, also for several platforms.

    Tags that already refer to the image are skipped, so a promotion can be repeated. If another process moves
    a tag at the same time, its change is kept.

    Args:
        name: name of the image; a tag or digest in it is ignored.
        digest_or_key: the image: ``sha256:...``, or one of its tags.
        tags: tags to add.
        credentials: credentials of the registry.
        runner: runner whose log reports the changes.

    Returns:
        Names that now refer to the image: ``ghcr.io/team/robot:stable``.

    Raises:
        InputError: the image is not there, a tag is invalid, or it is denied.
        InfrastructureError: the registry cannot be reached, or fails.
    """
    image = parse_reference(name)
    source = image.with_digest(digest_or_key) if is_digest(digest_or_key) else image.with_tag(digest_or_key)
    wanted = [image.with_tag(check_tag(tag)) for tag in dict.fromkeys(tags)]
    with RegistryClient(credentials) as client:
        manifest = client.read_manifest(source)
        if manifest is None:
            hint = "push it first, and log in if it is private"
            raise InputError(f"{source}: there is no such image to promote: {hint}")
        for reference in wanted:
            runner.log(f"{reference}: {tag_image(client, reference, manifest)} {manifest.digest}")
    return [str(reference) for reference in wanted]


def tag_image(client: RegistryClient, reference: Reference, manifest: Manifest) -> str:
    """Set a tag in the repository of an image; return what was done, as words to put before the digest.

    Raises:
        InputError: that is denied.
        InfrastructureError: the registry cannot be reached, or fails.
    """
    before = client.find_manifest(reference)
    if before == manifest.digest:
        return "is already"
    client.put_manifest(reference, manifest)
    after = client.find_manifest(reference)
    if after != manifest.digest:
        return f"was moved to {after} by another process after it was"
    return "is now" if before is None else f"is no longer {before} but"
