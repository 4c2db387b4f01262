"""`quaffure rig`: the body with its skeleton and a groom at rest, for programs that animate it."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from quaffure.apps.cli.console import console
from quaffure.apps.cli.inputs import body_shape_of
from quaffure.body.body_model import load_body
from quaffure.hair.groom_binding import groom_binding
from quaffure.io.atomic import replacing
from quaffure.io.load_groom import load_groom
from quaffure.io.output_path import check_output


@dataclass(frozen=True)
class RigCommand:
    """Write the body in its rest pose, its joints and skin weights, and a groom on it, as .npz."""

    groom: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="GROOM")]
    """A bundled groom (see `quaffure grooms`) or a file."""
    out: Path
    """Where to write (.npz), in metres, z up: strands [S,N,3], root_uv, body_vertices, body_faces, body_uv, body_shape,
    joint_names, joint_parents, rest_joints, skin_joints, skin_weights."""
    body: Path | None = None
    """A body of your own (.npz, from `quaffure body import`) instead of the shipped one."""
    shape: str = ""
    """Ten body shape coefficients separated by commas, or a file that holds them; without it, the mean body."""

    def run(self) -> None:
        check_output(self.out, ".npz", inputs=(self.groom, self.shape, self.body))
        body, body_shape = load_body(self.body), body_shape_of(self.shape)
        groom = load_groom(self.groom, body)
        binding = groom_binding(groom, body, body_shape)
        arrays = {
            "strands": binding.strands,
            "root_uv": binding.root_uv,
            "body_vertices": binding.body_vertices,
            "body_faces": body.faces.numpy(),
            "body_uv": binding.body_uv,
            "body_shape": body_shape.numpy(),
            "joint_names": np.array(body.joint_names),
            "joint_parents": np.array(body.joint_parents),
            "rest_joints": body.shaped_joints(body_shape[None])[0].numpy(),
            "skin_joints": body.skin_joints.numpy(),
            "skin_weights": body.skin_weights.numpy(),
            "meta": np.array(json.dumps({"groom": groom.name, "licence": groom.licence}, ensure_ascii=False)),
        }
        with replacing(self.out) as temporary, temporary.open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]  # taken for numpy's allow_pickle
        console.print(f"written: {self.out}")
