"""Cable paths and scenes: geometry against moment arms, wraps and Pinocchio; colours, discs and marks."""

import numpy as np
import pinocchio as pin
import pytest
import umsgpack
import view_cases

from cdm_pin import show as show_module
from cdm_pin.cablepath import Wrap, cable_paths, cable_sides, tangent
from cdm_pin.cables import wrap_angles
from cdm_pin.manipulator import parse_manipulator
from cdm_pin.model import build_model
from cdm_pin.poses import body_poses
from cdm_pin.robots import robot_urdf
from cdm_pin.scene import ACCEPTED, HIDDEN, SLACK_COLOUR, SUSPECT, Display, Part, bounds, frames, outermost
from cdm_pin.scene_build import build_scene
from cdm_pin.scene_mesh import merged, shape
from cdm_pin.scene_meshcat import layout, pack_frames, scene_commands
from cdm_pin.show import frame_at, show_ghosts, show_model, show_recording
from cdm_pin.transmission import cable_travel


@pytest.fixture(scope="module")
def model():
    return view_cases.arm()


def lengths(model, q, arc=300):
    q = np.atleast_2d(q)
    paths = cable_paths(cable_sides(model.manipulator), body_poses(model.chain, q), q, arc=arc)
    return np.array([np.linalg.norm(np.diff(path, axis=1), axis=2).sum(1) for path in paths]).T


def spatial_arm():
    """Three parallel joints about y, links bent and offset along the axis."""
    link = {"mass": 1.0, "center_of_mass": [0.2, 0, 0], "inertia": [0.01, 0.01, 0.01], "axis": [0, 1, 0]}
    origins = [{"xyz": [0, 0, 0.3], "rpy": [0.0, 0, 0]}, {"xyz": [0.5, 0, 0.1], "rpy": [0, 0.2, 0]},
               {"xyz": [0.4, 0, -0.1], "rpy": [0, -0.1, 0]}]  # fmt: skip
    links = [{"name": f"link_{i + 1}", "origin": o, **link} for i, o in enumerate(origins)]
    content = {"name": "bent", "gravity": [0, 0, -9.8], "links": links, "pretension": 50.0, "pulleys": {
        "joint_pulley_radius": [0.05, 0.06, 0.04], "motor_pulley_radius": [0.03, 0.03, 0.05],
        "link_pulley_radius": 0.01, "link_pulley_offset": 0.012, "link_pulley_distance": 0.08}}  # fmt: skip
    return build_model(parse_manipulator(content))


@pytest.mark.parametrize("make", [view_cases.arm, spatial_arm])
def test_path_length_changes_by_the_moment_arms(make):
    """The upper side shortens and the lower one lengthens by r_j per radian of every joint on the way, and no other."""
    model = make()
    q, h = np.array([0.3, -0.5, 0.8]), 1e-4
    slope = np.array([(lengths(model, q + h * e)[0] - lengths(model, q - h * e)[0]) / (2 * h) for e in np.eye(3)]).T
    arms = np.repeat(cable_travel(model.manipulator.pulleys), 2, axis=0) * np.tile([[-1.0], [1.0]], (3, 1))
    np.testing.assert_allclose(slope, arms, atol=2e-6)


def test_wraps_are_those_of_the_cable_layer(model):
    """The drawn arcs of joint guide pulleys span 2 theta_g0 -+ theta, as the cable layer computes them."""
    q = np.array([0.4, -0.7, 0.2])
    wraps = wrap_angles(model, q[None])[0]
    for side in cable_sides(model.manipulator):
        guides = [piece for piece in side.pieces if isinstance(piece, Wrap)][:-1]
        for wrap in guides:
            swept = abs(wrap.sweep + q[wrap.joint])
            assert swept == pytest.approx(wraps[wrap.joint, 0 if side.side == "upper" else 1], abs=1e-12)


def test_wraps_lie_on_their_pulleys_and_strands_leave_them_along_tangents(model):
    """Every point of an arc is r_j from its joint's axis, and the path has no corner where a strand meets a pulley."""
    q = np.array([[0.4, -0.7, 0.2]])
    poses = body_poses(model.chain, q)
    sides = cable_sides(model.manipulator)
    for side, path in zip(sides, cable_paths(sides, poses, q, arc=40), strict=True):
        centres = poses[0, : side.cable + 1, :2, 3]
        distance = np.linalg.norm(path[0, :, None, :2] - centres, axis=2).min(1)
        assert distance.min() > 0.1 - 1e-9
        steps = np.diff(path[0], axis=0)
        steps /= np.linalg.norm(steps, axis=1)[:, None]
        turns = np.arccos(np.clip((steps[1:] * steps[:-1]).sum(1), -1, 1))[distance[1:-1] < 0.1 + 1e-9]
        assert len(turns) >= 40 and turns.max() < np.radians(195) / 40


