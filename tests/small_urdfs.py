"""Small URDFs of chains of boxes."""

LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
AXES = "0 0 1", "0 1 0"


def box(size="0.05 0.05 0.05", at="0 0 0", kind="collision"):
    return f'<{kind}><origin xyz="{at}"/><geometry><box size="{size}"/></geometry></{kind}>'


def link(name, shapes=None):
    return f'<link name="{name}">{box() if shapes is None else shapes}</link>'


def joint(name, above, at="0 0 0.1", axis="0 0 1", kind="revolute", more=LIMIT):
    return (
        f'<joint name="{name}_joint" type="{kind}"><parent link="{above}"/><child link="{name}"/>'
        f'<origin xyz="{at}"/><axis xyz="{axis}"/>{more}</joint>'
    )


def chain(name, count, above, at="0 0 0.1", first=None, shapes=None):
    """Links and joints of a chain that ends in nothing."""
    parts = []
    for i in range(count):
        parts.append(link(f"{name}{i}", shapes))
        parts.append(joint(f"{name}{i}", above, at if i or first is None else first, AXES[i % 2]))
        above = f"{name}{i}"
    return "".join(parts)


def fingers(name, above, at="0 {} 0.05"):
    two = (("a", 0.03), ("b", -0.03))
    each = (
        link(f"{name}_{x}") + joint(f"{name}_{x}", above, at.format(y), "1 0 0") for x, y in two
    )
    return "".join(each)


def urdf_of(tmp_path, *parts):
    """The path of a URDF of links and joints."""
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="x">{"".join(parts)}</robot>')
    return path
