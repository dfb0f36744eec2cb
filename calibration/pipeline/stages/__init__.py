"""The stages of a pipeline, one after the other; files go between them, so each can run alone."""

from calibration.pipeline.stages.running import STAGES, Run, run_stages

__all__ = ["STAGES", "Run", "run_stages"]
