"""Motion of skeletons of every common naming, rest pose and set of axes; `test_retarget.py` has the formula."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from quaffure import InputError
from quaffure.body import BodyModel, BvhClip, Motion, automatic_joint_map, joint_map_text, joint_matrices, retarget_bvh
from quaffure.io import read_amass, read_bvh, read_joint_map
from quaffure.io.read_motion import read_motion

DAZ_SIDE = ("Collar", "Shldr", "ForeArm", "Hand", "Mid1", "Thigh", "Shin", "Foot")
"""Joints of a side in the Daz-friendly rig, in the order of the namings below."""
CMU_SIDE = "Shoulder Arm ForeArm Hand HandIndex1 UpLeg Leg Foot"
# Hips, spine, neck, head; names of a side in the order of DAZ_SIDE, with {side} or the words of both sides.
NAMINGS: dict[str, tuple[str, str, str, str, str, tuple[str, str], str]] = {
    "cmu": ("Hips", "LowerBack Spine Spine1", "Neck Neck1", "Head", CMU_SIDE, ("Left", "Right"), "{side}{name}"),
    "mixamo": (
        "mixamorig:Hips", "mixamorig:Spine mixamorig:Spine1 mixamorig:Spine2", "mixamorig:Neck", "mixamorig:Head",
        "Shoulder Arm ForeArm Hand HandMiddle1 UpLeg Leg Foot", ("Left", "Right"), "mixamorig:{side}{name}",
    ),
    "mixamo7": (
        "mixamorig7:Hips", "mixamorig7:Spine mixamorig7:Spine1 mixamorig7:Spine2", "mixamorig7:Neck", "mixamorig7:Head",
        "Shoulder Arm ForeArm Hand HandMiddle1 UpLeg Leg Foot", ("Left", "Right"), "mixamorig7:{side}{name}",
    ),
    "mixamo, no prefix": (
        "Hips", "Spine Spine1 Spine2", "Neck", "Head", "Shoulder Arm ForeArm Hand HandMiddle1 UpLeg Leg Foot",
        ("Left", "Right"), "{side}{name}",
    ),
    "chest, collar, elbow": (
        "Hips", "Chest Chest2", "Neck", "Head", "Collar Shoulder Elbow Wrist - Hip Knee Ankle", ("Left", "Right"),
        "{side}{name}",
    ),
    "xsens": (
        "Hips", "Chest Chest2 Chest3 Chest4", "Neck", "Head", "Collar Shoulder Elbow Wrist - Hip Knee Ankle",
        ("Left", "Right"), "{side}{name}",
    ),
    "xsens, vertebrae": (
        "Pelvis", "L5 L3 T12 T8", "Neck", "Head", "Shoulder UpperArm ForeArm Hand - UpperLeg LowerLeg Foot",
        ("Left", "Right"), "{side}{name}",
    ),
    "smpl": (
        "Pelvis", "Spine1 Spine2 Spine3", "Neck", "Head", "Collar Shoulder Elbow Wrist Hand Hip Knee Ankle",
        ("L", "R"), "{side}_{name}",
    ),
    "smpl, prefix": (
        "m_avg_Pelvis", "m_avg_Spine1 m_avg_Spine2 m_avg_Spine3", "m_avg_Neck", "m_avg_Head",
        "Collar Shoulder Elbow Wrist Hand Hip Knee Ankle", ("L", "R"), "m_avg_{side}_{name}",
    ),
    "smplx": (
        "pelvis", "spine1 spine2 spine3", "neck", "head", "collar shoulder elbow wrist middle1 hip knee ankle",
        ("left", "right"), "{side}_{name}",
    ),
    "bandai namco": (
        "Hips", "Spine Chest", "Neck", "Head", "Shoulder UpperArm LowerArm Hand - UpperLeg LowerLeg Foot", ("L", "R"),
        "{name}_{side}",
    ),
    "daz": ("hip", "abdomen chest", "neck", "head", " ".join(DAZ_SIDE), ("l", "r"), "{side}{name}"),
    "daz genesis": (
        "hip", "abdomenLower abdomenUpper chestLower chestUpper", "neckLower neckUpper", "head",
        "Collar ShldrBend ForearmBend Hand Mid1 ThighBend Shin Foot", ("l", "r"), "{side}{name}",
    ),
    "truebones": (
        "Bip01 Pelvis", "Bip01 Spine|Bip01 Spine1", "Bip01 Neck", "Bip01 Head",
        "Clavicle UpperArm Forearm Hand Finger2 Thigh Calf Foot", ("L", "R"), "Bip01 {side} {name}",
    ),
    "rokoko": (
        "Hips", "Spine Spine1 Spine2 Spine3", "Neck", "Head", "Shoulder Arm ForeArm Hand HandMiddle1 UpLeg Leg Foot",
        ("Left", "Right"), "{side}{name}",
    ),
    "lafan1": (
        "Hips", "Spine Spine1 Spine2", "Neck", "Head", "Shoulder Arm ForeArm Hand - UpLeg Leg Foot", ("Left", "Right"),
        "{side}{name}",
    ),
    "unreal": (
        "pelvis", "spine_01 spine_02 spine_03", "neck_01", "head",
        "clavicle upperarm lowerarm hand middle_01 thigh calf foot", ("l", "r"), "{name}_{side}",
    ),
}  # fmt: skip
CHANNELS = ("Zrotation", "Xrotation", "Yrotation")
ARM = ("Shldr", "ForeArm", "Hand", "Mid1")
NECK = ("Neck", "Neck1", "Head")


@pytest.fixture(scope="module")
def cmu_clip(shared_data: Path) -> BvhClip:
    """Three seconds of a person who walks, at 30 fps, without the lead-in from the rest pose."""
    clip = read_bvh(shared_data / "motion/07_01.bvh")
    return replace(clip, values=clip.values[15:300:4], frame_time=1 / 30)


@pytest.fixture(scope="module")
def original(cmu_clip: BvhClip, body: BodyModel) -> Motion:
    return retarget_bvh(cmu_clip, body)


class Rewriter:
    """A clip of the Daz-friendly rig as one of another skeleton that moves alike.

    Attributes:
        joints: name, parent's name, offset [cm], world rotation [F,3,3] and End Site of each joint.
    """

    def __init__(self, clip: BvhClip, lowered: float) -> None:
        """`lowered`: degrees by which the arms at rest are below a T pose's."""
        self.clip, self.world = clip, clip.world_rotations()
        self.lowered = lowered
        self.joints: list[tuple[str, str, np.ndarray, np.ndarray, np.ndarray]] = []

    def rotation(self, joint: str) -> np.ndarray:
        return self.world[:, self.clip.joint_names.index(joint)]

    def arm(self, joint: str) -> np.ndarray:
        """Rotation of a joint's rest frame: of arms, from the T pose to the new rest pose."""
        down = {"l": -self.lowered, "r": self.lowered}.get(joint[0], 0.0) if joint[1:] in ARM else 0.0
        return Rotation.from_euler("z", down, degrees=True).as_matrix()

    def add(self, name: str, parent: str, joint: str, above: str, rotation: np.ndarray | None = None) -> None:
        """A joint that moves as `joint` does, at its place; `above` is the joint whose frame its offset is in."""
        offset = self.arm(above) @ (self.rest(joint) - self.rest(above))
        world = self.rotation(joint) if rotation is None else rotation
        end = np.full(3, np.nan)
        if joint[1:] == "Hand":  # where a naming has no fingers, the hand still points somewhere
            end = self.arm(joint) @ (self.rest(f"{joint[0]}Mid1") - self.rest(joint))
        self.joints.append((name, parent, offset, world @ self.arm(joint).T, end))

    def rest(self, joint: str) -> np.ndarray:
        return self.clip.rest_position(self.clip.joint_names.index(joint))

    def clip_of(self, order: np.random.Generator | None = None) -> BvhClip:
        """The new clip, its joints in this order or in a random one with parents first."""
        joints = self.joints
        if order is not None:
            joints, waiting = [], [self.joints[i] for i in order.permutation(len(self.joints))]
            while waiting:
                placed = {joint[0] for joint in joints} | {""}
                joints.append(waiting.pop(next(i for i, joint in enumerate(waiting) if joint[1] in placed)))
        names = [joint[0] for joint in joints]
        world = {joint[0]: joint[3] for joint in joints}
        local = [
            world[name] if not parent else world[parent].swapaxes(1, 2) @ world[name] for name, parent, *_ in joints
        ]
        angles = [Rotation.from_matrix(rotation).as_euler("ZXY", degrees=True) for rotation in local]
        return BvhClip(
            tuple(names),
            np.array([names.index(joint[1]) if joint[1] else -1 for joint in joints]),
            np.array([joint[2] for joint in joints]),
            (CHANNELS,) * len(joints),
            np.stack(angles, axis=1).reshape(len(angles[0]), -1),
            self.clip.frame_time,
            "rewritten.bvh",
            np.array([joint[4] for joint in joints]),
        )


