"""Static analysis of a repository: analysers run on a copy of its files, and only new findings of a change count.

Knows nothing of calibration, and runs nothing of what it analyses.

- ``settings``: options, limits of the number of findings, accepted findings;
- ``copies``: the tracked files, and those of an earlier commit, as folders without links; new findings between them;
- ``analysers``: the external programs and our own checks, their output as findings, and the metrics of code;
- ``results``, ``report``: the output formats, SARIF among them;
- ``static_analysis``: the command, the stage analyse of a pipeline, and what they do.
"""

from calibration.base.addons import Addon, AddonStage, DocumentSection, LazyCommand, SchemaFile

ADDON = Addon(
    commands={
        "static-analysis": LazyCommand(
            f"{__name__}.static_analysis:command", "Check the code for errors; fail for those that a change adds."
        )
    },
    sections={
        "analysis": DocumentSection(
            f"{__name__}.settings:AnalysisSettings",
            "Static analysis of the repository around this file, a stage of run; {} for the defaults.",
        )
    },
    stages={
        "analyse": AddonStage(
            f"{__name__}.static_analysis:analyse_stage",
            section="analysis",
            result=DocumentSection(
                f"{__name__}.results:Analysed", "Static analysis, where calibration.yml asks for it."
            ),
        )
    },
    schemas={"analysis": SchemaFile(__name__, "results.schema.json", "results:AnalysisResults", "static-analysis")},
)
