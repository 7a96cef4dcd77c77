"""Ways to damage a file: bytes, JSON values, the tensors of safetensors, the elements of XML.

Most changes keep the rest of the file in order, so that they get past the first checks. All
depends on the `random.Random` alone.
"""

import copy
import json
import random
import re
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import safetensors.torch
import torch
from lxml import etree
from torch import Tensor

from cgtorch.runs.journal import checksum

LENGTH = 8  # bytes of a safetensors file that say how long its header is
LONGEST = 2**26  # bytes that what JSON cannot say may make up
NUMBERS = (0, -1, 1, 2, 0.5, -0.0, 1e-300, 1e300, 1e39, 2**31, 2**53 + 1, 2**63, -(2**63), 10**400)
TEXTS = (
    "",
    "x",
    "S0",
    "..",
    "../../x",
    "\ud800",
    "\0",
    "line\nline",
    "\x1b[2J",
    "\u2028",
    "é" * 50,
)
VALUES = (*NUMBERS, *TEXTS, None, True, False, [], {}, [[]], [None], {"": 0}, "x" * 100_000)
RAW = (b"NaN", b"Infinity", b"-Infinity", b"1e999", b"9" * 4000, b"9" * 5000, b"-", b'"\xff"', b"")
NESTED = (3, 20, 200, 400, 900, 3000, 100_000)
XML_NUMBERS = (
    "0", "-1", "1e-12", "1e9", "-1e16", "1e300", "-1e308", "nan", "inf", "1_0", "", " ", "0x1", "é",
)  # fmt: skip
CANARY = "canary-that-must-not-be-read"
DTYPES = (
    torch.float16, torch.bfloat16, torch.float32, torch.float64, torch.int8, torch.int64,
    torch.bool, torch.uint8, torch.int32, torch.float8_e4m3fn, torch.complex64, torch.uint16,
)  # fmt: skip

Mutation = Callable[[bytes, random.Random], bytes]


def damaged_bytes(raw: bytes, draw: random.Random) -> bytes:
    """Bits flipped, bytes put in, taken out, exchanged or said twice, or the end cut off."""
    found = bytearray(raw)
    for _ in range(draw.randint(1, 3)):
        # The beginning says what the rest is: it is hit as often as the rest.
        end = len(found) if draw.random() < 0.5 else min(len(found), 1500)
        at, other = (draw.randrange(max(1, end)) for _ in range(2))
        size = draw.randint(1, 40)
        match draw.randrange(6):
            case 0 if found:
                found[min(at, len(found) - 1)] ^= 1 << draw.randrange(8)
            case 1:
                found[at:at] = draw.choice(
                    [b"0", b"9" * 30, b"-", b'"', b"[", b"{}", draw.randbytes(4)]
                )
            case 2:
                del found[at : at + size]
            case 3:
                found[at : at + size], found[other : other + size] = (
                    found[other : other + size], found[at : at + size],
                )  # fmt: skip
            case 4:
                found[at:at] = found[other : other + 20 * size]
            case 5 if draw.random() < 0.3:
                del found[at:]
    return bytes(found)


