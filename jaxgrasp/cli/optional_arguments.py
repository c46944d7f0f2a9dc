"""How help shows an argument that may be left out: by what it takes where it is given, without a word on ``None``."""

from dataclasses import replace
from types import NoneType, UnionType
from typing import Any, Union, get_args

from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

REGISTRY = ConstructorRegistry()


@REGISTRY.primitive_rule
def optional(of: PrimitiveTypeInfo) -> PrimitiveConstructorSpec | None:
    """Return the specification by which tyro reads an annotation ``X | None`` as ``X``; None for others."""
    kinds = get_args(of.type)
    if of.type_origin not in (Union, UnionType) or len(kinds) != 2 or NoneType not in kinds:
        return None
    (kind,) = (one for one in kinds if one is not NoneType)
    given = ConstructorRegistry.get_primitive_spec(PrimitiveTypeInfo.make(kind, of.markers))
    if not isinstance(given, PrimitiveConstructorSpec):
        return None

    def shown(value: Any) -> list[str]:
        return ["None"] if value is None else given.str_from_instance(value)

    return replace(given, is_instance=lambda value: value is None or given.is_instance(value), str_from_instance=shown)
