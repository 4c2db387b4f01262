"""Objects of an FBX file, their properties, and what is connected to what.

An object is a record of the section Objects: a number, a name and a kind (a model, which is a node of the scene, its
geometry, a deformer, an animation curve). Properties that it does not write are those of the template of its kind.
"""

from collections import defaultdict
from dataclasses import dataclass, field
from functools import cached_property
from typing import NoReturn

import numpy as np
from jaxtyping import Float

from quaffure.errors import InputError
from quaffure.io.fbx_records import FbxFile, FbxRecord

SCENE = 0
"""Number of the root of the scene, which is no object of the file."""
USED = {
    "Model", "Geometry", "Deformer", "Material", "Pose", "AnimationStack", "AnimationLayer", "AnimationCurveNode",
    "AnimationCurve",
}  # fmt: skip
"""Names of the records of objects that are read."""
AXES = ("CoordAxis", "UpAxis", "FrontAxis")
"""Settings that say which axes point to the left of a figure, up, and where it is turned to: x, y and z in glTF."""
BYTES_A_VISIT = 100
"""What following a connection counts for: small files may lead to one object on very many ways, which takes time."""
UNITS = (1e-4, 1e6)
"""Smallest and largest unit that is accepted [cm]."""


@dataclass(frozen=True, eq=False)
class Properties:
    """Properties of an object by name, those of a template where it has none.

    `number`, `integer` and `vector` raise `InputError` where a property is of another type, not finite or beyond
    `LARGEST_NUMBER`.
    """

    records: dict[str, FbxRecord]
    template: dict[str, FbxRecord] = field(default_factory=dict)

    def __contains__(self, name: object) -> bool:
        return name in self.records or name in self.template

    def number(self, name: str, default: float) -> float:
        record = self._record(name)
        return default if record is None else record.real(4)

    def integer(self, name: str, default: int) -> int:
        record = self._record(name)
        return default if record is None else record.integer(4)

    def vector(self, name: str, default: float = 0.0) -> Float[np.ndarray, "3"]:
        record = self._record(name)
        return np.full(3, default) if record is None else np.array([record.real(4 + axis) for axis in range(3)])

    def _record(self, name: str) -> FbxRecord | None:
        return self.records.get(name, self.template.get(name))


@dataclass(frozen=True, eq=False)
class FbxObject:
    """An object of the file.

    Attributes:
        identity: its number.
        name: as written; several may have the same.
        kind: of its kind, such as `Limb` of a model.
        record: all of it.
        template: properties of its kind.
    """

    identity: int
    name: str
    kind: str
    record: FbxRecord
    template: dict[str, FbxRecord]

    @cached_property
    def properties(self) -> Properties:
        return Properties(properties_of(self.record), self.template)

    def fail(self, expected: str, found: str) -> NoReturn:
        """Refuse the file because of this object.

        Raises:
            InputError: always.
        """
        self.record.fail(f"{expected} ({self.record.name} '{self.name[:60]}')", found)


@dataclass(frozen=True, eq=False)
class Connection:
    """An object that belongs to another, or to a property of it; no name where it belongs to the object."""

    child: FbxObject
    name: str