def rewritten(
    clip: BvhClip, naming: str, lowered: float = 0.0, neck: bool | None = None, extra: bool = False
) -> Rewriter:
    """The clip in another naming.

    Args:
        neck: False for a skeleton without a neck, and True for one whose neck takes a part of the head's rotation as
            people's do; by default the actor's own.
    """
    hips, spine, necks, head, names, sides, form = NAMINGS[naming]
    writer = Rewriter(clip, lowered)
    if neck is not None:
        relative = writer.rotation("chest").swapaxes(1, 2) @ writer.rotation("head")
        turned = Rotation.from_rotvec(0.62 * Rotation.from_matrix(relative).as_rotvec()).as_matrix()
        writer.world[:, clip.joint_names.index("neck")] = writer.rotation("chest") @ turned
    writer.add(hips, "", "hip", "hip")
    spine_names = spine.split("|") if "|" in spine else spine.split()
    half = halfway(writer.rotation("hip"), writer.rotation("abdomen"))
    lowest, abdomen, chest = ("abdomen", "hip", half), ("abdomen", "hip", None), ("chest", "abdomen", None)
    again = ("chest", "chest", None)
    parts = {2: (abdomen, chest), 3: (lowest, abdomen, chest), 4: (lowest, abdomen, chest, again)}[len(spine_names)]
    parent = hips
    for name, (joint, above, rotation) in zip(spine_names, parts):
        # The first of three or more is where the second is: CMU's own rig has bones without length.
        is_there = joint == "abdomen" and rotation is None and len(parts) > 2
        writer.add(name, parent, joint, joint if is_there else above, rotation)
        parent = name
    chest_name, above = parent, "chest"
    neck_names = [
        name for name in (necks.split() if " " in necks and "Bip" not in necks else [necks]) if neck is not False
    ]
    for name in neck_names:
        first = len(neck_names) == 2 and name == neck_names[0]
        turned = halfway(writer.rotation("chest"), writer.rotation("neck")) if first else None
        writer.add(name, parent, "neck", above, turned)
        parent, above = name, "neck"
    if extra:
        writer.add("HeadHelper", parent, "neck", above)
        parent, above = "HeadHelper", "neck"
    writer.add(head, parent, "head", above)
    for word, letter in zip(sides, "lr"):
        collar, arm, forearm, hand, finger, *leg = (form.format(side=word, name=name) for name in names.split())
        chain = [(collar, chest_name, "Collar", "chest"), (arm, collar, "Shldr", f"{letter}Collar")]
        chain += [(forearm, arm, "ForeArm", f"{letter}Shldr"), (hand, forearm, "Hand", f"{letter}ForeArm")]
        if "-" not in finger:
            chain.append((finger, hand, "Mid1", f"{letter}Hand"))
        chain += [(leg[0], hips, "Thigh", "hip"), (leg[1], leg[0], "Shin", f"{letter}Thigh")]
        chain.append((leg[2], leg[1], "Foot", f"{letter}Shin"))
        for name, above_name, joint, place in chain:
            writer.add(name, above_name, f"{letter}{joint}", place)
        if extra:
            spin = Rotation.from_euler("x", 60, degrees=True).as_matrix()
            for name, above_name, joint in ((arm, arm, "Shldr"), (leg[0], leg[0], "Thigh"), (hand, hand, "Hand")):
                turned = writer.rotation(f"{letter}{joint}") @ spin
                writer.add(f"{name}_twist", above_name, f"{letter}{joint}", f"{letter}{joint}", turned)
    return writer


