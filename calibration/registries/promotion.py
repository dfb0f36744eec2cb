"""Promotion: the image that was tested gets the tags of a release, with nothing pulled and nothing built."""

from collections.abc import Sequence

from calibration.errors import InputError
from calibration.registries.credentials import Credentials
from calibration.registries.reference import Reference, check_tag, is_digest, parse_reference
from calibration.registries.registry import Manifest, RegistryClient
from calibration.workflow import Runner


def promote(
    name: str, digest_or_key: str, tags: Sequence[str], credentials: Credentials | None, runner: Runner
) -> list[str]:
    """Give an image in a registry more tags; the digest stays what it is, for several platforms too.

    A tag that is there already is left alone, so that it can be done again. A tag that somebody else moves
    meanwhile is theirs.

    Args:
        name: of the image; tag and digest in it say nothing.
        digest_or_key: which image: ``sha256:...``, or one of its tags.
        tags: what it gets.
        credentials: for the registry.
        runner: where it says what it did.

    Returns:
        The names that now stand for the image: ``ghcr.io/team/robot:stable``.

    Raises:
        InputError: the image is not there, a tag is none, or it is denied.
        InfrastructureError: the registry cannot be reached, or fails.
    """
    image = parse_reference(name)
    source = image.with_digest(digest_or_key) if is_digest(digest_or_key) else image.with_tag(digest_or_key)
    wanted = [image.with_tag(check_tag(tag)) for tag in dict.fromkeys(tags)]
    with RegistryClient(credentials) as client:
        manifest = client.read_manifest(source)
        if manifest is None:
            hint = "push it first, and log in where not everyone may see it"
            raise InputError(f"{source}: there is no such image to promote: {hint}")
        for reference in wanted:
            runner.log(f"{reference}: {tag_image(client, reference, manifest)} {manifest.digest}")
    return [str(reference) for reference in wanted]


def tag_image(client: RegistryClient, reference: Reference, manifest: Manifest) -> str:
    """Make a tag stand for an image of its repository; returns what was done, to be said before the digest.

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
        return f"was moved by somebody else, to {after}, after it was"
    return "is now" if before is None else f"is no longer {before} but"
