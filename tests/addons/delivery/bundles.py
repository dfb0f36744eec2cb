"""A small bundle, its keys, and what is in use on its robot: made in memory, without a calibration."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from calibration.addons.delivery.attestation import key_id, signed_envelope, statement_of
from calibration.addons.delivery.destinations import FetchedBundle
from calibration.addons.delivery.manifest import (
    MANIFEST_FILE,
    BundledCamera,
    BundledFile,
    BundledSystem,
    BundledTransform,
    JudgedStart,
    Manifest,
    pack_files,
)
from calibration.base.records import document_of

DAY = 86400
MADE = 1_790_000_000
KEY, OTHER_KEY = (Ed25519PrivateKey.from_private_bytes(bytes([number] * 32)) for number in (1, 2))
TRUSTED = {key_id(KEY.public_key()): KEY.public_key()}
DESCRIPTION = b"<robot name='r'/>"
NAME = "robot.calibration.tar"


def camera(name: str, fx: float) -> BundledCamera:
    K = (fx, 0.0, 320.5, 0.0, fx, 240.5, 0.0, 0.0, 1.0)
    return BundledCamera(
        name=name,
        frame=f"{name}_optical",
        width=640,
        height=480,
        distortion_model="plumb_bob",
        K=K,
        D=(0.1, -0.02, 0.0, 0.001, 0.0),
    )


LEFT = BundledTransform(parent="base", child="left", trans=(0.1, 0.2, 0.3), quat=(0.48, 0.64, 0.0, 0.6))
RIGHT = BundledTransform(parent="base", child="right", trans=(0.1, -0.2, 0.3), quat=(0.0, 0.0, 0.6, 0.8))
ELBOW = BundledTransform(parent="arm", child="elbow", trans=(0.0, 0.0, 0.5), quat=(0.0, 0.0, 0.0, 1.0), joint=True)
SYSTEM = BundledSystem(
    name="stereo",
    verdict="pass",
    starts=(JudgedStart("stereo, 0 m, 0 rad, seed 1", "pass"),),
    labels="1" * 64,
    description=hashlib.sha256(DESCRIPTION).hexdigest(),
    transforms=(LEFT, RIGHT, ELBOW),
    cameras=(camera("left_camera", 500.0), camera("right_camera", 510.0)),
)
FILES = {"stereo/tf_static.yaml": b"transforms: []\n", "stereo/calibration.json": b"{}\n"}
MANIFEST = Manifest(
    bundle=1,
    name="robot",
    version="1.4",
    made=MADE,
    serial="SN-1",
    engine="0.1.0",
    commit="a" * 40,
    configuration="2" * 64,
    systems=(SYSTEM,),
    files=(),
)


def packed(manifest: Manifest = MANIFEST, **files: bytes) -> bytes:
    """Return the archive of a bundle whose manifest lists its files."""
    contents = {**FILES, **files}
    listed = tuple(
        BundledFile(path, len(contents[path]), hashlib.sha256(contents[path]).hexdigest()) for path in sorted(contents)
    )
    return pack_files({**contents, MANIFEST_FILE: replace(manifest, files=listed).text.encode()})


def signed(content: bytes, manifest: Manifest = MANIFEST, key: Ed25519PrivateKey = KEY) -> FetchedBundle:
    """Return a bundle with its attestation."""
    return FetchedBundle(NAME, content, signed_envelope(statement_of(content, NAME, manifest), key).encode())


def write_bundle_files(folder: Path, fetched: FetchedBundle) -> Path:
    """Write a bundle, its attestation and the public key."""
    path = folder / NAME
    path.write_bytes(fetched.content)
    if fetched.attestation is not None:
        path.with_name(f"{NAME}.intoto.jsonl").write_bytes(fetched.attestation)
    (folder / "key.pub").write_bytes(public_pem(KEY))
    return path


def public_pem(key: Ed25519PrivateKey) -> bytes:
    return key.public_key().public_bytes(serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo)


def private_pem(key: Ed25519PrivateKey = KEY) -> str:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    ).decode()


URDF = """<?xml version="1.0"?>
<robot name="r">
  <link name="base"/><link name="mount"/><link name="left"/><link name="right"/><link name="arm"/><link name="elbow"/>
  <joint name="m" type="fixed"><parent link="base"/><child link="mount"/><origin xyz="0.1 -0.2 0"/></joint>
  <joint name="r" type="fixed">
    <parent link="mount"/><child link="right"/><origin xyz="0 0 0.3" rpy="0 0 1.2870022175866"/>
  </joint>
  <joint name="l" type="fixed">
    <parent link="base"/><child link="left"/>
    <origin xyz="0.1 0.2 0.3" rpy="{rpy}"/>
  </joint>
  <joint name="e" type="revolute"><parent link="arm"/><child link="elbow"/><origin xyz="0 0 0.5"/></joint>
</robot>
"""


def messages(*transforms: BundledTransform) -> dict[str, Any]:
    """Return transforms as a message of /tf_static has them."""
    return {
        "transforms": [
            {
                "header": {"frame_id": each.parent},
                "child_frame_id": each.child,
                "transform": {
                    "translation": dict(zip("xyz", each.trans, strict=True)),
                    "rotation": dict(zip("xyzw", each.quat, strict=True)),
                },
            }
            for each in transforms
        ]
    }


def camera_info(of: BundledCamera, **changes: Any) -> dict[str, Any]:
    """Return intrinsics as ``ros2 topic echo`` prints them."""
    K = of.K
    document = {
        "header": {"frame_id": of.frame},
        "width": of.width,
        "height": of.height,
        "distortion_model": of.distortion_model,
        "d": list(of.D),
        "k": list(K),
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": [*K[:3], 0.0, *K[3:6], 0.0, *K[6:], 0.0],
    }
    return {**document, **changes}


def write_yaml(path: Path, *documents: object) -> Path:
    path.write_text("---\n".join(yaml.safe_dump(each) for each in documents))
    return path


def document_of_manifest(manifest: Manifest = MANIFEST) -> Any:
    return json.loads(json.dumps(document_of(manifest)))