def halfway(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    step = Rotation.from_matrix(first.swapaxes(1, 2) @ second).as_rotvec()
    return first @ Rotation.from_rotvec(0.5 * step).as_matrix()


def angles(found: Motion, expected: Motion, body: BodyModel) -> dict[str, float]:
    """Largest angle between the rotations of each joint relative to its parent [degrees]."""
    a, b = (joint_matrices(motion.body_pose).numpy() for motion in (found, expected))
    between = Rotation.from_matrix((a.swapaxes(-1, -2) @ b).reshape(-1, 3, 3)).magnitude().reshape(len(a), -1)
    return dict(zip(body.joint_names, np.degrees(between.max(0))))


@pytest.mark.shared_data
@pytest.mark.parametrize("lowered", [0.0, 45.0, 80.0], ids=["T", "A", "hanging"])
@pytest.mark.parametrize("naming", NAMINGS)
def test_a_clip_of_any_naming_and_rest_pose_moves_alike(
    naming: str, lowered: float, cmu_clip: BvhClip, original: Motion, body: BodyModel
) -> None:
    writer = rewritten(cmu_clip, naming, lowered, extra=lowered > 0)
    clip = writer.clip_of(np.random.default_rng(3) if lowered else None)
    found = angles(retarget_bvh(clip, body), original, body)
    assert max(found.values()) < 1.0, found


@pytest.mark.shared_data
@pytest.mark.parametrize("naming", ["mixamo", "chest, collar, elbow", "smpl"])
def test_a_clip_without_a_neck_moves_alike(naming: str, cmu_clip: BvhClip, original: Motion, body: BodyModel) -> None:
    with_neck = retarget_bvh(rewritten(cmu_clip, naming, neck=True).clip_of(), body)
    without = retarget_bvh(rewritten(cmu_clip, naming, neck=False).clip_of(), body)
    found = angles(without, with_neck, body)
    assert max(found[joint] for joint in NECK) < 3.0
    assert max(angle for joint, angle in found.items() if joint not in NECK) < 1.0
    # The actor's own neck leans to one side and his head back, which a head alone does not show; but the head stays.
    shape = torch.zeros(len(original), 10)
    (found_world, _), (world, _) = (body.posed_joints(motion.body_pose, shape) for motion in (without, original))
    head = body.joint_names.index("Head")
    assert torch.allclose(found_world[:, head], world[:, head], atol=1e-4)


@pytest.mark.shared_data
def test_another_up_axis_and_facing_move_alike(cmu_clip: BvhClip, original: Motion, body: BodyModel) -> None:
    clip = rewritten(cmu_clip, "lafan1").clip_of()
    axes = Rotation.from_euler("xz", [90, 90], degrees=True).as_matrix()  # z up, facing +x
    local = axes @ clip.local_rotations() @ axes.T
    euler = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_euler("ZXY", degrees=True).reshape(len(local), -1)
    turned = replace(clip, offsets=clip.offsets @ axes.T, ends=clip.ends @ axes.T, values=euler)
    motion = retarget_bvh(turned, body)
    assert max(angles(motion, original, body).values()) < 1.0
    assert motion.notes == ("+z is up",)


@pytest.mark.shared_data
def test_bones_along_x_at_rest_take_a_frame_that_stands(cmu_clip: BvhClip, original: Motion, body: BodyModel) -> None:
    """As LaFAN1 stores its skeleton: all rotations zero make every bone of spine, head and legs point along x."""
    clip = rewritten(cmu_clip, "lafan1").clip_of()
    world, names = clip.world_rotations(), clip.joint_names
    offsets, frames = clip.offsets.copy(), np.tile(np.eye(3), (len(names), 1, 1))
    for joint, parent in enumerate(clip.parents):
        end = next((k for k in range(len(names)) if clip.parents[k] == joint and "Shoulder" not in names[k]), None)
        if joint and end is not None and clip.offsets[end].any():
            x = clip.offsets[end] / np.linalg.norm(clip.offsets[end])
            side = np.cross(np.array([0.1, 0.2, 1.0]), x)
            frames[joint] = np.stack([x, side / np.linalg.norm(side), np.cross(x, side / np.linalg.norm(side))], axis=1)
        elif joint:
            frames[joint] = frames[parent]
        if joint:
            offsets[joint] = frames[parent].T @ clip.offsets[joint]
    world = world @ frames
    local = world.copy()
    for joint, parent in enumerate(clip.parents):
        if parent >= 0:
            local[:, joint] = world[:, parent].swapaxes(1, 2) @ world[:, joint]
    euler = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_euler("ZXY", degrees=True).reshape(len(local), -1)
    motion = retarget_bvh(replace(clip, offsets=offsets, values=euler, ends=None), body)
    assert "the rest pose is frame" in motion.notes[0]
    shape = torch.zeros(len(motion), 10)
    (_, found), (_, expected) = (body.posed_joints(m.body_pose, shape) for m in (motion, original))
    # Of a rest pose that is a frame of walking, the trunk's own lean is lost.
    assert float((found - expected).norm(dim=-1).mean()) < 0.06


@pytest.mark.shared_data
def test_an_unsure_map_is_refused_with_its_table(
    cmu_clip: BvhClip, original: Motion, body: BodyModel, tmp_path: Path
) -> None:
    clip = rewritten(cmu_clip, "lafan1").clip_of()
    french = {"LeftLeg": "jambe", "RightUpLeg": "cuisse"}
    unknown = replace(clip, joint_names=tuple(french.get(name, name) for name in clip.joint_names))
    with pytest.raises(InputError, match=r'none for LeftLeg, RightUpLeg. Known: Hips = "Hips"; .*jambe.*cuisse'):
        retarget_bvh(unknown, body)
    text = joint_map_text(automatic_joint_map(clip))
    path = tmp_path / "map.toml"
    path.write_text(text.replace('"LeftLeg"', '"jambe"').replace('"RightUpLeg"', '"cuisse"'), encoding="utf-8")
    found = retarget_bvh(unknown, body, read_joint_map(path))
    assert max(angles(found, original, body).values()) < 1.0
    path.write_text('Tail = "x"\n', encoding="utf-8")
    with pytest.raises(InputError, match=r"joints of the body.*found Tail"):
        read_joint_map(path)
    path.write_text(text.replace('"LeftLeg"', "7"), encoding="utf-8")
    with pytest.raises(InputError, match='LeftLeg = "joint"'):
        read_joint_map(path)
    path.write_text("Hips = ", encoding="utf-8")
    with pytest.raises(InputError, match=r"a joint map \(\.toml\)"):
        read_joint_map(path)
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"joints of the file.*found LeftLeg, RightUpLeg"):
        retarget_bvh(unknown, body, read_joint_map(path))