def test_tangents_touch_both_pulleys():
    """A strand touches each pulley at its radius, at right angles to it, on the side its sign says."""
    c1, s1, c2, s2 = np.array([0.0, 0.1]), 0.3, np.array([1.0, -0.2]), -0.2
    normal = tangent(c1, s1, c2, s2)
    n = np.array([np.cos(normal), np.sin(normal)])
    along = (c2 + s2 * n) - (c1 + s1 * n)
    assert along @ n == pytest.approx(0.0, abs=1e-12) and np.cross(np.append(along, 0), np.append(n, 0))[2] > 0


def test_past_the_wrap_limit_the_arc_is_gone(model):
    """A joint bent past its limit shows no arc turning the wrong way round."""
    straight, bent = lengths(model, [0, 0, 0])[0], lengths(model, [0, 2.5, 0])[0]
    assert bent[4] < straight[4] and bent[4] > straight[4] - 0.1 * 2.5 - 1e-9


def test_poses_are_pinocchios():
    """Bodies stand where Pinocchio puts them, for revolute, prismatic and continuous joints, in the order of E."""
    for name in ("panda", "ur5_robot"):
        model = build_model(parse_manipulator({"name": name, "urdf": str(robot_urdf(name))}))
        q = np.random.default_rng(0).uniform(-1, 1, (3, model.n_joints))
        poses = body_poses(model.chain, q)
        data = model.pin_model.createData()
        for k, configuration in enumerate(model.configuration(q)):
            pin.forwardKinematics(model.pin_model, data, configuration)
            expected = [data.oMi[i].homogeneous for i in model.joint_ids]
            np.testing.assert_allclose(poses[k], expected, atol=1e-12)


def test_parts_of_the_arm_are_there(model):
    """Links, joint pulleys with one idler per passing cable, guides, winches, discs, marks and every cable side."""
    scene = build_scene(model)
    paths = {part.path for part in scene.parts}
    assert {"body_1/link", "joint_1_pulley_3/disc", "body_2/guide_far_lower", "winch_3/disc", "base"} <= paths
    assert {"residual_joint_2/disc", "residual_motor_3/disc", "mark_link_1/ball", "mark_base/ball"} <= paths
    assert scene.line_paths == [f"robot/cable_{i}_{side}" for i in (1, 2, 3) for side in ("upper", "lower")]
    assert len(set(scene.rigid_paths)) == len(scene.rigid_paths)


def test_pulleys_turn_with_their_cables(model):
    """Winches turn by q_m, joint pulleys by the angles of the joints that their cable still has before it."""
    scene, q = build_scene(model), np.array([[0.3, -0.2, 0.5]])
    angle = {t.path: float((q @ t.ratio)[0]) for t in scene.turning}
    np.testing.assert_allclose([angle[f"winch_{i}"] for i in (1, 2, 3)], model.motor_position(q)[0], atol=1e-12)
    assert angle["joint_2_pulley_2"] == pytest.approx(-0.2) and angle["joint_2_pulley_3"] == pytest.approx(0.3)


def test_colours_tell_tension_slack_sign_and_place(model):
    """Slack is grey, more tension is brighter, discs grow with the residual, marks light up where they sit."""
    scene, q = build_scene(model), np.zeros((1, 3))
    tension = np.array([[0.0, 80.0, 20.0, 80.0, 80.0, 80.0]])
    residual = np.zeros((1, len(scene.discs)))
    residual[0, 1] = -0.5
    display = Display(tension, 80.0, residual, suspects=[{"kind": "joint", "index": 1}], accepted=[{"kind": "base"}])
    placed, plain = frames(scene, q, display), frames(scene, q)
    colour = dict(zip(scene.colour_paths, placed.colours[0], strict=True))
    np.testing.assert_allclose(colour["robot/cable_1_upper"], SLACK_COLOUR)
    assert colour["robot/cable_1_lower"][:3].sum() > colour["robot/cable_2_upper"][:3].sum()
    bulge = [np.abs(a - b).max() for a, b in zip(placed.lines, plain.lines, strict=True)]
    assert bulge[0] == 0.0 and bulge[1] == 0.0  # the first cable has no run along a link, only the base's
    scale = dict(zip(scene.rigid_paths, np.linalg.norm(placed.rigid[0, :, :3, 0], axis=1), strict=True))
    assert scale["robot/residual_joint_2"] == pytest.approx(0.5) and scale["robot/residual_joint_1"] <= HIDDEN
    assert scale["robot/mark_joint_1"] == pytest.approx(1.0) and scale["robot/mark_joint_2"] <= HIDDEN
    np.testing.assert_allclose(colour["robot/mark_joint_1"], SUSPECT)
    np.testing.assert_allclose(colour["robot/mark_base"], ACCEPTED)


