"""Holds the workflows to what GitHub, and the commands that they run, expect of them."""

import re
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import click
import pytest
import yaml

from calibration.__main__ import COMMANDS, load_command
from calibration.base import InputError
from calibration.ci.registries.push import promote
from calibration.ci.workflow import Runner
from calibration.commands.workflow import artifact_name
from calibration.pipeline.gathering import ERROR_OUTPUT, SECONDS_FILE, SECONDS_OUTPUT, parse_needs
from calibration.pipeline.workflow_plan import WorkflowPlan, plan_outputs
from tests.actions.write_inputs import deprecated, options

WORKFLOWS = Path(__file__).resolve().parents[2] / ".github" / "workflows"
PIPELINE: dict[Any, Any] = yaml.safe_load((WORKFLOWS / "pipeline.yml").read_text())
JOBS: dict[str, dict[str, Any]] = PIPELINE["jobs"]
CALL: dict[str, dict[str, Any]] = PIPELINE[True]["workflow_call"]  # YAML 1.1 reads `on` as true


@pytest.fixture(params=sorted(WORKFLOWS.glob("*.yml")), ids=lambda path: path.name)
def workflow(request: pytest.FixtureRequest) -> dict[str, Any]:
    loaded: dict[str, Any] = yaml.safe_load(request.param.read_text())
    return loaded


def test_every_job_ends_and_every_action_of_others_is_pinned(workflow: dict[str, Any]) -> None:
    for name, job in workflow["jobs"].items():
        assert "timeout-minutes" in job or "uses" in job, name
        for step in job.get("steps", []):
            assert "${{" not in step.get("run", "")
            used = step.get("uses", "./")
            assert used.startswith("./") or re.fullmatch(r"actions/[\w-]+@[0-9a-f]{40}", used)


def test_every_input_is_described_and_used() -> None:
    text = (WORKFLOWS / "pipeline.yml").read_text()
    for kind in ("inputs", "secrets"):
        for name, entry in CALL[kind].items():
            assert re.search(r"[.)\]]$", entry["description"]), name
            assert not entry.get("required"), name
            assert re.search(rf"\b{kind}\.{name}\b", text), name


CACHE = "Get the Python environment"


def test_jobs_share_an_environment_where_no_code_of_the_repository_runs() -> None:
    sharing = {name for name, job in JOBS.items() if CACHE in [step.get("name") for step in job["steps"]]}
    assert sharing == {"plan", "calibrate", "calibrate-collected", "verdict"}
    [cache] = [step for step in JOBS["plan"]["steps"] if step.get("name") == CACHE]
    assert cache["with"]["path"] == "${{ runner.temp }}/calibration-ci"  # as bootstrap.py has it


def test_deprecated_inputs_say_what_to_write() -> None:
    replaced = deprecated("plan-matrix")
    said = {
        name: entry["description"] for name, entry in CALL["inputs"].items() if "Deprecated" in entry["description"]
    }
    assert said == {name: f"Deprecated: {instead}." for name, instead in replaced.items()}


def test_every_variable_of_a_step_is_an_input_of_its_command() -> None:
    run = re.compile(r'exec bash "\$RUNNER_TEMP/calibration-ci-suite/actions/bootstrap\.sh" ([\w-]+)')
    started = set()
    for job in JOBS.values():
        for step in job["steps"]:
            if found := run.search(step.get("run", "")):
                started.add(found[1])
                if found[1] not in COMMANDS or COMMANDS[found[1]].target.startswith("calibration.addons."):
                    continue
                known = {
                    f"INPUT_{name.upper().replace('-', '_')}"
                    for name in [*options(found[1]), *deprecated(found[1]), "python"]
                }
                given = {name for name in step["env"] if name.startswith("INPUT_")}
                assert given <= known
                assert "INPUT_PYTHON" in given
    steps = {"plan-matrix", "build-image", "calibrate-matrix", "run", "coverage-upload", "gather-results", "comment"}
    steps |= {"static-analysis", "check", "deliver"}
    assert started == steps