@pytest.mark.shared_data
def test_joints_in_another_hierarchy_are_refused(cmu_clip: BvhClip, body: BodyModel) -> None:
    clip = rewritten(cmu_clip, "lafan1").clip_of()
    swapped = {"LeftUpLeg": "LeftLeg", "LeftLeg": "LeftUpLeg"}
    with pytest.raises(InputError, match=r"LeftLeg for LeftLeg, not below LeftUpLeg"):
        retarget_bvh(replace(clip, joint_names=tuple(swapped.get(name, name) for name in clip.joint_names)), body)


@pytest.mark.shared_data
@pytest.mark.parametrize(
    ("name", "frames"),
    [
        ("cmu_original_names_12_01", 131),
        ("mixamorig_walk", 69),
        ("chest_collar_elbow", 454),
        ("xsens_like", 975),
        ("smpl_names", 312),
    ],
)
def test_public_files_stand_upright_on_the_floor(name: str, frames: int, shared_data: Path, body: BodyModel) -> None:
    motion = read_motion(shared_data / f"rigs/{name}.bvh", body)
    assert (len(motion), motion.fps, motion.notes) == (frames, 30.0, ())
    part = motion.select(slice(None, None, 10))
    rotations, joints = body.posed_joints(part.body_pose, torch.zeros(len(part), 10))
    index = body.joint_names.index
    assert part.translation is not None
    feet = joints[:, [index("LeftToeBase"), index("RightToeBase")], 2].min(1).values + part.translation[:, 2]
    assert -0.1 < float(feet.median()) < 0.1
    assert float((joints[:, index("Head")] - joints[:, index("Hips")])[:, 2].mean()) > 0.4
    for side, outward in (("Left", 1.0), ("Right", -1.0)):
        hand = joints[:, index(f"{side}Hand")] - joints[:, index("Hips")]
        assert outward * float((hand * rotations[:, index("Hips"), :, 0]).sum(-1).mean()) > 0.15


