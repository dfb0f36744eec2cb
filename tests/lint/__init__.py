"""What `make lint` checks beyond ruff, mypy and zizmor, and the conventions of workflows and actions."""