def damaged_json(raw: bytes, draw: random.Random) -> bytes:
    """JSON with a few of its values changed; what JSON cannot say is put in as text."""
    data, raws = json.loads(raw), []
    for _ in range(draw.choice([1, 1, 1, 2, 3])):
        data = _changed_value(data, draw, raws)
    text = json.dumps(data).encode()
    if draw.random() < 0.05:  # a key that comes twice
        keys = re.findall(rb'"\w+": ', text)
        if keys:
            key = draw.choice(keys)
            text = text.replace(key, key + b"0, " + key, 1)
    for i, part in enumerate(
        raws
    ):  # which may be in a list that was made ten thousand times as long
        text = text.replace(b'"@@%d@@"' % i, part, LONGEST // max(1, len(part)))
    return text


def damaged_log(raw: bytes, draw: random.Random) -> bytes:
    """A log with a damaged line."""
    lines = raw.splitlines()
    at = draw.randrange(len(lines))
    lines[at] = damaged_json(lines[at], draw)
    return b"\n".join(lines) + b"\n"


def _changed_value(data: Any, draw: random.Random, raws: list[bytes]) -> Any:
    holder: Any = [data]
    root, key = holder, 0
    while isinstance(holder[key], dict | list) and holder[key] and draw.random() < 0.85:
        holder = holder[key]
        key = draw.choice(list(holder)) if isinstance(holder, dict) else draw.randrange(len(holder))
    value = holder[key]
    match draw.randrange(10):
        case 0 | 1:
            holder[key] = copy.deepcopy(draw.choice(VALUES))  # which may be changed next
        case 2 | 3 if type(value) in (int, float) and abs(value) < 1e300:
            holder[key] = draw.choice(
                [value + 1, value - 1, -value, value * 1.0, value * 1.001, int(value), str(value)]
            )
        case 2 | 3 if isinstance(value, str):
            holder[key] = draw.choice([value + "x", value[:-1], *re.findall(r"\w+", value)[:2], 1])
        case 4 if holder is not root:
            del holder[key]
        case 5 if isinstance(holder, list) and holder is not root:
            holder.insert(key, value)
        case 5 if isinstance(holder, dict):
            holder[draw.choice(["x", "", key.upper(), key * 2000, "\ud800"])] = holder.pop(key)
        case 6 if holder is not root:  # the value of another key
            other = (
                draw.choice(list(holder))
                if isinstance(holder, dict)
                else draw.randrange(len(holder))
            )
            holder[key] = holder[other]
        case 7:
            holder[key] = draw.choice([[value], {"x": value}, [value] * 50])
        case 8:
            deep = draw.choice(NESTED)
            open_, close = draw.choice([(b"[", b"]"), (b'{"x":', b"}")])
            raws.append(open_ * deep + b"0" + close * deep)
            holder[key] = f"@@{len(raws) - 1}@@"
        case 9:
            raws.append(draw.choice(RAW))
            holder[key] = f"@@{len(raws) - 1}@@"
    return root[0]


def damaged_tensors(raw: bytes, draw: random.Random) -> bytes:
    """Safetensors with a changed header, other tensors, or other notes."""
    if draw.random() < 0.3:
        length = int.from_bytes(raw[:LENGTH], "little")
        header = damaged_json(raw[LENGTH : LENGTH + length], draw)
        says = len(header) if draw.random() < 0.9 else draw.choice([0, 2**63, 2**32, length])
        return says.to_bytes(LENGTH, "little") + header + raw[LENGTH + length :]
    notes = _notes(raw)
    tensors = dict(sorted(safetensors.torch.load(raw).items()))
    for _ in range(draw.choice([1, 1, 2])):
        name = draw.choice(list(tensors))
        if draw.random() < 0.1:
            other = draw.choice([name + "x", "", "é\n", draw.choice(list(tensors))])
            tensors[other] = tensors[name] if draw.random() < 0.5 else tensors.pop(name)
        elif notes and draw.random() < 0.3:
            notes = _changed_notes(notes, draw)
        else:
            tensors[name] = _changed_tensor(tensors[name], draw)
    if "sha256" in notes and draw.random() < 0.9:  # who forges a file can count, too
        about = {k: v for k, v in notes.items() if k != "sha256"}
        notes["sha256"] = checksum(tensors, about)
    plain = {k: t.clone().contiguous() for k, t in tensors.items()}
    return ordered(safetensors.torch.save(plain, metadata=notes or None))


def ordered(raw: bytes) -> bytes:
    """The same safetensors file with its notes in order, which differs from time to time."""
    length = int.from_bytes(raw[:LENGTH], "little")
    header = json.loads(raw[LENGTH : LENGTH + length])
    if "__metadata__" in header:
        header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    text = json.dumps(dict(sorted(header.items()))).encode()
    return len(text).to_bytes(LENGTH, "little") + text + raw[LENGTH + length :]


def _notes(raw: bytes) -> dict[str, str]:
    length = int.from_bytes(raw[:LENGTH], "little")
    return json.loads(raw[LENGTH : LENGTH + length]).get("__metadata__") or {}


def _changed_notes(notes: dict[str, str], draw: random.Random) -> dict[str, str]:
    name = draw.choice(list(notes))
    text = notes[name]
    if text.startswith("{") and draw.random() < 0.9:  # JSON within JSON
        with suppress(ValueError, RecursionError):  # it is damaged already
            text = damaged_json(text.encode(), draw).decode(errors="replace")
    else:
        text = draw.choice(["", "x", text + "x", "0.0.0", "line\nline", "x" * 10_000])
    return {**notes, name: text}


def _changed_tensor(tensor: Tensor, draw: random.Random) -> Tensor:
    found = tensor.clone()
    match draw.randrange(7):
        case 0:
            return found.to(draw.choice(DTYPES))
        case 1:
            shape = list(found.shape)
            draw.shuffle(shape)
            return found.reshape(shape)
        case 2:
            return draw.choice(
                [found[None], found.flatten(), found[..., None], found.new_zeros(())]
            )
        case 3 if found.ndim:
            return found[draw.choice([slice(0), slice(1), slice(1, None), slice(-1)])]
        case 4 if found.ndim:
            return torch.cat([found, found], draw.randrange(found.ndim))
        case 5:
            return found.new_zeros(draw.choice([(0,), (1,), (0, 0), (2, 0, 2), (3, 3)]))
    if found.numel():
        values = [0, 1, -1, 2, 1000] if found.dtype != torch.bool else [0, 1]
        if found.is_floating_point():
            values += [float("nan"), float("inf"), -1e30, 1e30, 1e-30, 1e300, 3.4e38]
        elif found.dtype != torch.bool:
            values += [2**31 - 1] if found.element_size() < 8 else [2**63 - 1, -(2**63), 2**40]
        if found.dtype == torch.uint8:
            values = [0, 1, 255]
        value, whole = draw.choice(values), draw.random() < 0.3
        with suppress(RuntimeError):  # the type cannot hold it
            found.view(-1)[slice(None) if whole else draw.randrange(found.numel())] = value
    return found


def damaged_xml(raw: bytes, draw: random.Random) -> bytes:
    """A URDF with other attributes and elements, joints in circles, or entities."""
    root = etree.fromstring(raw)
    for _ in range(draw.choice([1, 1, 2, 3])):
        _change_element(root, draw)
    text: bytes = etree.tostring(root)
    if draw.random() < 0.1:
        quoted = re.findall(rb'"[^"]*"', text)
        text = text.replace(draw.choice(quoted), b'"&x;"', 1)
        text = draw.choice(_doctypes()) + text
    elif draw.random() < 0.03:
        code = draw.choice(["utf-16", "utf-7", "latin-1", "ascii", "cp037", "x"])
        text = f'<?xml version="1.0" encoding="{code}"?>'.encode() + text
    return text


def _doctypes() -> list[bytes]:
    bomb = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 12))
    return [
        f'<!DOCTYPE robot [<!ENTITY e0 "ha">{bomb}<!ENTITY x "&e11;">]>'.encode(),
        b'<!DOCTYPE robot [<!ENTITY x SYSTEM "secret">]>',
        b'<!DOCTYPE robot [<!ENTITY x SYSTEM "http://127.0.0.1:9/x">]>',
        b'<!DOCTYPE robot SYSTEM "secret">',
        b'<!DOCTYPE robot [<!ENTITY % p SYSTEM "secret"> %p;]>',
        b'<!DOCTYPE robot [<!ENTITY x "&x;">]>',
    ]


