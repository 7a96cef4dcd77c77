"""Model files: whole or not at all, and never more trusted than a file deserves."""

import json
import pickle
from dataclasses import asdict
from pathlib import Path

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors.torch import load_file, save_file
from stand_in import labelled, transitions
from torch import nn

from cgtorch.ground.errors import ModelError
from cgtorch.ground.files import notes_of, tensors_of
from cgtorch.svm import SVC, SVR, Choice, load_model, save_model
from cgtorch.svm.storage import MACHINES, load_model_and_report

REPORT = Choice(4.0, 0.1, 0.0, 0.75)


class Scaled(nn.Module):
    """A model around a machine, with buffers of its own."""

    def __init__(self):
        super().__init__()
        self.register_buffer("mean", torch.zeros(10))
        self.register_buffer("scale", torch.ones(10))
        self.machine = SVR()

    def shapes(self, features):
        return {"mean": (features,), "scale": (features,)}

    def forward(self, x):
        return self.machine((x - self.mean) / self.scale)


KINDS = {**MACHINES, "Scaled": Scaled}


@pytest.fixture(scope="module")
def model_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("models") / "scaled.safetensors"
    p, u, q = (torch.tensor(a) for a in transitions(100))
    model, rows = Scaled(), torch.cat([p, u], 1)
    model.mean, model.scale = rows.mean(0), rows.std(0).clamp_min(1e-3)
    model.machine.fit((rows - model.mean) / model.scale, q)
    save_model(path, model.float(), REPORT)
    return path, model


def test_what_was_saved_is_what_is_loaded(model_file, tmp_path):
    path, model = model_file
    rows = torch.randn(50, 10, generator=torch.Generator().manual_seed(0))
    again = load_model(path, KINDS)
    assert torch.equal(again(rows), model(rows))
    assert not again.training
    assert load_model_and_report(path, KINDS)[1] == asdict(REPORT)

    x, y = labelled(100)
    classifier = SVC().fit(x, y)
    classifier.platt = torch.tensor([-1.5, 0.2]).double()
    for other in (classifier, SVR().fit(x, x[:, :2])):
        save_model(tmp_path / "one", other)
        rows = torch.tensor(x)
        assert torch.equal(load_model(tmp_path / "one")(rows), other(rows))
    assert [file.name for file in tmp_path.iterdir()] == ["one"]


def test_a_file_says_what_it_holds_so_that_other_programs_can_read_it(model_file):
    header = json.loads(notes_of(model_file[0].read_bytes())["cgtorch"])
    assert header == {
        "format": "cgtorch-model",
        "version": 3,
        "kind": "Scaled",
        "settings": {"kernel": "rbf", "degree": 3, "coef0": 0.0},
        "report": asdict(REPORT),
    }


def test_a_loaded_machine_learns_on_with_the_parameters_of_its_fit(tmp_path):
    x, y = labelled(120)
    order = torch.randperm(120, generator=torch.Generator().manual_seed(0))
    x, y = torch.tensor(x)[order], torch.tensor(y)[order]
    regression = SVR([1.0, 3.0], gamma=0.3, epsilon=[0.05, 0.1])
    classifier = SVC(3.0, gamma=0.3)
    classifier.platt = torch.tensor([-1.5, 0.2]).double()
    for machine, target in ((regression, x[:, :2].sin()), (classifier, y)):
        save_model(tmp_path / "m", machine.fit(x[:80], target[:80]))
        again = load_model(tmp_path / "m").learn_on(x, target)
        assert torch.allclose(again.values(x), machine.fit(x, target).values(x), atol=1e-5)
    assert torch.equal(again.platt, load_model(tmp_path / "m").platt)


def test_a_failed_save_leaves_the_old_file(model_file, tmp_path, monkeypatch):
    _, model = model_file
    path = tmp_path / "scaled"
    save_model(path, model)
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(ModelError, match="No space left"):
        save_model(path, model)
    assert path.read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 1
    with pytest.raises(ModelError, match="cannot write"):
        save_model(tmp_path / "nowhere" / "scaled", model)
    with pytest.raises(ModelError, match="fitted"):
        save_model(path, SVC())


def headed(tensors, data):
    """A safetensors file whose header may say anything of its tensors."""
    text = json.dumps(tensors).encode()
    return len(text).to_bytes(8, "little") + text + data


def _rewritten(path, target, change_state=None, **header):
    """A copy of the file with other tensors or header entries."""
    old, state = json.loads(notes_of(path.read_bytes())["cgtorch"]), load_file(path)
    if change_state:
        change_state(state)
    save_file(state, target, metadata={"cgtorch": json.dumps(old | header)})


