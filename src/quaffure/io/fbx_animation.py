"""Animations of an FBX file: translation, rotation and scale of models, and weights of shapes, between their keys.

A rotation is three curves of angles, which are sampled as quaternions. Where all curves of a node are at most `SPARSE`
between two keys, quaternions and numbers are joined by lines as in glTF; longer ways are divided.
"""

from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from quaffure.body.character import AnimationChannel, CharacterAnimation, CharacterNodes
from quaffure.io.distinct_names import DistinctNames
from quaffure.io.fbx_curves import FbxCurve, read_curve
from quaffure.io.fbx_document import FbxDocument, FbxObject, Properties
from quaffure.io.fbx_mesh import FbxMesh
from quaffure.io.fbx_nodes import CONSTANT, SCALE_TOLERANCE, UNIFORM, FbxScene, scale_limits

PATHS = {"Lcl Translation": "translation", "Lcl Rotation": "rotation", "Lcl Scaling": "scale"}
COMPONENTS = ("d|X", "d|Y", "d|Z")
PERCENT = "DeformPercent"
SPARSE, PART = 0.1, 1 / 60
"""Intervals longer than `SPARSE` are subdivided into intervals of at most `PART` [s]."""
BYTES_A_TIME, BYTES_WHILE_SAMPLED = 100, 800  # of a node, kept and while it is sampled
BYTES_A_NODE, BYTES_A_SLIDER = 1000, 100  # of an animation, whether it moves them or not
BYTES_A_MOVED_NODE = 10_000  # of an animation; a bound on its time, more than on its memory
MOVED = 1e-9

Times = Float[np.ndarray, " f"]
Key = TypeVar("Key", str, int)


@dataclass
class _Numbers:
    """One to three numbers of a property, each with a curve or the same over time."""

    curves: dict[int, FbxCurve]
    still: Float[np.ndarray, " c"]

    def at(self, times: Times, is_before: bool) -> Float[np.ndarray, "f c"]:
        values = np.repeat(self.still[None], len(times), axis=0)
        for component, curve in self.curves.items():
            values[:, component] = curve.at(times, is_before)
        return values


@dataclass
class _Animation:
    """What one animation moves.

    Attributes:
        name: of the animation.
        stack: its object, for messages.
        nodes: by node and path, numbers of models that move [units of the file, degrees].
        channels: weight of each channel of shapes, by its number [percent].
    """

    name: str
    stack: FbxObject
    nodes: dict[int, dict[str, _Numbers]] = field(default_factory=dict)
    channels: dict[int, _Numbers] = field(default_factory=dict)


def read_animations(
    document: FbxDocument, scene: FbxScene, nodes: CharacterNodes, meshes: list[FbxMesh]
) -> tuple[CharacterAnimation, ...]:
    """The animations of a file that move nodes or shapes.

    Args:
        nodes: of the scene, at rest.

    Raises:
        InputError: two layers that move the same, a curve that is damaged, or a scale that moves above a node that does
            not take it on.
    """
    sliders = [c.channel.identity for found in meshes for c in found.geometry.channels]
    channels, stacks = set(sliders), document.objects_of_type("AnimationStack")
    limits, elsewhere = (scale_limits(scene), _elsewhere(scene, nodes)) if stacks else ([], [])
    animations = []
    names = DistinctNames()
    for index, stack in enumerate(stacks):
        animation = _Animation(stack.name or f"animation{index}", stack)
        for layer in document.below(stack, "AnimationLayer"):
            _add_layer(animation, layer, document, scene, channels)
        if animation.nodes or animation.channels:
            stack.record.reserve(BYTES_A_NODE * len(nodes) + BYTES_A_SLIDER * len(sliders))
            stack.record.reserve(BYTES_A_MOVED_NODE * len(animation.nodes))
            made = [*_node_channels(animation, scene, limits, elsewhere), *_weight_channels(animation, meshes)]
            animations.append(CharacterAnimation(names.add(animation.name), tuple(made)))
    return tuple(animations)


def _add_layer(
    animation: _Animation, layer: FbxObject, document: FbxDocument, scene: FbxScene, channels: set[int]
) -> None:
    """Add what a layer moves."""
    for curve_node in document.below(layer, "AnimationCurveNode"):
        curves = {
            connection.name: curve
            for connection in reversed(document.on_properties(curve_node, "AnimationCurve"))
            if (curve := read_curve(connection.child)) is not None
        }
        for owner, name in document.owners(curve_node) if curves else ():
            if name in PATHS and owner.identity in scene.node_of_model:
                node = scene.node_of_model[owner.identity]
                own = getattr(scene.transforms[node - 1], PATHS[name])
                numbers = _numbers(curve_node, curves, COMPONENTS, own)
                if numbers.curves:
                    _add(animation.nodes.setdefault(node, {}), PATHS[name], numbers, owner)
            elif name == PERCENT and owner.identity in channels:
                own = np.array([owner.properties.number(PERCENT, 0.0)])
                numbers = _numbers(curve_node, curves, (f"d|{PERCENT}",), own)
                if numbers.curves:
                    _add(animation.channels, owner.identity, numbers, owner)


def _add(known: dict[Key, _Numbers], key: Key, numbers: _Numbers, owner: FbxObject) -> None:
    if key in known:
        owner.fail("an animation in one layer (merge or bake its layers)", "two that move the same")
    known[key] = numbers


def _numbers(
    curve_node: FbxObject, curves: dict[str, FbxCurve], names: tuple[str, ...], own: Float[np.ndarray, " c"]
) -> _Numbers:
    """The numbers of a property; those without a curve are the curve node's, or else the object's own."""
    properties = Properties(curve_node.properties.records)  # without those of a template
    still = np.array([properties.number(name, value) for name, value in zip(names, own)])
    return _Numbers({index: curves[name] for index, name in enumerate(names) if name in curves}, still)