@pytest.mark.shared_data
@pytest.mark.parametrize("missing", ["nofingers", "nofeet"])
def test_fingers_and_feet_may_be_missing(missing: str, shared_data: Path, body: BodyModel) -> None:
    base = read_motion(shared_data / "cases/m_base30.bvh", body)
    found = angles(read_motion(shared_data / f"cases/m_{missing}.bvh", body), base, body)
    assert max(found.values()) < 1.0, found


@pytest.mark.shared_data
@pytest.mark.parametrize(("name", "note"), [("a_yup", "+y is up"), ("a_camera_ydown", "+y is down")])
def test_files_with_y_up_or_down_stand_and_say_so(name: str, note: str, shared_data: Path, body: BodyModel) -> None:
    motion = read_motion(shared_data / f"cases/{name}.npz", body)
    rotations, _ = body.posed_joints(motion.body_pose[:1], torch.zeros(1, 10))
    for joint in ("Hips", "Head"):
        assert torch.allclose(rotations[0, body.joint_names.index(joint)], torch.eye(3), atol=1e-5)
    assert note in motion.notes[0]


def test_amass_and_smplx_keys_mean_the_same(tmp_path: Path, body: BodyModel) -> None:
    poses = np.random.default_rng(1).uniform(-0.3, 0.3, (6, 66)) + np.eye(66)[0] * np.pi / 2
    layouts = {
        "amass": {"poses": np.pad(poses, ((0, 0), (0, 90))), "mocap_framerate": 60.0},
        "amass_x": {"root_orient": poses[:, :3], "pose_body": poses[:, 3:], "mocap_frame_rate": 60},
        "smplx": {"global_orient": poses[:, :3], "body_pose": poses[:, 3:].reshape(6, 21, 3), "fps": 60.0},
    }
    found = {}
    for name, arrays in layouts.items():
        path = tmp_path / f"{name}.npz"
        # What these files hold besides, some of it pickled.
        np.savez(path, gender=np.array("male"), betas=np.zeros(10), markers=np.array([{}], dtype=object), **arrays)
        found[name] = read_motion(path, body)
        assert found[name].notes == ()
    for motion in found.values():
        torch.testing.assert_close(motion.body_pose, found["amass"].body_pose)
    np.savez(tmp_path / "half.npz", root_orient=poses[:, :3], pose_body=poses[:, 3:30], fps=60.0)
    with pytest.raises(InputError, match=r"root_orient \+ pose_body .*\[6, 3\] \+ \[6, 27\]"):
        read_amass(tmp_path / "half.npz", body)