def test_slack_cables_bulge_along_links(model):
    """A slack side of a cable that runs along a link leaves its straight line there."""
    scene, q = build_scene(model), np.zeros((1, 3))
    tension = np.full((1, 6), 50.0)
    tension[0, 4] = -1.0
    slack, taut = frames(scene, q, Display(tension)), frames(scene, q)
    assert np.abs(slack.lines[4] - taut.lines[4]).max() > 0.02
    np.testing.assert_array_equal(slack.lines[5], taut.lines[5])


def volume(mesh) -> float:
    """Give what the triangles enclose; negative if they face inwards."""
    a, b, c = mesh.vertices[mesh.faces.T].astype(float)
    return float((a * np.cross(b, c)).sum() / 6)


def test_shapes_are_closed_and_face_outwards():
    """Box, cylinder and sphere enclose their volume, with normals of length one that point the way their faces do."""
    expected = {"box": 0.048, "cylinder": np.pi * 0.04 * 0.5, "sphere": 4 / 3 * np.pi * 0.008}
    sizes = {"box": (0.2, 0.4, 0.6), "cylinder": (0.2, 0.5), "sphere": (0.2,)}
    for kind, size in sizes.items():
        mesh = shape(Part("x", kind, size, np.eye(4), (1.0, 1.0, 1.0, 1.0)))
        assert 0.94 * expected[kind] < volume(mesh) < 1.001 * expected[kind], kind
        a, b, c = mesh.vertices[mesh.faces.T]
        assert ((np.cross(b - a, c - a)[:, None] * mesh.normals[mesh.faces]).sum(-1) > 0).all(), kind
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-6)


def test_parts_of_one_body_are_one_mesh_with_their_colours(model):
    """Merged parts keep place, volume and colour; a single colour needs none at the vertices."""
    parts = [part for part in build_scene(model).parts if part.path.startswith("body_1/")]
    assert len(parts) == 5
    both, each = merged(parts), [merged([part]) for part in parts]
    assert volume(both) == pytest.approx(sum(map(volume, each)), rel=1e-4)
    assert both.colours is not None and {tuple(c) for c in both.colours.round(2)} == {
        tuple(np.float32(part.colour[:3]).round(2)) for part in parts
    }
    guide = next(k for k, part in enumerate(parts) if part.path.endswith("far_lower"))
    np.testing.assert_allclose(each[guide].vertices.mean(0), parts[guide].placement[:3, 3], atol=1e-6)
    assert all(mesh.colours is None for mesh in each)


def test_what_moves_together_is_one_object(model):
    """A browser is given one object per body, pulley, disc, mark and cable side, one for the base and one of arrows."""
    scene = build_scene(model, contacts=(0, 1, 1))
    commands = [umsgpack.unpackb(command) for command in scene_commands(scene)]
    paths = [command["path"].strip("/") for command in commands if command["type"] == "set_object"]
    assert sorted(paths) == sorted([*scene.rigid_paths, *scene.line_paths, "robot/base", "robot/forces"])


def test_arrows_stand_where_the_forces_act(model):
    """Each arrow leaves the point of contact along its force, a fifth of the reach long at full force."""
    scene, q = build_scene(model, contacts=(-1, 1)), np.array([[0.4, -0.3, 0.1]])
    point, force = np.array([[[0.1, 0.0, 0.0], [0.2, 0.1, 0.0]]]), np.array([[[0.0, 5.0, 0.0], [10.0, 0.0, 0.0]]])
    arrows = frames(scene, q, Display(force=force, point=point, full_force=10.0)).arrows[0]
    pose = body_poses(scene.chain, q)[0, 1]
    np.testing.assert_allclose(arrows[0], [[0.1, 0, 0], [0.1, 0.1 * scene.size, 0]], atol=1e-12)
    np.testing.assert_allclose(arrows[1, 0], pose[:3, :3] @ point[0, 1] + pose[:3, 3], atol=1e-12)
    np.testing.assert_allclose(arrows[1, 1] - arrows[1, 0], 0.2 * scene.size * pose[:3, 0], atol=1e-12)


def test_many_times_at_once_are_each_time_by_itself(model):
    """Frames placed ahead are those that are placed one by one."""
    show = show_recording(model, view_cases.recording(model), forces=True)
    times = np.array([0.0, 0.013, 7.7, show.duration, show.duration + 1.0])
    together = pack_frames(frame_at(show, times, {}))
    np.testing.assert_allclose(together, np.vstack([pack_frames(frame_at(show, t, {})) for t in times]), atol=1e-6)


