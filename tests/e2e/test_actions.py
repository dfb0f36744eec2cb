"""The actions as a user's workflow runs them."""

from pathlib import Path

import yaml

from .conftest import PROJECT, Repository

TABLE = "Collection #,RMS (pix),X err (pix)\n000,0.5000,0.1000\n001,0.7000,0.2000\nAverages,0.6000,0.1500\n"


def outputs(file: str) -> set[str]:
    """Return the outputs that an action.yml declares."""
    return set(yaml.safe_load((PROJECT / file).read_text())["outputs"])


def test_a_table_within_its_limits_is_green(repository: Repository) -> None:
    run = repository.push(
        """
- id: table
  uses: me/suite/actions/introspect-csv@v1
  with:
    file: my table.csv
    column: RMS (pix)
    row: Averages
    max: 3
    output: the report
- run: echo "verdict=$VERDICT violations=$VIOLATIONS"; test -s "$RESULTS"
  shell: bash
  env:
    VERDICT: ${{ steps.table.outputs.verdict }}
    VIOLATIONS: ${{ steps.table.outputs.violations }}
    RESULTS: ${{ steps.table.outputs.results }}
""",
        {"my table.csv": TABLE},
    )
    assert run.code == 0, run.log
    assert run.installations == ["introspect"]
    assert "verdict=pass violations=0" in run.printed
    assert run.outputs == outputs("actions/introspect-csv/action.yml")
    assert run.annotations == []


def test_a_broken_limit_is_red_and_points_to_the_line(repository: Repository) -> None:
    run = repository.push(
        """
- id: table
  uses: me/suite/actions/introspect-csv@v1
  with:
    file: my table.csv
    column: RMS (pix)
    row: Averages
    max: 0.55
- if: always()
  run: echo "verdict=$VERDICT violations=$VIOLATIONS"
  shell: bash
  env:
    VERDICT: ${{ steps.table.outputs.verdict }}
    VIOLATIONS: ${{ steps.table.outputs.violations }}
""",
        {"my table.csv": TABLE},
    )
    assert run.code == 1
    assert "exit status 1" in run.log
    assert "verdict=fail violations=1" in run.printed
    [annotation] = run.annotations
    assert "file=my table.csv" in annotation
    assert "line=4" in annotation
    assert "0.6" in annotation
    assert "0.55" in annotation


def test_the_second_action_of_a_job_reuses_the_environment(repository: Repository) -> None:
    step = """
- uses: me/suite/actions/introspect-csv@v1
  with:
    file: table.csv
    column: RMS (pix)
    every-max: 1
"""
    run = repository.push(step + step, {"table.csv": TABLE})
    assert run.code == 0, run.log
    assert run.installations == ["introspect"]


def test_inputs_are_data(repository: Repository) -> None:
    """Text in an input is neither shell, nor a workflow command, nor a line of an output or environment file."""
    run = repository.push(
        """
- id: table
  continue-on-error: true
  uses: me/suite/actions/introspect-csv@v1
  with:
    file: |-
      $(touch pwned) `touch pwned`"; touch pwned; '; touch pwned; #
      ::error::injected
      ::set-output name=verdict::pass
    column: |-
      RMS
      verdict=pass
      ::add-mask::table
    max: 3
    output: |-
      $GITHUB_WORKSPACE/out
      INJECTED=yes
- run: |
    test "$OUTCOME" = failure
    echo "verdict=[$VERDICT] injected=[${INJECTED:-}]"
    test -z "$(find "$GITHUB_WORKSPACE" -name 'pwned*')"
  shell: bash
  env:
    OUTCOME: ${{ steps.table.outcome }}
    VERDICT: ${{ steps.table.outputs.verdict }}
""",
        {"table.csv": TABLE},
    )
    assert run.code == 0, run.log
    assert "exit status 2" in run.log
    assert "verdict=[] injected=[]" in run.printed
    assert len(run.annotations) == 1
    assert "::error::injected" not in run.annotations
    assert "Traceback" not in run.log


def test_calibrate_then_check_the_table(repository: Repository) -> None:
    """The main job: a matrix of noisy starts, then a rule on the table of one of its cells."""
    run = repository.push(
        """
- id: matrix
  uses: me/suite/actions/calibrate-matrix@v1
  with:
    dataset: my dataset
    translation-noise: 0, 0.5
    rotation-noise: 0
    evaluate: rgb-to-rgb:left_camera:right_camera
    output: the results
- id: table
  shell: bash
  env:
    RESULTS: ${{ steps.matrix.outputs.results }}
    OUTPUT: ${{ steps.matrix.outputs.output }}
    SUMMARY: ${{ steps.matrix.outputs.summary }}
    FIGURES: success=${{ steps.matrix.outputs.success-rate }} rms=${{ steps.matrix.outputs.worst-rms-px }}
  run: |
    test -s "$SUMMARY"
    test -d "$OUTPUT"
    echo "$FIGURES"
    python3 -c 'import json, sys; cells = json.load(sys.stdin)["cells"]
    print("cells", len(cells))
    print("table=" + sys.argv[1] + "/" + cells[-1]["table"], file=open(sys.argv[2], "a"))' \\
      "$OUTPUT" "$GITHUB_OUTPUT" <"$RESULTS"
- uses: me/suite/actions/introspect-csv@v1
  with:
    file: ${{ steps.table.outputs.table }}
    column: RMS (pix)
    row: Averages
    max: 3
- run: echo "matrix=$VERDICT"
  shell: bash
  env:
    VERDICT: ${{ steps.matrix.outputs.verdict }}
""",
        {"my dataset": PROJECT / "datasets" / "t2rgb"},
    )
    assert run.code == 0, run.log
    assert run.installations == ["calibrate"]  # which serves introspect-csv too
    assert "cells 2" in run.printed
    assert "matrix=pass" in run.printed
    [figures] = [line for line in run.printed if line.startswith("success=")]
    success, rms = (float(part.partition("=")[2]) for part in figures.split())
    assert success == 1
    assert 0 < rms < 3