def test_the_plan_hands_on_all_that_it_says() -> None:
    told = {name: f"${{{{ steps.plan.outputs.{name} }}}}" for name in plan_outputs(WorkflowPlan())}
    own = {SECONDS_OUTPUT: "${{ steps.seconds.outputs.seconds }}", ERROR_OUTPUT: "${{ steps.plan.outputs.error }}"}
    assert JOBS["plan"]["outputs"] == {**told, **own}
    assert set(options("plan-matrix")) - {"plan-file"} <= set(CALL["inputs"])


def test_the_verdict_waits_for_every_job_and_is_never_skipped() -> None:
    verdict = JOBS["verdict"]
    assert set(verdict["needs"]) == set(JOBS) - {"verdict", "comment", "promote", "deliver"}
    assert verdict["if"] == "${{ always() }}"
    assert set(WorkflowPlan().jobs) == set(JOBS) - {
        "plan",
        "check",
        "coverage",
        "verdict",
        "comment",
        "promote",
        "deliver",
    }
    [told] = [step["env"]["INPUT_NEEDS"] for step in verdict["steps"] if "INPUT_NEEDS" in step.get("env", {})]
    needs = parse_needs(re.sub(r"\$\{\{ toJSON\(needs\.([\w-]+)\..*?\) \}\}", r'"\1"', told))
    assert dict(needs.results) == {job: job for job in verdict["needs"]}
    for job in JOBS.values():
        assert "continue-on-error" not in job
        assert all(
            "continue-on-error" not in step or step["name"] in ("Comment", "Keep the page", CACHE)
            for step in job["steps"]
        )


def test_no_call_gathers_what_another_one_left() -> None:
    """Whatever their names, of those that plan-matrix takes, and a job's slug are."""
    steps = [step["with"] for job in JOBS.values() for step in job["steps"] if "artifact@" in step.get("uses", "")]
    assert len(steps) == 24

    def names(key: str, call: str) -> list[str]:
        texts = [step[key] for step in steps if key in step]
        return [
            re.sub(r"\$\{\{ (.*?) \}\}", lambda found: {"inputs.artifact-name": call}.get(found[1], "a-b"), text)
            for text in texts
        ]

    left, patterns = names("name", "calibration-arm"), names("pattern", "calibration")
    assert [name for name in left for pattern in patterns if fnmatch(name, pattern)] == []
    assert set(left) & set(names("name", "calibration")) == set()
    gathered = [name for name in names("name", "calibration") if fnmatch(name, "calibration~*")]
    assert set(left) - {name.replace("calibration~", "calibration-arm~") for name in gathered} == {
        "calibration-arm",
        "calibration-arm.html",
    }
    with pytest.raises(click.BadParameter, match="expected up to 100 letters"):
        artifact_name("calibration~arm")


def test_an_image_is_promoted_after_a_verdict_that_is_pass_and_never_in_a_pull_request() -> None:
    last, plan = JOBS["promote"], JOBS["plan"]
    assert last["needs"] == ["plan", "image", "verdict"]
    for condition in ("!failure()", "!cancelled()", "needs.verdict.outputs.verdict != 'fail'"):
        assert condition in last["if"]
    [wish] = [step["env"]["INPUT_MAY_PROMOTE"] for step in plan["steps"] if "INPUT_MAY_PROMOTE" in step.get("env", {})]
    assert wish == "${{ inputs.may-promote && inputs.promote && !startsWith(github.event_name, 'pull_request') }}"


def test_a_push_that_passed_is_delivered_if_that_is_asked_for() -> None:
    last = JOBS["deliver"]
    asked = "(inputs.deliver-registry != '' || inputs.deliver-release)"
    for condition in ("needs.verdict.outputs.verdict == 'pass'", "github.event_name == 'push'", asked, "!cancelled()"):
        assert condition in last["if"]


