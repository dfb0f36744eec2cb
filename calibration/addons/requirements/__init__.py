"""Requirements over messages, judged over a bag: ROS is not needed.

- ``settings``: the section ``requirements`` of calibration.yml;
- ``message_fields``: fields of a message, read from its bytes;
- ``requirement``: the state machine that every requirement is, and those of one topic;
- ``hpl``, ``predicates``, ``patterns``: properties in HPL;
- ``judging``: a bag is read once, and each requirement fed with the messages of its topics; those of frames, nodes
  and services;
- ``live``: a watch by rosbridge while the containers run, which only ends early what has failed already;
- ``results``: the output; ``check_messages``: the command, and the stage judge of a pipeline.
"""

from calibration.base.addons import Addon, AddonStage, DocumentSection, LazyCommand, SchemaFile

ADDON = Addon(
    commands={
        "check-messages": LazyCommand(
            f"{__name__}.check_messages:command", "Judge requirements over the messages of a bag."
        )
    },
    sections={
        "requirements": DocumentSection(
            f"{__name__}.settings:RequirementSettings",
            "What must hold of the robot's messages, judged over a bag in a stage of run.",
        )
    },
    stages={
        "judge": AddonStage(
            f"{__name__}.check_messages:judge_stage",
            section="requirements",
            result=DocumentSection(
                f"{__name__}.results:JudgedMessages",
                "Requirements over messages, where calibration.yml asks for them.",
            ),
            job="check-messages",
        )
    },
    watches={"requirements": f"{__name__}.live:live_watch"},
    schemas={"messages": SchemaFile(__name__, "results.schema.json", "results:MessageResults", "check-messages")},
)
