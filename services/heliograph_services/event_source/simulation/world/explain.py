"""What is wrong with a scenario's text, in one line: which key, what it says, and what it may say.

msgspec tells where and what it expected; the value is looked up in the data, the whole range in the type.
"""

from __future__ import annotations

import math
import re
from typing import Any, Final

import msgspec
import msgspec.inspect as types

_WHERE: Final = re.compile(r"^(?P<what>.*) - at `\$(?P<path>.*)`$")
_STEP: Final = re.compile(r"\.([^.\[\]]+)|\[(\d+)\]")
_FIELD: Final = re.compile(r"^Object (contains unknown|missing required) field `(.*)`$")
# A value longer than this is a text or a table: its beginning says which.
_VALUE_LIMIT: Final = 60


def explained(error: Exception, data: object, kind: type[msgspec.Struct]) -> str:
    """Return the text of what msgspec refused.

    Args:
        error: a ValidationError of msgspec; another error's text is returned as it is.
        data: what was to be converted.
        kind: into what.
    """
    text = " ".join(str(error).split())
    found = _WHERE.match(text)
    what, path = (found["what"], found["path"]) if found else (text, "")
    value, node = _at(data, types.type_info(kind), path)
    name = path.lstrip(".") or "the scenario"
    field = _FIELD.match(what)
    if field and field[1] == "contains unknown":
        known = ", ".join(_fields(node))
        given = _shown(value.get(field[2])) if isinstance(value, dict) else "?"
        return f"{_joined(path, field[2])} = {given} is unknown; {name} may have {known}"
    if field:
        return f"{_joined(path, field[2])} is missing"
    if path.endswith("[...]"):  # a value of a free table: msgspec does not say which
        return f"{name.removesuffix('[...]')}: a value must be {what.removeprefix('Expected ').replace('`', '')}"
    if what.startswith(("Expected", "Invalid")):
        return f"{name} must be {_allowed(node) or what}, not {_shown(value)}"
    return f"{name}: {what}" if path else what


def not_finite(data: object, path: str = "") -> str | None:
    """Return the text about the first number that is none (nan, inf), or None: TOML knows them, a scene does not."""
    if isinstance(data, float) and not math.isfinite(data):
        return f"{path} must be a finite number, not {data}"
    entries: list[tuple[str, object]] = []
    if isinstance(data, dict):
        entries = [(_joined(path, str(key)), value) for key, value in data.items()]
    elif isinstance(data, list):
        entries = [(f"{path}[{i}]", value) for i, value in enumerate(data)]
    return next((text for name, value in entries if (text := not_finite(value, name))), None)


def _joined(path: str, key: str) -> str:
    return f"{path}.{key}".lstrip(".")


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _VALUE_LIMIT else text[:_VALUE_LIMIT] + "..."


def _at(data: Any, node: types.Type, path: str) -> tuple[Any, types.Type]:
    """Return the value and the type at a path of msgspec."""
    for key, index in _STEP.findall(path):
        node = _variant(node, data)
        if index:
            i = int(index)
            node = _item(node, i)
            data = data[i] if isinstance(data, list) and i < len(data) else None
            continue
        node = _field_type(node, key)
        data = data.get(key) if isinstance(data, dict) else None
    return data, _variant(node, data)


def _variant(node: types.Type, data: object) -> types.Type:
    """Return that of a union's types which the data mean: by their tag, or the only one there is."""
    node = _bare(node)
    if not isinstance(node, types.UnionType):
        return node
    kinds = [_bare(kind) for kind in node.types]
    structs = [kind for kind in kinds if isinstance(kind, types.StructType)]
    if isinstance(data, dict):
        for kind in structs:
            if kind.tag_field is not None and data.get(kind.tag_field) == kind.tag:
                return kind
    others = [kind for kind in kinds if not isinstance(kind, types.NoneType)]
    return others[0] if len(others) == 1 else types.UnionType(tuple(others))


def _bare(node: types.Type) -> types.Type:
    while isinstance(node, types.Metadata):
        node = node.type
    return node


def _field_type(node: types.Type, key: str) -> types.Type:
    if isinstance(node, types.StructType):
        for field in node.fields:
            if field.encode_name == key:
                return field.type
    kinds = node.types if isinstance(node, types.UnionType) else (node,)
    tags = [str(kind.tag) for kind in kinds if isinstance(kind, types.StructType) and kind.tag_field == key]
    return types.LiteralType(tuple(sorted(tags))) if tags else types.AnyType()


def _item(node: types.Type, i: int) -> types.Type:
    if isinstance(node, types.TupleType) and i < len(node.item_types):
        return node.item_types[i]
    return node.item_type if isinstance(node, types.VarTupleType) else types.AnyType()


def _fields(node: types.Type) -> list[str]:
    if not isinstance(node, types.StructType):
        return []
    tag = [node.tag_field] if node.tag_field else []
    return tag + [field.encode_name for field in node.fields]


def _allowed(node: types.Type) -> str:
    """Return what a type allows, in words; empty where msgspec says it better."""
    match node:
        case types.IntType() | types.FloatType():
            return ("a whole number" if isinstance(node, types.IntType) else "a number") + _range(node)
        case types.BoolType():
            return "true or false"
        case types.LiteralType(values=values):
            return "one of " + ", ".join(repr(value) for value in values)
        case types.StrType(min_length=least, max_length=most, pattern=pattern):
            limits = [f"at least {least}" if least else "", f"at most {most}" if most is not None else ""]
            length = " and ".join(limit for limit in limits if limit)
            return "a text" + (f" of {length} letters" if length else "") + (f" like {pattern}" if pattern else "")
        case types.TupleType(item_types=items):
            return f"a list of {len(items)}"
        case types.VarTupleType(min_length=least, max_length=most):
            return f"a list of {least or 0} to {most} entries" if most is not None else "a list"
        case types.StructType():
            return "a table of " + ", ".join(_fields(node))
        case types.UnionType(types=kinds):
            tags = [str(kind.tag) for kind in kinds if isinstance(kind, types.StructType)]
            return f"a table whose kind is one of {', '.join(sorted(tags))}" if tags else ""
    return ""


def _range(node: types.IntType | types.FloatType) -> str:
    low = f" from {node.ge:g}" if node.ge is not None else f" above {node.gt:g}" if node.gt is not None else ""
    if node.le is not None:
        return (
            f"{low} to {node.le:g}" if low.startswith(" from") else f"{low}{' and' if low else ''} at most {node.le:g}"
        )
    return low + (f"{' and' if low else ''} below {node.lt:g}" if node.lt is not None else "")
