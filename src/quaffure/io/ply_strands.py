"""Strands and meshes in Stanford's PLY, as reconstruction tools write them.

The vertices of a strand follow one another from root to tip. Which of them make a strand is said by an element that has
a number for each strand (`strand` with `nsegs`), or a list of its vertices; or by an element `edge` of pairs
(`vertex1`, `vertex2`), of which a strand is a chain; or by an integer of each vertex (`strand`). Integer colours are
sRGB, others linear.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from quaffure.errors import InputError
from quaffure.hair.strand_attributes import NONE, StrandAttributes, groups_of
from quaffure.hair.strands import Strands, checked_strands
from quaffure.io.ply import COLOUR, LINEAR_COLOUR, linear_of
from quaffure.io.ply_tables import Table, read_ply_tables, vertices_of

STRAND_ELEMENTS = ("strand", "strands", "curve", "curves", "polyline", "hair")
SEGMENT_COUNTS = ("nsegs", "segments", "num_segments", "segment_count")
VERTEX_COUNTS = ("nverts", "npoints", "vertices", "num_vertices", "vertex_count", "count", "num_points")
VERTEX_LISTS = ("vertex_indices", "vertex_index")
WIDTHS = {"width": 1.0, "thickness": 1.0, "diameter": 1.0, "radius": 2.0}
"""Properties of a vertex that give its width, and widths in one of each."""
IDS, GROUPS = ("id", "groom_id"), ("group", "group_id", "groom_group_id")
ROOT_UVS = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
"""Properties of a strand."""
STRAND_INDICES = ("strand", "strand_id", "strand_index")


def read_ply(path: Path) -> Strands:
    """Strands of a .ply file, in its own units and axes.

    Raises:
        InputError: not a .ply file, cut short, or without strands.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # what float32 cannot hold is refused as infinite
        tables = read_ply_tables(path)
        points = vertices_of(tables, path)
        order, counts = _strands(tables, len(points), path)
        attributes = replace(_of_strands(tables, len(counts)), **_of_points(tables["vertex"], order))
        return checked_strands(points[order], counts, path, attributes=attributes)


def read_ply_mesh(path: Path) -> tuple[np.ndarray, list[np.ndarray]]:
    """Vertices [V,3] and polygons of a .ply file.

    Raises:
        InputError: not a .ply file, cut short, or without faces.
    """
    tables = read_ply_tables(path)
    for name in VERTEX_LISTS:
        if name in tables.get("face", {}):
            return vertices_of(tables, path), [np.asarray(row, dtype=np.int64) for row in tables["face"][name]]
    raise InputError(path, "faces of vertex_indices", f"elements {', '.join(tables) or 'none'}")


def _of_points(vertices: Table, order: np.ndarray) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, factor in WIDTHS.items():
        if (width := _columns(vertices, (name,))) is not None:
            found["width"] = factor * width[order, 0]
            break
    linear, colour = _columns(vertices, LINEAR_COLOUR), _columns(vertices, COLOUR)
    if linear is not None or colour is not None:
        is_integer = linear is None and all(np.asarray(vertices[name]).dtype.kind in "iu" for name in COLOUR)
        values = colour if linear is None else linear
        assert values is not None
        found["colour"] = linear_of(values[order] / 255.0) if is_integer else values[order]
    return found


def _of_strands(tables: dict[str, Table], strands: int) -> StrandAttributes:
    """Properties of the first element that has a row for each strand, by `STRAND_ELEMENTS`."""
    table = next((tables[name] for name in STRAND_ELEMENTS if name in tables), {})
    columns = [values for values in table.values() if isinstance(values, np.ndarray)]
    if not columns or len(columns[0]) != strands:
        return NONE
    numbers, groups = (_first(table, [(name,) for name in names]) for names in (IDS, GROUPS))
    root_uv = _first(table, ROOT_UVS)
    of_groups = NONE if groups is None else groups_of(groups[:, 0], None, strands, "group")
    return replace(of_groups, identifier=None if numbers is None else numbers[:, 0].astype(np.int64), root_uv=root_uv)


def _first(table: Table, names: Sequence[tuple[str, ...]]) -> np.ndarray | None:
    return next((found for some in names if (found := _columns(table, some)) is not None), None)


def _columns(table: Table, names: tuple[str, ...]) -> np.ndarray | None:
    """Properties of numbers side by side; None unless there are all of them."""
    found = [table[name] for name in names if isinstance(table.get(name), np.ndarray)]
    return np.stack([np.asarray(one, np.float64) for one in found], axis=1) if len(found) == len(names) else None


def _strands(tables: dict[str, Table], vertices: int, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Indices of vertices, strand after strand, and vertices of each strand."""
    for name in STRAND_ELEMENTS:
        table = tables.get(name, {})
        for keys, extra in ((SEGMENT_COUNTS, 1), (VERTEX_COUNTS, 0)):
            if found := [key for key in keys if isinstance(table.get(key), np.ndarray)]:
                counts = np.asarray(table[found[0]], dtype=np.int64) + extra
                return np.arange(min(vertices, max(int(counts.sum()), 0))), counts
        if found := [key for key in VERTEX_LISTS if key in table]:
            rows = [np.asarray(row, dtype=np.int64) for row in table[found[0]]]
            return _checked(np.concatenate([np.empty(0, np.int64), *rows]), vertices, path), np.array([*map(len, rows)])
    if {"vertex1", "vertex2"} <= {*tables.get("edge", {})}:
        edges = np.stack([np.asarray(tables["edge"][key], dtype=np.int64) for key in ("vertex1", "vertex2")], axis=1)
        return _chains(_checked(edges, vertices, path), vertices, path)
    for name in STRAND_INDICES:
        if name in tables["vertex"]:
            strand = np.asarray(tables["vertex"][name])
            starts = np.flatnonzero(np.diff(strand)) + 1
            return np.arange(vertices), np.diff([0, *starts, vertices])
    expected = (
        f"strands: an element {STRAND_ELEMENTS[0]} with {SEGMENT_COUNTS[0]}, an element edge, or a vertex property"
    )
    raise InputError(path, f"{expected} {STRAND_INDICES[0]}", f"elements {', '.join(tables)}")


def _checked(indices: np.ndarray, vertices: int, path: Path) -> np.ndarray:
    if len(indices) and not 0 <= indices.min() <= indices.max() < vertices:
        raise InputError(path, f"indices of its {vertices} vertices", f"{indices.min()} to {indices.max()}")
    return indices


def _chains(edges: np.ndarray, vertices: int, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Chains of edges, each from the end that comes first in the file."""
    low, high = edges.min(1, initial=vertices), edges.max(1, initial=-1)
    if (high == low + 1).all() and len(np.unique(low)) == len(low):
        joined = np.zeros(vertices, dtype=bool)
        joined[high] = True  # a vertex that continues the strand of the one before it
        return np.arange(vertices), np.diff([*np.flatnonzero(~joined), vertices])
    neighbours: list[list[int]] = [[] for _ in range(vertices)]
    for first, second in edges.tolist():
        neighbours[first].append(second)
        neighbours[second].append(first)
    if any(len(others) > 2 for others in neighbours):
        raise InputError(path, "edges that make chains", "a vertex of three edges")
    order, counts, visited = list[int](), list[int](), [False] * vertices
    for start in range(vertices):
        if visited[start] or len(neighbours[start]) != 1:
            continue
        before, at = len(order), start
        while at >= 0:
            visited[at] = True
            order.append(at)
            at = next((other for other in neighbours[at] if not visited[other]), -1)
        counts.append(len(order) - before)
    return np.array(order, dtype=np.int64), np.array(counts, dtype=np.int64)
