"""The CI services that are known."""

from calibration.ci.forgejo import FORGEJO
from calibration.ci.github.service import GITHUB
from calibration.ci.gitlab import GITLAB
from calibration.ci.workflow.runner import TERMINAL, Environment, Event, Terminal

SERVICES: list[Terminal] = [GITLAB, FORGEJO, GITHUB]
"""In the order in which they are asked: Forgejo's runners set GitHub's variable too."""


def service_of(environment: Environment) -> Terminal:
    """Return the service that runs this step; the terminal if none does."""
    return next((service for service in SERVICES if service.runs_here(environment)), TERMINAL)


def event_of(environment: Environment) -> Event:
    """Return what started the run; raises `InputError` if the service's description of it is unreadable."""
    return service_of(environment).event(environment)
