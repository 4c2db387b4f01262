"""Joint map of a skeleton from the names of its joints (`assets/joint_names.toml`) and from which is below which.

A name is split into its side (Left, L, l, before or after the rest) and a stem; namespaces (`mixamorig:`) and a prefix
that most names share are not part of it. A map is accepted where every required joint is found and all are below one
another as in a body.
"""

import re
import tomllib
from collections import Counter
from dataclasses import replace
from functools import cache
from importlib.resources import files
from itertools import pairwise

import numpy as np

from quaffure.body.bvh_clip import BvhClip
from quaffure.body.joint_map import CHAINS, REQUIRED, SIDES, JointMap, JointSource
from quaffure.body.neck import NECK_SHARES
from quaffure.errors import InputError

TOKEN = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+")
SIDE_WORDS = {"left": "Left", "l": "Left", "right": "Right", "r": "Right"}
PREFIX_SHARE = 0.6  # of the names that a prefix must have
VERTEBRAE = ("l5", "l3", "t12", "t8")
"""Stems that would read as a side and a number."""
SPINE_SHARES = {1: (1 / 3, 2 / 3, 1.0), 2: (0.5, 1.0, 2.0), 3: (1.0, 2.0, 3.0), 4: (1.0, 2.0, 4.0)}
"""Place of the body's three spine joints on a spine of so many: 0 is its hips, 1 its first joint, and so on."""
SPINE = ("LowerBack", "Spine", "Spine1")
ROLES = {
    "LHipJoint RHipJoint": "hip_joint", "Arm": "upper_arm", "Shoulder": "collar", "ForeArm": "forearm", "Hand": "hand",
    "FingerBase": "finger", "UpLeg": "thigh", "Leg": "shin", "Foot": "foot", "ToeBase": "toe",
}  # fmt: skip
"""Joints of the body on both sides and their stems, in the order in which joints of a skeleton are taken."""

_Named = dict[tuple[str, str], list[int]]  # side ("" for the centre) and stem -> joints


def automatic_joint_map(clip: BvhClip) -> JointMap:
    """The joint map of a skeleton by its names.

    Raises:
        InputError: a required joint is not found, a name stands for two joints, or a joint is not below the one that it
            is below in a body; with the map as far as it is known.
    """
    joint_map, doubts = guess_joint_map(clip)
    check_joint_map(joint_map, clip, doubts)
    return joint_map


def guess_joint_map(clip: BvhClip) -> tuple[JointMap, list[str]]:
    """The map as far as names show it, and what is unsure about it."""
    named, stems, doubts = _named_joints(clip), _stems(), []
    taken: dict[str, int] = {}

    def take(joint: str, side: str, role: str) -> None:
        for stem in stems["side" if side else "centre"][role]:
            found = [index for index in named.get((side, stem), []) if index not in taken.values()]
            if joint.endswith("FingerBase"):
                found = [index for index in found if _is_apart(clip, index, taken.get(f"{side}Hand"))]
            if found:
                taken[joint] = found[0]
                if len(found) > 1:
                    doubts.append(f"{' and '.join(clip.joint_names[i] for i in found)} for {joint}")
                return

    take("Hips", "", "hips")
    take("Head", "", "head")
    for names, role in ROLES.items():
        for side, joint in zip(SIDES, names.split() if " " in names else [f"{side}{names}" for side in SIDES]):
            take(joint, side, role)
    joint_map = {joint: JointSource(clip.joint_names[index]) for joint, index in taken.items()}
    joint_map |= _spine(clip, named, stems["centre"]["spine"], taken)
    if "Spine1" in joint_map and "Head" in joint_map:
        joint_map |= _neck(clip, named, stems["centre"]["neck"], taken, joint_map["Spine1"].first)
    return joint_map, doubts


def heads(clip: BvhClip) -> list[int]:
    """Joints that are called as a head is, whatever number (`#2`) tells equal names apart; in order."""
    stem = _stems()["centre"]["head"]
    numberless = replace(clip, joint_names=tuple(re.sub(r"#\d+$", "", name) for name in clip.joint_names))
    named = _named_joints(numberless)
    return sorted(next((named["", each] for each in stem if ("", each) in named), []))


def check_joint_map(joint_map: JointMap, clip: BvhClip, doubts: list[str] | None = None) -> None:
    """Refuse a map that does not fit a skeleton.

    Args:
        doubts: reasons to refuse it that are known.

    Raises:
        InputError: joints that the file lacks, a required one that is missing, or one that is not below its parent.
    """
    absent = sorted({name for source in joint_map.values() for name in source.joints} - set(clip.joint_names))
    if absent:
        raise InputError(clip.source, f"joints of the file ({', '.join(clip.joint_names)})", ", ".join(absent))
    doubts = list(doubts or [])
    missing = [joint for joint in REQUIRED if joint not in joint_map]
    if missing:
        doubts.append(f"none for {', '.join(missing)}")
    for chain in CHAINS:
        known = [joint for joint in chain if joint in joint_map]
        for above, joint in pairwise(known):
            parent, child = joint_map[above].joints[-1], joint_map[joint].joints[-1]
            if clip.joint_names.index(parent) not in clip.ancestors(clip.joint_names.index(child)):
                doubts.append(f"{child} for {joint}, not below {parent} for {above}")
    if doubts:
        known_map = "; ".join(f"{joint} = {source}" for joint, source in joint_map.items())
        raise InputError(
            clip.source,
            "joints whose names are known (quaffure inspect FILE --save-joints map.toml writes a table to complete for "
            "--joints map.toml)",
            f"{'; '.join(doubts)}. Known: {known_map or 'none'}. Joints of the file: {', '.join(clip.joint_names)}",
        )


