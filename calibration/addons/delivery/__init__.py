"""Delivery of calibrations: a bundle with a proof, and a check of it on the robot.

- ``manifest``: the tar of a bundle, and what it says of itself;
- ``attestation``: an in-toto statement in a DSSE envelope, signed by a team's key;
- ``bundling``: a bundle of the results of a run, and its files;
- ``destinations``: a bundle in a file, a folder, a registry or GitHub's releases, and delivery to these;
- ``changes``: what differs between two bundles, the version that follows, and delivery;
- ``deliver``: the commands ``bundle`` and ``deliver``, and the stage;
- ``fleet``: the command that compares the robots of a fleet;
- ``checking``: whether a bundle is accepted on this robot, and is what is in use;
- ``in_use``: transforms and cameras that are in use;
- ``results``: the section ``delivery``, and the output; ``verify``: the command, which needs no numpy.
"""

from calibration.base.addons import Addon, AddonStage, DocumentSection, LazyCommand, SchemaFile

ADDON = Addon(
    commands={
        "bundle": LazyCommand(
            f"{__name__}.deliver:bundle_command", "Pack accepted calibrations for the robot, and sign them."
        ),
        "deliver": LazyCommand(
            f"{__name__}.deliver:deliver_command", "Bundle and deliver: to a registry, a release, a folder."
        ),
        "fleet": LazyCommand(f"{__name__}.fleet:command", "Compare the accepted calibrations of a fleet's robots."),
        "verify": LazyCommand(f"{__name__}.verify:command", "Check on the robot what was bundled, and what is in use."),
    },
    sections={
        "delivery": DocumentSection(
            f"{__name__}.results:DeliverySettings",
            "A bundle for the robot of what passed and is accepted, a stage of run; {} for the defaults.",
        )
    },
    stages={
        "deliver": AddonStage(
            f"{__name__}.deliver:deliver_stage",
            section="delivery",
            result=DocumentSection(
                f"{__name__}.results:Delivered", "The bundle for the robot, where calibration.yml asks for one."
            ),
            last=True,
        )
    },
    schemas={
        "verify-results": SchemaFile(__name__, "results.schema.json", "results:VerifyResults", "verify"),
        "fleet-results": SchemaFile(__name__, "fleet.schema.json", "fleet:FleetResults", "fleet"),
        "bundle-manifest": SchemaFile(__name__, "manifest.schema.json", "manifest:Manifest"),
    },
)