@dataclass(frozen=True, eq=False)
class FbxDocument:
    """Objects and connections of a file.

    Attributes:
        file: the bytes.
        objects: by number.
        connections: by the number of the object that others belong to, in the order of the file.
    """

    file: FbxFile
    objects: dict[int, FbxObject]
    connections: dict[int, list[Connection]]
    _owners: dict[int, list[tuple[FbxObject, str]]]

    def owners(self, child: FbxObject) -> list[tuple[FbxObject, str]]:
        """Objects that have another in one of their properties, and the name of it.

        Raises:
            InputError: more connections were followed than a file of this size should need.
        """
        found = self._owners.get(child.identity, [])
        child.record.reserve(BYTES_A_VISIT * len(found))
        return found

    def fail(self, expected: str, found: str) -> NoReturn:
        """Refuse the file.

        Raises:
            InputError: always.
        """
        raise InputError(self.file.path, expected, found)

    def objects_of_type(self, name: str) -> list[FbxObject]:
        """All objects of a type, the name of their records, such as `Model`."""
        return [found for found in self.objects.values() if found.record.name == name]

    def below(self, parent: FbxObject | int, record: str, kind: str = "") -> list[FbxObject]:
        """Objects that belong to another, by the name of their records, and by their kind where one is given.

        Raises:
            InputError: more connections were followed than a file of this size should need.
        """
        return [
            connection.child
            for connection in self._connections_of(parent if isinstance(parent, int) else parent.identity)
            if not connection.name and connection.child.record.name == record and kind in ("", connection.child.kind)
        ]

    def on_properties(self, parent: FbxObject, record: str) -> list[Connection]:
        """Objects that belong to properties of another.

        Raises:
            InputError: more connections were followed than a file of this size should need.
        """
        connections = self._connections_of(parent.identity)
        return [found for found in connections if found.name and found.child.record.name == record]

    def _connections_of(self, number: int) -> list[Connection]:
        connections = self.connections.get(number, [])
        if number in self.objects:
            self.objects[number].record.reserve(BYTES_A_VISIT * len(connections))
        return connections

    @cached_property
    def scene_from_file(self) -> Float[np.ndarray, "4 4"]:
        """The way from the file's axes and unit to those of glTF: metres, y up, facing +z.

        Raises:
            InputError: axes that are no right-handed set, or a unit beyond any use.
        """
        settings = self.file.section("GlobalSettings")
        if settings is None:
            return np.diag([0.01, 0.01, 0.01, 1.0])  # centimetres, y up, are the format's own
        properties = Properties(properties_of(settings))
        matrix = np.zeros((4, 4))
        for row, name in enumerate(AXES):
            axis, sign = properties.integer(name, (0, 1, 2)[row]), properties.integer(f"{name}Sign", 1)
            if axis not in (0, 1, 2) or sign not in (-1, 1):
                settings.fail(f"{name} 0, 1 or 2, its sign 1 or -1", f"{axis}, {sign}")
            matrix[row, axis] = sign
        if round(np.linalg.det(matrix[:3, :3])) != 1:
            settings.fail("right-handed axes", "a left-handed set, or one axis twice")
        unit = properties.number("UnitScaleFactor", 1.0)
        if not UNITS[0] <= unit <= UNITS[1]:
            settings.fail(f"a unit of {UNITS[0]:g} to {UNITS[1]:g} cm", f"{unit:g}")
        matrix *= 0.01 * unit
        matrix[3, 3] = 1.0
        return matrix


def read_document(file: FbxFile) -> FbxDocument:
    """The objects of a file, and what belongs to what.

    Raises:
        InputError: no objects or connections, or two objects of a number.
    """
    section, links = file.section("Objects"), file.section("Connections")
    if section is None or links is None:
        raise InputError(file.path, "sections Objects and Connections", "one or none of them")
    templates = _templates(file)
    objects: dict[int, FbxObject] = {}
    for record in (record for record in section.children if record.name in USED):
        identity, name = record.integer(0), record.text(1).split("\0")[0].strip()
        if identity in objects or identity == SCENE:
            record.fail("an object with a number of its own", f"{identity} again")
        objects[identity] = FbxObject(identity, name, record.text(2), record, templates.get(record.name, {}))
    connections: dict[int, list[Connection]] = defaultdict(list)
    owners: dict[int, list[tuple[FbxObject, str]]] = defaultdict(list)
    for record in links.children:
        if record.name != "C" or (how := record.text(0)) not in ("OO", "OP"):
            continue
        child, parent = record.integer(1), record.integer(2)
        if child in objects:
            name = record.text(3) if how == "OP" else ""
            connections[parent].append(Connection(objects[child], name))
            if name and parent in objects:
                owners[child].append((objects[parent], name))
    return FbxDocument(file, objects, dict(connections), dict(owners))


def properties_of(record: FbxRecord) -> dict[str, FbxRecord]:
    """The properties that a record lists, by name."""
    listed = record.child("Properties70")
    return {} if listed is None else {entry.text(0): entry for entry in listed.children if entry.name == "P"}


def _templates(file: FbxFile) -> dict[str, dict[str, FbxRecord]]:
    """Properties that objects have if they do not write them, by the name of their records."""
    section = file.section("Definitions")
    kinds = [] if section is None else [record for record in section.children if record.name == "ObjectType"]
    templates = {kind.text(0): kind.child("PropertyTemplate") for kind in kinds}
    return {name: properties_of(template) for name, template in templates.items() if template is not None}
