"""Stages of a pipeline, run in order; they communicate by files, so each can run alone."""

from calibration.pipeline.stages.running import STAGES, Run, run_stages

__all__ = ["STAGES", "Run", "run_stages"]