def _elsewhere(scene: FbxScene, nodes: CharacterNodes) -> list[dict[str, Float[np.ndarray, " c"]]]:
    """Translation, rotation and scale of each model without an animation, where nodes are at rest with others."""
    found: list[dict[str, Float[np.ndarray, " c"]]] = [{}]
    for node, transform in enumerate(scene.transforms, 1):
        local = zip(PATHS.values(), transform.at_rest)
        found.append({path: own for path, own in local if _differs(own, getattr(nodes, path)[node], path)})
    return found


def _node_channels(
    animation: _Animation, scene: FbxScene, limits: list[int], elsewhere: list[dict[str, Float[np.ndarray, " c"]]]
) -> list[AnimationChannel]:
    """Channels of all nodes that move, and of those that are elsewhere than at rest."""
    numbers = [each for paths in animation.nodes.values() for each in paths.values()]
    spans = [curve.times for each in [*numbers, *animation.channels.values()] for curve in each.curves.values()]
    start = np.array([min(float(times[0]) for times in spans)])
    channels = []
    for node, (model, transform) in enumerate(zip(scene.models, scene.transforms), 1):
        keys = {path: (start, own[None, None]) for path, own in elsewhere[node].items()}
        if moved := animation.nodes.get(node):
            own = {path: _Numbers({}, getattr(transform, path)) for path in PATHS.values()}
            times, values = _sampled({**own, **moved}, animation.stack)
            _check_scale(values["scale"], transform.scale, model, limits[node])
            with_pivots = {"translation"} if transform.has_pivots else set()
            local = zip(PATHS.values(), transform.local(**values))
            keys |= {path: (times, found[:, None]) for path, found in local if path in moved.keys() | with_pivots}
        channels += [AnimationChannel(node, path, "LINEAR", *keys[path]) for path in PATHS.values() if path in keys]
    return channels


def _check_scale(scale: Float[np.ndarray, "f 3"], rest: Float[np.ndarray, "3"], model: FbxObject, limit: int) -> None:
    """Refuse scales that nodes below do not inherit by matrix multiplication."""
    size = SCALE_TOLERANCE * max(float(np.abs(rest).max()), 1e-12)
    if limit == CONSTANT and np.abs(scale - rest).max() > size:
        model.fail("a scale that does not move above a model of InheritType 2", "one that does")
    if limit == UNIFORM and np.ptp(scale, axis=1).max() > size:
        model.fail("the same scale along all axes above a model of InheritType 0 or 2", "others")


def _differs(found: Float[np.ndarray, " c"], rest: Float[np.ndarray, " c"], path: str) -> bool:
    if path == "rotation" and found @ rest < 0:
        found = -found
    return bool(np.abs(found - rest).max() > MOVED * max(1.0, np.abs(rest).max()))


def _weight_channels(animation: _Animation, meshes: list[FbxMesh]) -> list[AnimationChannel]:
    """Channels of the weights of shapes, one a mesh."""
    channels = []
    for found in meshes:
        moved = {c.channel.identity: c for c in found.geometry.channels if c.channel.identity in animation.channels}
        if not moved:
            continue
        times, values = _sampled({number: animation.channels[number] for number in moved}, animation.stack)
        animation.stack.record.reserve(8 * len(times) * len(found.mesh.morph_weights))
        weights = np.repeat(np.array(found.mesh.morph_weights)[None], len(times), axis=0)
        for number, channel in moved.items():
            weights[:, list(channel.targets)] = channel.weights(values[number][:, 0])
        channels.append(AnimationChannel(found.mesh.node, "weights", "LINEAR", times, weights[:, None]))
    return channels


def _sampled(numbers: dict[Key, _Numbers], stack: FbxObject) -> tuple[Times, dict[Key, np.ndarray]]:
    """Times between which all numbers, of which some move, are near lines, a time twice where one of them jumps, and
    the numbers there."""
    curves = [curve for each in numbers.values() for curve in each.curves.values()]
    stack.record.reserve(32 * sum(len(curve.times) for curve in curves), is_kept=False)
    times = _divided(np.unique(np.concatenate([curve.times for curve in curves])), curves, stack)
    stack.record.reserve(BYTES_A_TIME * len(times))
    stack.record.reserve(BYTES_WHILE_SAMPLED // 3 * len(times) * len(numbers), is_kept=False)
    before = {key: each.at(times, True) for key, each in numbers.items()}
    after = {key: each.at(times, False) for key, each in numbers.items()}
    jumps = np.zeros(len(times), dtype=bool)
    for key, values in before.items():
        jumps |= (np.abs(values - after[key]) > MOVED).any(axis=1)
    twice = np.repeat(np.arange(len(times)), 1 + jumps)
    is_before = np.append(twice[1:], -1) == twice
    return times[twice], {key: np.where(is_before[:, None], before[key][twice], after[key][twice]) for key in numbers}


def _divided(keys: Float[np.ndarray, " k"], curves: list[FbxCurve], stack: FbxObject) -> Times:
    """Times of keys, and others between those that are far apart and between which something moves."""
    if len(keys) < 2:
        return keys
    gaps = np.diff(keys)
    moves = np.zeros(len(gaps), dtype=bool)
    for curve in curves:
        moves |= ~curve.is_still(keys[:-1], keys[1:])
    parts = np.where((gaps > SPARSE) & moves, np.ceil(gaps / PART), 1).astype(np.int64)
    stack.record.reserve(BYTES_A_TIME * int(parts.sum()), is_kept=False)
    first = np.repeat(np.arange(len(gaps)), parts)
    share = (np.arange(len(first)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[first]
    return np.append(keys[first] + share * gaps[first], keys[-1])