@cache
def _stems() -> dict[str, dict[str, list[str]]]:
    return tomllib.loads((files("quaffure") / "assets" / "joint_names.toml").read_text(encoding="utf-8"))


def _named_joints(clip: BvhClip) -> _Named:
    names = [re.split(r"[:|]", name)[-1] for name in clip.joint_names]
    prefix = _common_prefix(names)
    known = {stem for role in _stems()["side"].values() for stem in role}
    lowered = {name.removeprefix(prefix).lower() for name in names}
    result: _Named = {}
    for index, name in enumerate(names):
        side, stem = _side_and_stem(name.removeprefix(prefix))
        # ASF has lfemur and rfemur, all in lower case.
        if not side and stem[:1] in ("l", "r") and stem[1:] in known and {f"l{stem[1:]}", f"r{stem[1:]}"} <= lowered:
            side, stem = SIDE_WORDS[stem[0]], stem[1:]
        result.setdefault((side, stem), []).append(index)
    return result


def _common_prefix(names: list[str]) -> str:
    """The longest beginning up to a separator that most names share."""
    beginnings = Counter(name[: match.end()] for name in names for match in re.finditer(r"[ _.\-]+", name))
    shared = [text for text, count in beginnings.items() if count >= PREFIX_SHARE * len(names)]
    return max(shared, key=len, default="")


def _side_and_stem(name: str) -> tuple[str, str]:
    tokens = [token.lower() for token in TOKEN.findall(name)]
    if "".join(tokens) in VERTEBRAE:
        return "", "".join(tokens)
    side = ""
    for place in (0, -1):
        if len(tokens) > 1 and not side and tokens[place] in SIDE_WORDS:
            side = SIDE_WORDS[tokens.pop(place)]
    if not side and tokens and (match := re.match(r"(left|right)(.+)", tokens[0])):
        side, tokens[0] = SIDE_WORDS[match[1]], match[2]
    return side, "".join(str(int(token)) if re.fullmatch(r"\d{1,9}", token) else token for token in tokens)


def _spine(clip: BvhClip, named: _Named, stems: list[str], taken: dict[str, int]) -> JointMap:
    """The body's spine from the joints between hips and chest: those above head and both arms."""
    ends = [taken.get(joint) for joint in ("Hips", "Head", "LeftArm", "RightArm")]
    if None in ends:
        return {}
    hips, *tips = [end for end in ends if end is not None]
    shared = set.intersection(*(set(clip.ancestors(tip)) for tip in tips))
    above = [joint for joint in reversed(clip.ancestors(tips[0])) if joint in shared]
    if hips not in above:
        return {}
    by_name = {joint for stem in stems for joint in named.get(("", stem), [])}
    chain = [joint for joint in above[above.index(hips) :] if joint == hips or joint in by_name]
    count = len(chain) - 1
    if count == 0:
        return {}
    places = SPINE_SHARES.get(count) or tuple(np.round(np.linspace(0, count, 4)[1:]))
    return {joint: _between(clip, chain, place) for joint, place in zip(SPINE, places)}


def _neck(clip: BvhClip, named: _Named, stems: list[str], taken: dict[str, int], chest: str) -> JointMap:
    """The body's two neck joints from the joints between chest and head; from the head's rotation without any."""
    by_name = {joint for stem in stems for joint in named.get(("", stem), [])}
    above = [clip.joint_names[joint] for joint in reversed(clip.ancestors(taken["Head"])) if joint in by_name]
    head = clip.joint_names[taken["Head"]]
    if not above:
        first, second = NECK_SHARES["Neck"], NECK_SHARES["Neck"] + NECK_SHARES["Neck1"]
        return {"Neck": JointSource(chest, head, first), "Neck1": JointSource(chest, head, second)}
    lower = JointSource(chest, above[0]) if len(above) == 1 else JointSource(above[0])
    return {"Neck": lower, "Neck1": JointSource(above[-1])}


def _between(clip: BvhClip, chain: list[int], place: float) -> JointSource:
    below = min(int(place), len(chain) - 1)
    if place == below:
        return JointSource(clip.joint_names[chain[below]])
    return JointSource(clip.joint_names[chain[below]], clip.joint_names[chain[below + 1]], place - below)


def _is_apart(clip: BvhClip, joint: int, hand: int | None) -> bool:
    """Whether a finger joint is at another place than its hand, so that it shows where the hand points."""
    return hand is None or bool(np.any(clip.rest_position(joint) != clip.rest_position(hand)))