def test_a_cell_beyond_its_limit_is_red_and_named(repository: Repository) -> None:
    run = repository.push(
        """
- id: matrix
  uses: me/suite/actions/calibrate-matrix@v1
  with:
    dataset: my dataset
    evaluate: rgb-to-rgb:left_camera:right_camera
    rules: limits.yml
- if: always()
  run: echo "verdict=$VERDICT success=$SUCCESS"; test -s "$RESULTS"
  shell: bash
  env:
    VERDICT: ${{ steps.matrix.outputs.verdict }}
    SUCCESS: ${{ steps.matrix.outputs.success-rate }}
    RESULTS: ${{ steps.matrix.outputs.results }}
""",
        {
            "my dataset": PROJECT / "datasets" / "t2rgb",
            "limits.yml": "rules:\n- {column: RMS (pix), row: Averages, max: 0.01}\n",
        },
    )
    assert run.code == 1, run.log
    assert "exit status 1" in run.log
    assert any(line.startswith("verdict=fail success=") for line in run.printed)
    assert run.outputs == outputs("actions/calibrate-matrix/action.yml")
    assert any("my dataset" in annotation and "0.01" in annotation for annotation in run.annotations)


ROBOT = PROJECT / "datasets" / "t2rgb"
COLLECT = """
- id: collect
  uses: me/suite/actions/collect-data-sim@v1
  with:
    system: my robot
    motion: generate:4
    output: collected data
{more}
- if: always()
  run: echo "verdict=$VERDICT kept=$KEPT"; test -s "$SHEET"; test -s "$DATASET/dataset.json"; test -s "$RESULTS"
  shell: bash
  env:
    VERDICT: ${{{{ steps.collect.outputs.verdict }}}}
    KEPT: ${{{{ steps.collect.outputs.collections }}}}
    SHEET: ${{{{ steps.collect.outputs.contact-sheet }}}}
    DATASET: ${{{{ steps.collect.outputs.dataset }}}}
    RESULTS: ${{{{ steps.collect.outputs.results }}}}
"""


def test_collect_in_simulation(repository: Repository) -> None:
    run = repository.push(COLLECT.format(more="    seed: 3"), {"my robot": ROBOT})
    assert run.code == 0, run.log
    assert run.installations == ["collect"]
    assert "verdict=pass kept=4" in run.printed
    assert run.outputs == outputs("actions/collect-data-sim/action.yml")
    assert run.annotations == []


def test_a_dataset_that_does_not_calibrate_well_enough_is_red(repository: Repository) -> None:
    run = repository.push(COLLECT.format(more='    max-translation-mm: "0.000001"'), {"my robot": ROBOT})
    assert run.code == 1
    assert "exit status 1" in run.log
    assert "verdict=fail kept=4" in run.printed
    [annotation] = run.annotations
    assert "translation error against the truth: found" in annotation


def test_a_dataset_that_is_not_there_is_bad_input(repository: Repository) -> None:
    run = repository.push(
        """
- uses: me/suite/actions/calibrate-matrix@v1
  with:
    dataset: nowhere
"""
    )
    assert run.code == 1
    assert "exit status 2" in run.log
    [annotation] = run.annotations
    assert "nowhere" in annotation
    assert "Traceback" not in run.log


def test_unit_tests_and_their_coverage(repository: Repository) -> None:
    step = """
- id: coverage
  uses: me/suite/actions/coverage-upload@v1
  with:
    run: python3 -m unittest
    service: none
    minimum: MINIMUM
    badge: badge.svg
- if: always()
  run: echo "verdict=$VERDICT rate=$RATE"; test -s badge.svg
  shell: bash
  env:
    VERDICT: ${{ steps.coverage.outputs.verdict }}
    RATE: ${{ steps.coverage.outputs.line-rate }}
"""
    files = {
        "naming.py": "def name(a, b):\n    return f'{a}-{b}'\n\n\ndef unused():\n    return 1\n",
        "test_naming.py": (
            "import unittest\n\nimport naming\n\n\nclass Test(unittest.TestCase):\n"
            "    def test_name(self):\n        self.assertEqual(naming.name(1, 2), '1-2')\n"
        ),
    }
    run = repository.push(step.replace("MINIMUM", "70"), files)
    assert run.code == 0, run.log
    assert run.installations == ["coverage"]
    [line] = [line for line in run.printed if line.startswith("verdict=")]
    assert line == "verdict=pass rate=75.0"
    run = repository.push(step.replace("MINIMUM", "90"))
    assert run.code == 1
    assert any("75" in line and "90" in line for line in run.annotations), run.annotations


def test_the_repositorys_own_pipeline(suite: Path, cache: Path) -> None:
    """The job of push.yml that runs the root action, on the systems that ship."""
    run = Repository(suite, suite, cache).act("push", "--job", "action")
    assert run.code == 0, run.log
    assert run.installations == ["run"]
    assert run.outputs == outputs("action.yml")
