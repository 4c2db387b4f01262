"""Install the add-on's zip into a fresh Blender, run its operators and compare with the command line.

`check_blender_addon.py PYTHON ADDON.zip FOLDER [--pictures]`, with a Python that has bpy. PYTHON is one in which
quaffure is installed. Fails where a vertex is farther than 0.1 mm from that of `quaffure drape`.
"""

import os
import subprocess
import sys
from pathlib import Path

FRAMES = range(11, 17)
STRANDS = 6000
MOST_DISTANCE = 1e-4  # m
NOD = 0.09  # rad a frame


def main(python: str, addon: Path, folder: Path, pictures: bool) -> int:
    folder.mkdir(parents=True, exist_ok=True)
    os.environ["BLENDER_USER_RESOURCES"] = str(folder / "blender")
    import bpy
    import numpy as np

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.extensions.package_install_files(filepath=str(addon), repo="user_default", enable_on_install=True)
    (package,) = (one.module for one in bpy.context.preferences.addons if one.module.endswith("quaffure_hair"))
    preferences, scene = bpy.context.preferences.addons[package].preferences, bpy.context.scene
    settings, worst = scene.quaffure, 0.0

    preferences.python = str(folder / "no python")
    said = ""
    try:
        bpy.ops.quaffure.add_character()
    except RuntimeError as error:
        said = str(error).strip()
    print("without quaffure:", said)
    assert "expected a Python with quaffure in the preferences" in said
    preferences.python, settings.groom = python, "bob"
    bpy.ops.quaffure.add_character()
    armature, hair = settings.armature, settings.hair

    head = armature.pose.bones["Head"]
    head.rotation_mode = "QUATERNION"
    poses = np.zeros((len(FRAMES), 81), np.float32)
    joint = [bone.name for bone in armature.data.bones].index("Head")
    from mathutils import Matrix, Vector

    rest = head.bone.matrix_local.to_3x3()
    for row, frame in enumerate(FRAMES):
        poses[row, 3 * joint] = NOD * row
        turn = Matrix.Rotation(NOD * row, 3, Vector((1, 0, 0)))
        head.rotation_quaternion = (rest.inverted() @ turn @ rest).to_quaternion()
        head.keyframe_insert("rotation_quaternion", frame=frame)
    np.savez(folder / "motion.npz", body_pose=poses, fps=30.0)
    # The network: the solver's drapes of poses that differ in the last digit differ by millimetres in single strands.
    settings.draper, settings.stiffness, settings.wind = "neural", 2.0, (0, -1.0, 0)
    command = ["-m", "quaffure", "drape", "bob", "--motion", str(folder / "motion.npz"), "--draper", "neural"]
    command += ["--stiffness", "2", "--wind=0,-1,0"]

    scene.frame_set(FRAMES[2])
    bpy.ops.quaffure.drape_frame()
    alone = [*command, "--frames", "2", "--out", str(folder / "frame.npz")]
    subprocess.run([python, *alone], check=True, capture_output=True)
    worst = max(worst, report("this frame", positions(hair), np.load(folder / "frame.npz")["strands"][0]))

    scene.frame_start, scene.frame_end = FRAMES[0], FRAMES[-1]
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "check.blend"))
    bpy.ops.quaffure.bake()
    # The same drape needs the same digits: where hair leaves the skin, a vertex may go either way.
    motion = folder / "quaffure" / "motion.npz"
    apart = float(np.abs(np.load(motion)["body_pose"] - poses).max())
    print(f"poses of the armature: worst {apart:.1e} rad")
    assert apart < 1e-5
    command[command.index(str(folder / "motion.npz"))] = str(motion)
    subprocess.run([python, *command, "--out", str(folder / "range.npz")], check=True, capture_output=True)
    baked, expected = bpy.data.objects[f"{hair.name} baked"], np.load(folder / "range.npz")["strands"]
    for row, frame in enumerate(FRAMES):
        scene.frame_set(frame)
        worst = max(worst, report(f"baked frame {frame}", positions(baked), expected[row]))
    bpy.data.objects.remove(baked)
    settings.strands, settings.draper = STRANDS, "strand_newton"
    bpy.ops.quaffure.bake()
    baked = bpy.data.objects[f"{hair.name} baked"]
    print(f"{len(baked.data.curves)} strands baked with the solver")
    assert len(baked.data.curves) == STRANDS
    if pictures:
        render(folder)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "check.blend"))
    return int(worst > MOST_DISTANCE)


def positions(curves):
    import bpy
    import numpy as np

    evaluated = curves.evaluated_get(bpy.context.evaluated_depsgraph_get())
    points = np.empty(3 * len(evaluated.data.points), np.float32)
    evaluated.data.points.foreach_get("position", points)
    world = np.array(evaluated.matrix_world)
    return points.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3]


def report(what, found, expected) -> float:
    import numpy as np

    distance = float(np.linalg.norm(found - expected.reshape(-1, 3), axis=1).max())
    print(f"{what}: {len(found)} vertices, worst {1e3 * distance:.4f} mm")
    return distance


def render(folder: Path) -> None:
    """The last frame, from the front and the side."""
    import bpy
    from mathutils import Vector

    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    for thing in (camera, sun):
        scene.collection.objects.link(thing)
    sun.data.energy, sun.rotation_euler, camera.data.lens = 4.0, (0.8, 0.2, 0.5), 85
    scene.world = bpy.data.worlds.new("World")
    scene.world.color = (0.5, 0.55, 0.6)
    scene.camera, scene.render.engine = camera, "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 32, False
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.resolution_x = scene.render.resolution_y = 480
    for name, place in (("front", (0.4, -1.5, 1.85)), ("side", (1.5, -0.3, 1.8))):
        camera.location = place
        camera.rotation_euler = (Vector((0, -0.02, 1.72)) - camera.location).to_track_quat("-Z", "Y").to_euler()
        scene.render.filepath = str(folder / f"{name}.png")
        bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    arguments = [word for word in sys.argv[1:] if word != "--pictures"]
    sys.exit(main(arguments[0], Path(arguments[1]).absolute(), Path(arguments[2]).absolute(), "--pictures" in sys.argv))
