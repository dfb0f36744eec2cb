"""Plugin by which pytest, instead of running the tests, serves jobs: see ``calibration_pseudo_tested.py``."""

# mypy: ignore-errors
# ruff: noqa: B905, D103, UP031

import os
import time

import calibration_pseudo_tested as jobs
import pytest

_outcomes = {}
_fail = None
"""What to call with the name of a test that fails, while a job runs."""
os.environ.pop("PYTEST_PLUGINS", None)  # not in a pytest that a test starts


@pytest.hookimpl(tryfirst=True)
def pytest_load_initial_conftests(early_config):
    """Switch pytest-cov off: nothing is measured, and its limit would be missed."""
    _change(early_config.known_args_namespace, no_cov=True, cov_source=[])


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config):
    """Switch off processes of pytest-xdist, since jobs are parallel, and what is written at the end."""
    _change(config.option, no_cov=True, cov_source=[], dist="no", tx=[], numprocesses=0, xmlpath=None, maxfail=0)


def _change(options, **values):
    for name, value in values.items():
        if hasattr(options, name):
            setattr(options, name, value)


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session):
    """Serve jobs with the collected tests; tests that cannot be collected are the error that they always are."""
    if session.testsfailed or session.config.option.collectonly or not jobs.claim():
        return None
    jobs.serve([item.nodeid for item in session.items], "pytest", lambda names, fail: _run(session, set(names), fail))
    return True


def _run(session, names, fail):
    global _fail
    _fail = fail
    if not jobs.recorder:
        session.config.option.tbstyle = "native"  # nobody reads why a test failed, and the others take long to make
    chosen = [item for item in session.items if item.nodeid in names]
    for item, following in zip(chosen, [*chosen[1:], None]):
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)


@pytest.hookimpl(hookwrapper=True, tryfirst=True)
def pytest_runtest_protocol(item):
    if not jobs.recorder:
        yield
        return
    begin = time.monotonic()
    jobs.recorder.run_in(item.nodeid)
    yield
    jobs.recorder.run_in(None)
    jobs.recorder.note("outcome", item.nodeid, _outcomes.get(item.nodeid, "passed"), time.monotonic() - begin)


def pytest_runtest_logreport(report):
    if report.failed:
        _outcomes[report.nodeid] = "failed"
        if _fail:
            _fail(report.nodeid)
    elif report.skipped:
        _outcomes.setdefault(report.nodeid, "skipped")


@pytest.hookimpl(hookwrapper=True)
def pytest_fixture_setup(fixturedef, request):
    """What a fixture of several tests runs belongs to all of them, not to the first alone."""
    if not jobs.recorder or fixturedef.scope == "function":
        yield
        return
    before = jobs.recorder.test
    name = "fixture %s of %s" % (fixturedef.argname, fixturedef.baseid)
    users = [
        item.nodeid
        for item in request.session.items
        if fixturedef.argname in getattr(item, "fixturenames", ()) and item.nodeid.startswith(fixturedef.baseid)
    ]
    jobs.recorder.note("context", name, users)
    jobs.recorder.run_in(name)
    yield
    jobs.recorder.run_in(before)