def test_a_promotion_that_lost_the_digest_builds_nothing() -> None:
    [step] = [step for step in JOBS["promote"]["steps"] if step.get("name") == "Promote"]
    fallback = re.fullmatch(r"\$\{\{ needs\.image\.outputs\.digest \|\| '(.+)' \}\}", step["env"]["INPUT_DIGEST"])
    assert fallback is not None
    with pytest.raises(InputError, match="sha256:unknown"):
        promote("127.0.0.1:1/robot", fallback[1], ["stable"], None, Runner())


def test_every_job_measures_itself() -> None:
    """From its first step to its last; where the jobs are of a matrix, until it keeps its results."""
    for name, job in JOBS.items():
        first, *_, last = job["steps"]
        if name in ("comment", "promote", "deliver"):  # nobody waits for them
            continue
        assert first["run"] == 'echo "began=$(date +%s)" >>"$GITHUB_OUTPUT"'
        if name == "verdict":
            continue
        if "strategy" in job:
            [_, read, kept] = job["steps"][-3:]
            assert kept["uses"].startswith("actions/upload-artifact@")
            assert read["run"].endswith(f'echo "$(($(date +%s) - BEGAN))" >"$FOLDER/{SECONDS_FILE}"\n')
            [folder] = [step["env"]["INPUT_OUTPUT"] for step in job["steps"] if "INPUT_OUTPUT" in step.get("env", {})]
            assert read["env"]["FOLDER"] == folder
        else:
            assert last["if"] == "${{ always() }}"
            assert last["run"] == f'echo "{SECONDS_OUTPUT}=$(($(date +%s) - BEGAN))" >>"$GITHUB_OUTPUT"'
            assert job["outputs"][SECONDS_OUTPUT] == "${{ steps.seconds.outputs.seconds }}"


def test_no_job_that_runs_the_tests_of_the_team_has_a_secret() -> None:
    """Tests can leave programs and settings behind for the later steps of their job.

    But for the one that reads a private copy of the suite, in a step before the tests: it opens nothing else.
    """
    steps = JOBS["unit-tests"]["steps"]
    with_secrets = [step["name"] for step in steps if "secrets." in str(step)]
    assert with_secrets == ["Fetch Calibration CI"]
    assert set(re.findall(r"secrets\.([\w-]+)", str(steps))) == {"suite-token"}
    names = [step.get("name") for step in steps]
    assert names.index("Fetch Calibration CI") < names.index("Set up") < names.index("Test")
    assert "codacy" in str(JOBS["coverage"])
    assert "tests" not in str([step.get("env") for step in JOBS["coverage"]["steps"]]).replace("unit-tests/lcov", "")


def test_a_login_goes_to_the_image_that_it_is_for() -> None:
    """Our containers are started without a login: what is built is brought to the engine by the step that has one."""
    [calibrate] = [step for step in JOBS["calibrate"]["steps"] if step.get("name") == "Calibrate"]
    password, user = "secrets.registry-password", "inputs.registry-username"
    given = calibrate["env"]
    assert given["INPUT_REGISTRY_PASSWORD"] == f"${{{{ env.CELL_IMAGE == 'given' && {password} || '' }}}}"
    assert given["INPUT_REGISTRY_USERNAME"] == f"${{{{ env.CELL_IMAGE == 'given' && {password} && {user} || '' }}}}"
    for job in ("calibrate-in-image", "collect-data-in-containers", "test-image"):
        [build] = [step for step in JOBS[job]["steps"] if step.get("name") == "Build the image"]
        assert build["env"]["INPUT_LOAD"] is True


