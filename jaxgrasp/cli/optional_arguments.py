"""How help shows an argument that may be left out: by what it takes where it is given, without a word on ``None``."""

from dataclasses import replace
from types import NoneType, UnionType
from typing import Any, Union, get_args

from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

REGISTRY = ConstructorRegistry()


@REGISTRY.primitive_rule
def optional(of: PrimitiveTypeInfo) -> PrimitiveConstructorSpec | None:
    """Return the specification by which tyro reads an annotation ``X | None`` as ``X``; None for others."""
    types = get_args(of.type)
    if of.type_origin not in (Union, UnionType) or len(types) != 2 or NoneType not in types:
        return None
    (inner_type,) = (candidate for candidate in types if candidate is not NoneType)
    spec = ConstructorRegistry.get_primitive_spec(PrimitiveTypeInfo.make(inner_type, of.markers))
    if not isinstance(spec, PrimitiveConstructorSpec):
        return None

    def to_strings(value: Any) -> list[str]:
        return ["None"] if value is None else spec.str_from_instance(value)

    return replace(
        spec, is_instance=lambda value: value is None or spec.is_instance(value), str_from_instance=to_strings
    )
