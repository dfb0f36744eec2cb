"""Stage deliver: the bundle of the systems that passed and are accepted."""

import os

from calibration.addons.delivery.bundle import BUNDLE_FOLDER
from calibration.addons.delivery.bundling import RunToBundle, make_bundle
from calibration.addons.delivery.results import Delivered
from calibration.addons.delivery.settings import KEY_VARIABLE, DeliverySettings
from calibration.addons.delivery.writing import write_bundle
from calibration.base.errors import InputError
from calibration.ci.report import remove_results
from calibration.ci.workflow import add_mask
from calibration.engine.baseline.quality import BaselineSettings
from calibration.pipeline.stages.running import PipelineRun


def deliver_stage(run: PipelineRun) -> PipelineRun:
    """Bundle what passed and is accepted; that nothing is to be bundled is no reason of the verdict.

    Raises:
        InputError: the key is wrong.
        InfrastructureError: a file cannot be written.
    """
    settings: DeliverySettings = run.sections.of("delivery")
    folder = run.output / BUNDLE_FOLDER
    if folder.is_dir():  # of an earlier run
        remove_results(folder, [path.name for path in folder.iterdir() if path.is_file()])
    to_bundle = RunToBundle(
        run.results, run.matrix.systems, run.output, run.config or run.output, run.baseline or BaselineSettings()
    )
    try:
        bundle = make_bundle(to_bundle, settings, None)
    except InputError as error:
        return run.with_result("delivery", Delivered(why_not=str(error), folder=BUNDLE_FOLDER))
    if key := os.environ.get(KEY_VARIABLE):
        add_mask(run.runner, key)
    written = write_bundle(bundle, folder, settings.signing_key_file)
    return run.with_result("delivery", Delivered(bundle=written.results(run.output), folder=BUNDLE_FOLDER))
