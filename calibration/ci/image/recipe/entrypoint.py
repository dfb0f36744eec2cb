"""Start script of containers: sources ROS and the workspace, then executes the command."""

from collections.abc import Iterator

from calibration.ci.image.specification import Recipe

_SETUP_OF_BUILDER = {"catkin_make": "devel/setup.bash", "colcon": "install/setup.bash"}


def entrypoint_script(recipe: Recipe) -> str | None:
    """Return the script, without output of its own; None if there is nothing to do before the command."""
    lines = [*(f"source {file}" for file in sourced(recipe)), *recipe.entrypoint]
    if not lines:
        return None
    return "\n".join(["#!/bin/bash", "set -e", *lines, 'exec "$@"']) + "\n"


def sourced(recipe: Recipe, *, built: bool = True) -> Iterator[str]:
    """Yield the setup files to source; the workspace's only after its build."""
    if recipe.ros is not None:
        yield f"/opt/ros/{recipe.ros}/setup.bash"
    if recipe.workspace is not None and built:
        yield f"{recipe.workspace.path}/{_SETUP_OF_BUILDER[recipe.workspace.tool]}"
