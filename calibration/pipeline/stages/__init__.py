"""Stages of a pipeline, run in order; they communicate by files, so each can run alone."""

from calibration.pipeline.stages.running import STAGES, PipelineRun, run_stages
