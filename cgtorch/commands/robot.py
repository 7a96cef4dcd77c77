"""`cgtorch-robot`: make a robot folder from any URDF."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cgtorch.commands import common, outputs
from cgtorch.ground.errors import RunError, SettingsError

if TYPE_CHECKING:
    from cgtorch.tabletop.robot_folder.make import Made

EXAMPLES = """\b
Examples:
  cgtorch-robot fetch.urdf --package-path ~/ros/src --output my_fetch
  cgtorch-robot arm.urdf --output mine --arm arm=base_link:tool0 --torso-joint none
  cgtorch-robot pr2.urdf --output mine --torso-position 0.15 --hold l_gripper_l_finger_joint=0.4
"""
NO_JOINT = "none"


@common.command("cgtorch-robot", EXAMPLES)
@click.argument("urdf", metavar="URDF", type=common.A_PATH)
@outputs.output_option("The robot folder to make; it must not exist yet.")
@click.option(
    "--package-path",
    multiple=True,
    type=common.A_PATH,
    help="A folder that contains ROS packages, which the URDF names by package://, or one such "
    "package. Repeat the option for several. ROS_PACKAGE_PATH and AMENT_PREFIX_PATH are searched "
    "as well.",
)
@click.option(
    "--srdf",
    type=common.A_PATH,
    help="An SRDF, whose groups and end effectors name the arms, whose states name their home, and "
    "whose disabled collisions are never checked.  [the one beside the URDF]",
)
@click.option("--name", "robot_name", help="The name of the robot.  [as in the URDF]")
@click.option(
    "--base-frame", help="The base link, on the floor; positions are relative to it.  [the root]"
)
@click.option(
    "--footprint",
    type=float,
    nargs=4,
    metavar="X_MIN X_MAX Y_MIN Y_MAX",
    help="The outline of the base seen from above, m.  [of the shapes near the floor]",
)
@click.option(
    "--torso-joint",
    help="The joint that lifts the arms, or none.  [the prismatic joint below all arms]",
)
@click.option(
    "--torso-position", type=float, help="The position of the torso joint, m.  [shoulders 1 m high]"
)
@click.option(
    "--arm",
    "arms",
    multiple=True,
    metavar="NAME=BASE_LINK:TOOL_FRAME",
    help="An arm, from the link that carries it to its tool frame, whose x axis points along the "
    "approach and whose y axis points across the fingers. Repeat the option for several arms.  "
    "[chains that end in hands]",
)
@click.option(
    "--body",
    multiple=True,
    metavar="LINK",
    help="A link that arms must not touch. Repeat the option for several.  [all links that no arm "
    "moves, except those near the floor]",
)
@click.option(
    "--stand",
    type=click.FloatRange(0.0, 3.0),
    callback=common.a_number,
    default=0.0,
    help="The height of a stand on which the robot is put, m, for an arm that has no base of its "
    "own.  [none]",
)
@click.option(
    "--hold",
    multiple=True,
    metavar="JOINT=POSITION",
    help="The position of a joint outside the arms, rad or m. Repeat the option for several.  "
    "[fingers open, others at 0]",
)
@click.option(
    "--home",
    multiple=True,
    metavar="JOINT=POSITION",
    help="The position of an arm joint while the robot drives, rad or m. Repeat the option for "
    "several.  [a computed posture]",
)
def command(urdf: Path, output: Path, package_path: tuple[Path, ...], **rest: Any) -> None:
    """Make a robot folder from a URDF, for --robot of cgtorch-train.

    The folder contains the URDF with simple shapes in place of meshes (robot.urdf), a proposed
    description (robot.json), the shapes fitted to each mesh (shapes.json), and a picture
    (robot.png). Meshes may be STL, DAE, OBJ or PLY files. Check the picture and the printed
    summary, and correct the proposal with options.
    """
    if output.exists():
        raise RunError(f"{str(output)!r} exists; choose another --output")
    with common.importing():
        import torch

        from cgtorch.tabletop.robot_folder.make import make_robot_folder
        from cgtorch.tabletop.robot_folder.proposal import Wishes

    torch.set_num_threads(1)
    torso = rest["torso_joint"]
    wishes = Wishes(
        name=rest["robot_name"],
        base_frame=rest["base_frame"],
        footprint=rest["footprint"],
        torso_joint="" if torso == NO_JOINT else torso,
        torso_position=rest["torso_position"],
        arms=tuple(_arm(text) for text in rest["arms"]),
        body=rest["body"],
        stand=rest["stand"],
        held=dict(_position("--hold", text) for text in rest["hold"]),
        home=dict(_position("--home", text) for text in rest["home"]),
    )
    with common.waiting(f"fitting shapes to {urdf}", rest["quiet"]):
        made = make_robot_folder(urdf, output, wishes, package_path, rest["srdf"])
    for line in _summary(made, output):
        common.say(line)


def _arm(text: str) -> Any:
    from cgtorch.tabletop.kinematics.description import Arm

    name, _, links = text.partition("=")
    base, _, tool = links.partition(":")
    if not (name and base and tool):
        raise SettingsError(f"--arm is {text!r}; give NAME=BASE_LINK:TOOL_FRAME")
    return Arm(name, base, tool)


def _position(option: str, text: str) -> tuple[str, float]:
    joint, _, position = text.rpartition("=")
    try:
        return joint, float(position)
    except ValueError:
        raise SettingsError(f"{option} is {text!r}; give JOINT=POSITION") from None


def _summary(made: "Made", folder: Path) -> Iterator[str]:
    """The written files, and points for the user to check."""
    words, robot = made.robot.description, made.robot
    x0, x1, y0, y1 = words.footprint
    yield f"{words.name}: {folder}"
    yield (
        f"base frame {words.base_frame}, footprint {x1 - x0:.3f} by {y1 - y0:.3f} m, "
        f"x from {x0} to {x1}, y from {y0} to {y1}"
    )
    torso = f"torso {words.torso_joint} at {words.torso_position}"
    yield torso if words.torso_joint else "no torso joint"
    for arm, model in zip(words.arms, robot.arms, strict=True):
        solved = "in closed form" if model.closed_form is not None else "numerically, which is slow"
        yield (
            f"arm {arm.name}: {len(model.joint_names)} joints from {arm.base_link} to "
            f"{arm.tool_frame}, solved {solved}"
        )
    fits = [(each.fit, each.link) for each in made.meshes if each.fit is not None]
    if fits:
        volumes = [fit.ratio for fit, _ in fits]
        worst = fits[volumes.index(max(volumes))][1]
        yield (
            f"{len(fits)} meshes are {sum(len(fit.shapes) for fit, _ in fits)} shapes, of "
            f"{sum(volumes) / len(volumes):.2f} times the volume of convex hulls (mean; "
            f"{max(volumes):.2f} of {worst})"
        )
    yield ""
    yield "Please check:"
    yield f"- x leads forward in {folder / 'robot.png'}, and the dashed footprint holds the body"
    yield "- tool frames lie between the finger tips: red (x) along the approach, green (y) across"
    yield from (f"- {note}" for note in made.notes)
    if made.inertials:
        yield f"- masses or inertias were made up for {', '.join(made.inertials)}"
    without = [each for each in made.meshes if each.fit is None]
    yield from dict.fromkeys(f"- link {each.link} is not drawn: {each.problem}" for each in without)
    grasps, why = made.reached.grasps, made.reached.why
    line = f"- of {len(grasps)} objects on a table right before the robot it can grasp "
    yield f"{line}{int(grasps.sum())}{f': {why}' if why else ''}"


main = partial(common.run_program, command)

if __name__ == "__main__":
    main()
