"""Names that a file system, an artifact and a URL take as they are."""

import re
from collections.abc import Sequence

LONGEST = 80
_OTHER = re.compile(r"[^A-Za-z0-9._-]+")


def slugs(names: Sequence[str], taken: Sequence[str] = ()) -> list[str]:
    """A slug for each name: letters, digits, dots, dashes and underscores, no two alike in any case.

    Args:
        names: what is to be told apart; equal names get different slugs too.
        taken: slugs that none may have.
    """
    used = {slug.lower() for slug in taken}
    found = []
    for name in names:
        plain = _OTHER.sub("_", name).strip("._-")[:LONGEST] or "unnamed"
        slug, number = plain, 1
        while slug.lower() in used:
            number += 1
            slug = f"{plain}_{number}"
        used.add(slug.lower())
        found.append(slug)
    return found