def test_the_camera_holds_everything(model):
    """All points of the motion lie in the ball the camera looks at; gravity points down in the viewer."""
    scene, (_, q, _, _) = build_scene(model), view_cases.motion()
    centre, radius = bounds(scene, q)
    placed = frames(scene, q[::50])
    points = np.vstack([line.reshape(-1, 3) for line in placed.lines]) @ scene.upright[:3, :3].T
    assert np.linalg.norm(points - centre, axis=1).max() <= radius + 1e-9
    held, tip = outermost(scene, q), body_poses(scene.chain, q)[:, -1] @ np.array([0.6, 0.0, 0.0, 1.0])
    reached = np.vstack([points, tip[:, :3] @ scene.upright[:3, :3].T])
    assert (reached.max(0) <= held.max(0) + 0.02).all() and (reached.min(0) >= held.min(0) - 0.02).all()
    np.testing.assert_allclose(scene.upright[:3, :3] @ [0, -1, 0], [0, 0, -1], atol=1e-12)


def test_packed_frames_fit_their_layout(model):
    """The numbers of a frame are as many as the layout announces, for one robot and for ghosts."""
    t, q, _, _ = view_cases.motion(seconds=1.0)
    for show in (show_model(model), show_ghosts(model, t, {"recorded": q, "rigid": q, "completed": q})):
        plan = layout(show.scenes)
        points = sum(thing["rings"] for thing in [*plan["lines"], *plan["arrows"]])
        width = 12 * len(plan["rigid"]) + 3 * points + 4 * len(plan["colours"])
        packed = pack_frames(frame_at(show, 0.0, {}))
        assert packed.shape == (1, width) and np.isfinite(packed).all()


def test_ghosts_have_neither_discs_nor_marks(model):
    """A ghost is the robot alone, all of it in its colour."""
    t, q, _, _ = view_cases.motion(seconds=1.0)
    scene = show_ghosts(model, t, {"rigid": q}).scenes[0]
    assert not scene.discs and not scene.marks and len({part.colour for part in scene.parts}) == 1
    assert not any("residual" in part.path or "mark" in part.path for part in scene.parts)


def test_a_recording_brings_tension_residual_and_forces(model):
    """The residual shown is the friction that the model lacks; tensions are pretension and what the torque asks."""
    show = show_recording(model, view_cases.recording(model), forces=True)
    discs = [f"{spot.kind} {spot.index}" for spot in show.scenes[0].discs]
    size = np.sqrt((show.residual**2).mean(0))
    assert size[discs.index("joint 2")] > 5 * size[discs.index("joint 1")]
    np.testing.assert_allclose(show.residual_rms[:2], view_cases.COULOMB, rtol=0.15)
    np.testing.assert_allclose(show.tension[:, 0] + show.tension[:, 1], 400.0)
    assert show.force.shape == show.point.shape == (len(show.time), len(show.scenes[0].contacts), 3)
    assert 25 <= 1 / np.diff(show.time).max() <= 36


def test_only_motor_positions_are_enough(model):
    """Without joint positions the motion follows from the motors by E."""
    recording = view_cases.recording(model)
    q = recording.channels["joint_position"]
    by_motor = type(recording)(recording.time, {"motor_position": model.motor_position(q)})
    show = show_recording(model, by_motor)
    assert show.residual is None and show.tension is None
    np.testing.assert_allclose(show.q[0], show_recording(model, recording).q[0], atol=2e-3)


def test_an_hour_is_shown_at_the_viewers_rate(model, monkeypatch):
    """A long recording is averaged down, then thinned to the viewer's rate, its length kept."""
    monkeypatch.setattr(show_module, "MOST", 80_000)
    t = np.arange(3600 * 40) / 40.0
    q = 0.4 * np.sin(0.5 * t[:, None] + np.arange(3))
    show = show_recording(model, type(view_cases.recording(model))(t, {"joint_position": q}))
    assert show.duration == pytest.approx(3600, abs=1) and len(show.time) < 3600 * 36


def test_any_robot_is_drawn_with_its_meshes_or_rods(tmp_path):
    """A robot of example-robot-data shows its meshes; one whose meshes are missing shows rods."""
    path = robot_urdf("ur5_robot")
    model = build_model(parse_manipulator({"name": "ur5", "urdf": str(path)}))
    scene = build_scene(model)
    assert sum(part.shape == "mesh" for part in scene.parts) >= 6 and not scene.sides
    assert all(command for command in scene_commands(scene)[:3])
    bare = tmp_path / "bare.urdf"
    bare.write_text(path.read_text().replace("package://", "package://nowhere/"))
    rods = build_scene(build_model(parse_manipulator({"name": "bare", "urdf": str(bare)})))
    assert any(part.path == "body_2/rod" for part in rods.parts)