def test_jobs_have_the_time_that_the_caller_gives_their_kind() -> None:
    timeouts = {name: job["timeout-minutes"] for name, job in JOBS.items() if isinstance(job["timeout-minutes"], str)}
    assert timeouts == {
        "image": "${{ inputs.timeout-minutes }}",
        "calibrate": "${{ inputs.timeout-minutes }}",
        "calibrate-in-image": "${{ inputs.timeout-minutes }}",
        "calibrate-collected": "${{ inputs.timeout-minutes }}",
        "calibrate-collected-in-image": "${{ inputs.timeout-minutes }}",
        "collect-data": "${{ inputs.collect-timeout-minutes || inputs.timeout-minutes }}",
        "collect-data-in-containers": "${{ inputs.collect-timeout-minutes || inputs.timeout-minutes }}",
        "test-image": "${{ inputs.tests-timeout-minutes || inputs.timeout-minutes }}",
        "check-messages": "${{ inputs.timeout-minutes }}",
        "check": "${{ inputs.timeout-minutes }}",
        "unit-tests": "${{ inputs.tests-timeout-minutes || inputs.timeout-minutes }}",
        "static-analysis": "${{ inputs.timeout-minutes }}",
    }


def test_every_workflow_of_ours_is_one_required_check() -> None:
    checks = yaml.safe_load((WORKFLOWS / "checks.yml").read_text())["jobs"]
    assert set(checks["checks"]["needs"]) == set(checks) - {"checks"}
    assert checks["checks"]["if"] == "${{ always() }}"


RELEASING = {"wheel", "upload", "image", "index", "release"}
"""Jobs of release.yml that write or sign."""


def test_permissions_are_small() -> None:
    for path in WORKFLOWS.glob("*.yml"):
        loaded = yaml.safe_load(path.read_text())
        assert loaded.get("permissions", {}) == {}
        asked = {name: job["permissions"] for name, job in loaded["jobs"].items() if "permissions" in job}
        more = {name for name, permissions in asked.items() if permissions not in ({}, {"contents": "read"})}
        assert more == {"release.yml": RELEASING, "pages.yml": {"publish"}}.get(path.name, set())
    # These use what the caller gives: a registry, AWS, the comment.
    assert {name for name, job in JOBS.items() if "permissions" not in job} == {
        *("image", "calibrate-in-image", "collect-data-in-containers", "calibrate-collected-in-image"),
        *("test-image", "comment", "promote", "deliver"),
    }


def test_a_job_with_the_least_permissions_has_no_secret_but_the_one_that_reads_the_suite() -> None:
    code = "unit-tests", "static-analysis"
    for name in ("calibrate", "calibrate-collected", "collect-data", "check-messages", "check", *code, "verdict"):
        assert JOBS[name]["permissions"] == {"contents": "read"}
        text = str([step for step in JOBS[name]["steps"] if step.get("name") != "Calibrate"])
        assert set(re.findall(r"secrets\.([\w-]+)", text)) <= {"suite-token"}, name


def test_a_job_that_may_be_skipped_has_a_name_without_an_expression() -> None:
    for name, job in JOBS.items():
        assert ("${{" in job["name"]) is (name in ("plan", "verdict"))


def test_a_job_keeps_its_own_folder_alone() -> None:
    for name, job in JOBS.items():
        for step in job["steps"]:
            if "upload-artifact@" in step.get("uses", "") and "~" in step["with"].get("name", ""):
                slug = step["with"]["name"].partition("~")[2]
                assert (
                    step["with"]["path"].splitlines()[0].endswith(f"/{slug}".replace("/plan", "/calibration-plan"))
                ), name
    [get] = [step for step in JOBS["verdict"]["steps"] if step.get("name") == "Get the results"]
    assert "merge-multiple" not in get["with"]


def test_every_artifact_has_a_name_of_its_own() -> None:
    """The default is `artifact`, which `overwrite` would delete though it is the caller's."""
    for job in JOBS.values():
        for step in job["steps"]:
            if "upload-artifact@" in step.get("uses", ""):
                assert step["with"]["name"].startswith("${{ inputs.artifact-name }}")


def test_the_commands_of_the_workflow_are_there() -> None:
    for name in ("plan-matrix", "gather-results"):
        assert load_command(name).name == name