@pytest.mark.parametrize(
    ("header", "says"),
    [
        ({"version": 99}, "version 99"),
        ({"kind": "os.system"}, "unknown model"),
        ({"kind": "SVC"}, "missing or unknown"),
        ({"format": "other"}, "no cgtorch model"),
        ({"settings": {"kernel": "rbf"}}, "unusable settings"),
        ({"settings": {"kernel": "poly", "degree": 3, "coef0": 0.0}}, "unusable settings"),
        ({"settings": []}, "unusable settings"),
        ({"kind": ["SVR"]}, "damaged"),
    ],
)
def test_a_foreign_header_is_refused(model_file, tmp_path, header, says):
    _rewritten(model_file[0], tmp_path / "m", **header)
    with pytest.raises(ModelError, match=says):
        load_model(tmp_path / "m", KINDS)


@pytest.mark.parametrize(
    ("name", "change", "says"),
    [
        ("machine.weights", lambda t: t * float("nan"), "NaN"),
        ("machine.weights", lambda t: t[:-1], "wrong shape"),
        ("machine.centres", lambda t: t[:, :-1], "wrong shape"),
        ("machine.centres", lambda t: t.int(), "type"),
        ("mean", lambda t: t[None].clone(), "shape"),
        ("machine.gamma_value", lambda t: -t, "cannot have"),
        ("machine.support", lambda t: -1 - t, "cannot have"),
        ("scale", lambda t: 0 * t, "cannot have"),
        ("machine.bias", lambda t: None, "missing"),
        ("machine.", lambda t: t[..., :0], "shape"),
    ],
)
def test_foreign_tensors_are_refused(model_file, tmp_path, name, change, says):
    outputs = ("weights", "bias", "gap", "cost", "tube")

    def edit(state):
        for each in [f"{name}{end}" for end in outputs] if name.endswith(".") else [name]:
            value = change(state.pop(each))
            if value is not None:
                state[each] = value.contiguous()

    _rewritten(model_file[0], tmp_path / "m", edit)
    with pytest.raises(ModelError, match=says):
        load_model(tmp_path / "m", KINDS)


def test_files_that_are_no_models_are_refused(tmp_path):
    for path in (tmp_path, tmp_path / "missing"):
        with pytest.raises(ModelError, match="cannot read"):
            load_model(path)
    for content in (b"", b"\x00" * 8, b"\xff" * 64, pickle.dumps({"a": 1}), b"{}"):
        (tmp_path / "m").write_bytes(content)
        with pytest.raises(ModelError):
            load_model(tmp_path / "m", KINDS)
    with (tmp_path / "m").open("wb") as file:
        file.truncate(2 * 1024**3)  # which is not read
    with pytest.raises(ModelError, match="larger than"):
        load_model(tmp_path / "m", KINDS)


def test_a_file_is_read_once(model_file, monkeypatch):
    opened, plain = [], Path.open
    monkeypatch.setattr(Path, "open", lambda p, *a, **k: opened.append(p) or plain(p, *a, **k))
    load_model(model_file[0], KINDS)
    assert opened == [model_file[0]]


@pytest.mark.parametrize("shape", [[2**40, 0], [2**20, 2**20], [2**62, 2**62]])
def test_a_file_cannot_ask_for_more_memory_than_it_is_large(model_file, tmp_path, shape):
    """Shapes are taken from the file only where its bytes fill them."""
    content = model_file[0].read_bytes()
    length = int.from_bytes(content[:8], "little")
    tensors = json.loads(content[8 : 8 + length])
    tensors["machine.centres"]["shape"] = shape
    changed = headed(tensors, content[8 + length :])
    for wrong in (changed, (2**60).to_bytes(8, "little") + content[8:]):
        (tmp_path / "m").write_bytes(wrong)
        with pytest.raises(ModelError):
            load_model(tmp_path / "m", KINDS)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=100)
@given(data=st.data())
def test_damage_never_escapes_as_another_error(model_file, tmp_path, data):
    content = bytearray(model_file[0].read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, min(len(content), 3000) - 1))
        content[place] = data.draw(st.integers(0, 255))
    del content[data.draw(st.integers(len(content) // 2, len(content))) :]
    (tmp_path / "m").write_bytes(content)
    try:
        model = load_model(tmp_path / "m", KINDS)
    except ModelError as error:
        assert "\n" not in str(error)  # noqa: PT017
    else:
        assert model(torch.randn(5, 10)).shape == (5, 7)


@pytest.mark.parametrize(
    ("dtype", "shape", "size"),
    [
        ("F4", [4], 2),
        ("F8_E8M0", [4], 4),
        ("F6_E2M3", [2**40, 0], 0),
        ("F32", [2**63, 0], 0),
        ("F32", [2**62, 2**62], 0),
        ("X", [1], 4),
        ("F32", [2], 4),
    ],
)
def test_types_and_shapes_that_torch_lacks_are_one_line(tmp_path, dtype, shape, size):
    tensors = {"x": {"dtype": dtype, "shape": shape, "data_offsets": [0, size]}}
    data = headed(tensors, bytes(size))
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        tensors_of(data)
    assert len(str(caught.value).splitlines()) == 1
    (tmp_path / "m").write_bytes(data)
    with pytest.raises(ModelError, match=r"^model file '.*' is damaged: .*; restore the file$"):
        load_model(tmp_path / "m", KINDS)