def _change_element(root: Any, draw: random.Random) -> None:
    elements = list(root.iter())
    element = draw.choice(elements)
    named = [e for e in elements if e.attrib]
    match draw.randrange(9):
        case 0 | 1 | 2 if named:
            _change_attribute(draw.choice(named), draw)
        case 3 if element is not root:
            element.getparent().remove(element)
        case 4 if element is not root:
            twin = copy.deepcopy(element)  # which may be a comment, and is no document by itself
            for _ in range(draw.choice([1, 1, 1, 300])):
                element.addnext(copy.deepcopy(twin))
        case 5 if element is not root:  # within another, or within itself again and again
            draw.choice(elements[:1] + named).append(copy.deepcopy(element))
        case 6:  # joints and links that exist, in other places
            names = [e.get("link") for e in root.iter("parent", "child") if e.get("link")]
            end = draw.choice(list(root.iter("parent", "child")) or [root])
            end.set("link", draw.choice(names or ["x"]))
        case 7:
            joint = draw.choice(list(root.iter("joint")) or [root])
            joint.set(
                "type", draw.choice(["fixed", "floating", "planar", "prismatic", "continuous"])
            )
        case 8:
            joints = [j.get("name", "") for j in root.findall("joint")] or [""]
            joint = draw.choice(root.findall("joint") or [root])
            other = draw.choice(joints)
            etree.SubElement(joint, "mimic", joint=other, multiplier="1", offset="0")


def _change_attribute(element: Any, draw: random.Random) -> None:
    name = draw.choice(list(element.attrib))
    text = element.get(name)
    parts = text.split()
    try:
        [float(part) for part in parts]
        numbers = bool(parts)
    except ValueError:
        numbers = False
    if numbers and draw.random() < 0.9:
        parts[draw.randrange(len(parts))] = draw.choice([*XML_NUMBERS, repr(draw.gauss(0, 1))])
        element.set(name, " ".join(parts))
    elif draw.random() < 0.2:
        del element.attrib[name]
    else:
        element.set(
            name, draw.choice(["", "x", text + " ", text[::-1], "é\n", "x" * 50_000, "../x"])
        )


def damaged(kind: Mutation, raw: bytes, draw: random.Random) -> bytes:
    """A file with changes of its kind, or, one time in five, of its bytes."""
    raw = ordered(raw) if kind is damaged_tensors else raw
    return damaged_bytes(raw, draw) if draw.random() < 0.2 else kind(raw, draw)
