from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import quaffure.procedural
from quaffure.body.body_model import BodyModel
from quaffure.errors import InputError
from quaffure.geometry.surface import Surface
from quaffure.procedural.hair_style import STYLES
from quaffure.training import groom_samples
from quaffure.training.groom_samples import Growing, family_growings, grow_samples, library_growings
from quaffure.training.run_folder import body_digest


def test_grown_samples_are_kept_and_damaged_files_refused(body: BodyModel, surface: Surface, tmp_path: Path) -> None:
    growings = [*library_growings(["bob"], [3]), *family_growings([5])]
    done: list[int] = []
    grown = grow_samples(growings, body, surface, tmp_path, done.append)
    assert done == [1, 2]
    times = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    again = grow_samples(growings, body, surface, tmp_path, done.append)
    assert times == {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert all(torch.equal(a.features, b.features) for a, b in zip(grown, again))
    path = tmp_path / growings[0].file_on(body_digest(body))
    assert path in times
    np.savez(path, features=np.zeros((5, 3), np.float16), texels=np.zeros(5, np.int16))
    with pytest.raises(InputError, match="features of shape"):
        grow_samples(growings, body, surface, tmp_path, done.append)
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(InputError, match="made again"):
        grow_samples(growings, body, surface, tmp_path, done.append)


def test_what_was_edited_is_grown_anew(body: BodyModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    growing = Growing("bob", STYLES["bob"], 3)
    taller = replace(body, rest_vertices=body.rest_vertices + torch.tensor([0, 0, 1e-3]))
    file = growing.file_on(body_digest(body))
    assert growing.file_on(body_digest(body)) == file
    edited = [
        replace(growing, controls=replace(growing.controls, length=0.2)).file_on(body_digest(body)),
        growing.file_on(body_digest(taller)),
    ]
    generator = tmp_path / "procedural.py"
    monkeypatch.setattr(quaffure.procedural, "__path__", [str(tmp_path)])
    for code in ("grow()", "grow(faster=True)"):
        generator.write_text(code)
        groom_samples._digest_of_sources.cache_clear()
        edited.append(growing.file_on(body_digest(body)))
    groom_samples._digest_of_sources.cache_clear()
    assert len({file, *edited}) == 5
