"""How many examples a property is tried with: profiles of hypothesis, chosen with ``--hypothesis-profile``."""

import hypothesis

COMMON = hypothesis.settings(
    deadline=None,  # a slow machine with much else to do is no failure
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
    max_examples=50,
)
PROFILES = {"few": 8, "usual": 50, "many": 500}
"""``few`` while one works on a room, ``usual`` for all tests, ``many`` to look for what these have not found."""


def register_profiles() -> None:
    """Make the profiles known and begin with the usual one."""
    for name, count in PROFILES.items():
        hypothesis.settings.register_profile(name, COMMON, max_examples=count)
    hypothesis.settings.load_profile("usual")


def at_most(count: int) -> hypothesis.settings:
    """Settings of a property whose examples take long: so many of them, or what the profile says if that is less."""
    return hypothesis.settings(max_examples=min(count, hypothesis.settings().max_examples))
