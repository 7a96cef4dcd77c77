"""Where files of packages are found, and that a name leads nowhere else."""

import pytest

from cgtorch.ground.errors import RobotError
from cgtorch.tabletop.kinematics.meshes import file_named, package_places


@pytest.fixture
def world(tmp_path):
    """A package in a repository in a workspace, a URDF elsewhere, and a secret beside all."""
    package = tmp_path / "ws" / "repo" / "arm_description"
    (package / "meshes").mkdir(parents=True)
    (package / "meshes" / "a.stl").write_text("mesh")
    (package / "package.xml").write_text("<package><name>arm_description</name></package>")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "secret.stl").write_text("secret")
    return tmp_path


NAME = "package://arm_description/meshes/a.stl"


def found(world, name=NAME, places=(), urdf="elsewhere/r.urdf"):
    return file_named(name, world / urdf, [world / place for place in places])


@pytest.mark.parametrize("place", ["ws", "ws/repo", "ws/repo/arm_description"])
def test_a_place_is_around_a_package_or_it_is_one(world, place):
    mesh = world / "ws/repo/arm_description/meshes/a.stl"
    assert found(world, places=[place]) == mesh
    assert found(world, "package:///arm_description/meshes/./a.stl", [place]) == mesh


def test_the_package_in_which_the_urdf_lies(world):
    urdf = "ws/repo/arm_description/urdf/r.urdf"
    assert found(world, urdf=urdf).read_text() == "mesh"
    (world / "ws/repo/arm_description").rename(world / "ws/repo/checkout")
    assert found(world, urdf="ws/repo/checkout/urdf/r.urdf").read_text() == "mesh"
    assert (
        found(world, "../meshes/a.stl", urdf="ws/repo/checkout/urdf/r.urdf").read_text() == "mesh"
    )


def test_the_environment(world):
    environment = {
        "ROS_PACKAGE_PATH": f"{world}/none:{world}/ws",
        "AMENT_PREFIX_PATH": f"{world}/install::",
    }
    places = package_places(["mine"], environment)
    ends = ["mine", "none", "ws", "install/share"]
    assert [str(place).removeprefix(f"{world}/") for place in places] == ends
    assert file_named(NAME, world / "r.urdf", places).read_text() == "mesh"
    (world / "ws").rename(world / "moved")
    (world / "install" / "share").mkdir(parents=True)
    (world / "moved/repo/arm_description").rename(world / "install/share/arm_description")
    assert file_named(NAME, world / "r.urdf", places).read_text() == "mesh"


def test_files_by_their_path(world):
    mesh = world / "ws/repo/arm_description/meshes/a.stl"
    for name in (str(mesh), f"file://{mesh}"):
        assert found(world, name, ["ws"]) == mesh
        with pytest.raises(RobotError, match="leads out of"):
            found(world, name)
    assert found(world, "a.stl", urdf="ws/repo/arm_description/meshes/r.urdf") == mesh


@pytest.mark.parametrize(
    "name",
    [
        "package://arm_description/../../../secret.stl",
        "package://arm_description/meshes/../../../../secret.stl",
        "package://arm_description//etc/../../../../secret.stl",
        "package://../secret.stl",
        "package://./secret.stl",
        "package://arm*/meshes/a.stl",
        "package://",
        "../secret.stl",
        "{world}/secret.stl",
        "file://{world}/secret.stl",
        "file:///etc/passwd",
        "/etc/passwd",
        "http://example.org/a.stl",
        "model://arm_description/meshes/a.stl",
        "\0",
        "",
        "x" * 5000,
    ],
)
def test_a_name_that_leads_elsewhere_is_refused(world, name):
    with pytest.raises(RobotError) as caught:
        found(world, name.format(world=world), ["ws"])
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000


def test_what_is_missing_is_named_with_the_places(world):
    with pytest.raises(RobotError) as caught:
        found(world, "package://arm_description/meshes/b.stl", ["ws"])
    assert "arm_description/meshes/b.stl', which is missing: it is not in" in str(caught.value)
    assert f"{world}/ws/repo/arm_description" in str(caught.value)
    with pytest.raises(RobotError) as caught:
        found(world, "package://leg/b.stl", ["ws"])
    assert "the package 'leg' is in none of" in str(caught.value)
    assert f"{world}/ws'" in str(caught.value)
    assert "--package-path" in str(caught.value)
