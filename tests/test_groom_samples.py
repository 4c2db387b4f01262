from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from quaffure import InputError
from quaffure.body import BodyModel
from quaffure.geometry import Surface
from quaffure.procedural import STYLES
from quaffure.training import ProceduralGroom, groom_samples
from quaffure.training.groom_samples import cached_samples, family_grooms, library_grooms
from quaffure.training.run_folder import body_digest


def test_samples_are_kept_and_damaged_files_refused(body: BodyModel, surface: Surface, tmp_path: Path) -> None:
    grooms = [*library_grooms(["bob"], [3]), *family_grooms([5])]
    done: list[int] = []
    made = cached_samples(grooms, body, tmp_path, done.append)
    assert done == [1, 2]
    times = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    again = cached_samples(grooms, body, tmp_path, done.append)
    assert times == {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert all(torch.equal(a.features, b.features) for a, b in zip(made, again))
    path = tmp_path / grooms[0].file_name(body_digest(body))
    assert path in times
    np.savez(path, features=np.zeros((5, 3), np.float16), texels=np.zeros(5, np.int16))
    with pytest.raises(InputError, match="features of shape"):
        cached_samples(grooms, body, tmp_path, done.append)
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(InputError, match="made again"):
        cached_samples(grooms, body, tmp_path, done.append)


def test_what_was_edited_is_made_again(body: BodyModel, monkeypatch: pytest.MonkeyPatch) -> None:
    groom = ProceduralGroom("bob", STYLES["bob"], 3)
    taller = replace(body, rest_vertices=body.rest_vertices + torch.tensor([0, 0, 1e-3]))
    file = groom.file_name(body_digest(body))
    assert groom.file_name(body_digest(body)) == file
    edited = [
        replace(groom, controls=replace(groom.controls, length=0.2)).file_name(body_digest(body)),
        replace(groom, seed=4).file_name(body_digest(body)),
        groom.file_name(body_digest(taller)),
    ]
    monkeypatch.setattr(groom_samples, "SAMPLES_VERSION", 2)
    edited.append(groom.file_name(body_digest(body)))
    assert len({file, *edited}) == 5
